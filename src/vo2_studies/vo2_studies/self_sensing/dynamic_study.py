"""Static against dynamic composite on devices with a lightly damped mode, under a chirp of the current.

`python -m vo2_studies.self_sensing.dynamic_study [SEED ...]` prints the mean estimation error of both.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vo2_models.device import TruthDevice, preset, truth
from vo2_models.device.simulation import TRUE_DEFLECTION
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import chirp, damped_oscillation, random_levels
from vo2_models.parameters import Value
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing.characterisation import characterise
from vo2_models.self_sensing.records import MODE
from vo2_models.self_sensing.scheme import self_sensing

__all__ = ["StudyResult", "chirp_current", "identified", "main", "study"]

Floats = NDArray[np.float64]

DEVICE = "integrated"
RESONANCE = {"cantilever_resonance": {"share": 1.0, "frequency": 150.0, "damping": 0.02}}
AMPLITUDE = 0.9
"""Of half the operating range: both transitions are crossed on every slow period."""


@dataclass(frozen=True)
class StudyResult:
    """Mean absolute estimation errors [m] of one device under the chirp, and the mode that was identified."""

    seed: int
    composite: float
    dynamic: float
    frequency: float
    damping: float
    note: str


def identification_current(level: int = 20, steps: int = 60) -> Floats:
    """A damped oscillation of 10 ms a level, then random levels of 20 ms, which let the structure ring [A]."""
    low, high = preset(DEVICE).operating_range
    loops = low + (high - low) * damped_oscillation(np.linspace(0.0, 1.0, level + 1))
    rest = random_levels(low, high, steps, seed=0)
    return np.concatenate([np.full(30, low), np.repeat(loops, 10), np.repeat(rest, 20)])


def chirp_current(duration_s: float = 6.0) -> Floats:
    """A rest at the low end, then a chirp from 1 to 100 Hz through the loops, a sample a millisecond [A]."""
    low, high = preset(DEVICE).operating_range
    sweep = chirp(0.5 * (low + high), 0.5 * AMPLITUDE * (high - low), (1.0, 100.0), duration_s, 1e-3)
    return np.concatenate([np.full(50, low), sweep])


def identified(
    device: TruthDevice, seed: int, *, level: int = 20, steps: int = 60, plays: int = 12
) -> dict[str, Value]:
    """Return the parameters fitted to the device's noisy recording of what a rig logs."""
    recorded = device.simulate(identification_current(level, steps), seed=seed)
    names = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)
    given = Recording(recorded.time_s, {name: recorded[name] for name in names}, DEVICE)
    parameters = fit_device([given], DEVICE, plays=plays).model.to_parameters()
    return {**parameters, **characterise(given, parameters)}


def study(seed: int, **options: int) -> StudyResult:
    """Identify the device of a seed and compare both schemes on the same noisy resistances of the chirp."""
    device = truth(DEVICE, seed=seed, effects=RESONANCE)
    parameters = identified(device, seed, **options)
    test = device.simulate(chirp_current(), seed=seed + 1000)
    error = {}
    for kind in ("composite", "dynamic"):
        found, _ = self_sensing(kind, parameters).estimate(test[RESISTANCE])
        error[kind] = float(np.mean(np.abs(np.asarray(found.deflection) - test[TRUE_DEFLECTION])[50:]))
    frequency, damping = (float(parameters[f"{MODE}.{name}"]) for name in ("frequency", "damping"))  # type: ignore[arg-type]
    return StudyResult(
        seed, error["composite"], error["dynamic"], frequency, damping, str(parameters[f"{MODE}.note"])
    )


def main() -> None:
    """Print the errors for the seeds on the command line."""
    parser = argparse.ArgumentParser(
        description="Static against dynamic composite self-sensing under a chirp."
    )
    parser.add_argument("seeds", nargs="*", type=int, default=[1, 2, 3, 4, 5])
    extent = preset(DEVICE).deflection_range
    for seed in parser.parse_args().seeds:
        result = study(seed)
        parts = [
            f"{kind} {1e6 * value:.3f} um = {100 * value / extent:.2f} %"
            for kind, value in (("composite", result.composite), ("dynamic", result.dynamic))
        ]
        mode = f"mode {result.frequency:.2f} Hz, damping {result.damping:.4f}"
        ratio = result.dynamic / result.composite
        print(f"seed {seed}: {', '.join(parts)}, ratio {ratio:.3f}; {result.note or mode}", flush=True)


if __name__ == "__main__":
    main()
