"""The comparison of Fig. 7.9: error on a random sequence and time per estimate over the level of the schemes.

`python -m vo2_studies.self_sensing.level_study [SEED ...]` prints one line a level and scheme. Level means plays
for composite and direct EGPI, cells a side for Preisach, degree for the polynomial.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from vo2_models.device import preset, truth
from vo2_models.device.simulation import TRUE_DEFLECTION
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing.characterisation import characterise
from vo2_models.self_sensing.scheme import SelfSensing, self_sensing

__all__ = ["LEVELS", "SCHEMES", "level_errors", "main", "time_per_estimate"]

DEVICE = "integrated"
LEVELS = (6, 7, 8, 9, 10)
SCHEMES = ("composite", "egpi", "preisach", "polynomial")


def time_per_estimate(scheme: SelfSensing, resistance: list[float], rounds: int = 3) -> float:
    """Return the shortest mean time of one `step` over the rounds [s]."""
    best = np.inf
    for _ in range(rounds):
        state = scheme.initial_state()
        started = time.perf_counter()
        for value in resistance:
            scheme.step(value, state)
        best = min(best, time.perf_counter() - started)
    return float(best) / len(resistance)


def level_errors(
    seed: int, level: int, *, walls: int = 30, count: int = 200
) -> dict[str, tuple[float, float]]:
    """Return scheme -> (mean error [m] on the random sequence, time per estimate [s]) of one device and level.

    Identified from the damped oscillation of section 7.3.1 over `walls` cells, 10 ms a level; tested on `count`
    random levels of 10 ms.
    """
    low, high = preset(DEVICE).operating_range
    device = truth(DEVICE, seed=seed)
    loops = low + (high - low) * damped_oscillation(np.linspace(0.0, 1.0, walls + 1))
    recorded = device.simulate(np.concatenate([np.full(30, low), np.repeat(loops, 10)]), seed=seed)
    names = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)
    given = Recording(recorded.time_s, {name: recorded[name] for name in names}, DEVICE)
    parameters = fit_device([given], DEVICE, plays=level).model.to_parameters()
    parameters |= characterise(
        given, parameters, degree=level, plays=level, level=level, composite_plays=level
    )
    sequence = np.repeat(random_levels(low, high, count, seed=seed), 10)
    test = device.simulate(np.concatenate([np.full(30, low), sequence]), seed=seed + 1)
    found = {}
    for kind in SCHEMES:
        scheme = self_sensing(kind, parameters)
        estimate, _ = scheme.estimate(test[RESISTANCE])
        error = float(np.mean(np.abs(np.asarray(estimate.deflection) - test[TRUE_DEFLECTION])[30:]))
        found[kind] = (error, time_per_estimate(scheme, test[RESISTANCE].tolist()))
    return found


def main() -> None:
    """Print error and time of every scheme and level, averaged over the seeds on the command line."""
    parser = argparse.ArgumentParser(description="Error and time per estimate over the level, as Fig. 7.9.")
    parser.add_argument("seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--levels", nargs="+", type=int, default=list(LEVELS))
    given = parser.parse_args()
    extent = preset(DEVICE).deflection_range
    for level in given.levels:
        rows = [level_errors(seed, level) for seed in given.seeds]
        for kind in SCHEMES:
            error, duration = np.mean([row[kind] for row in rows], axis=0)
            print(
                f"level {level:2d} {kind:10s} {1e6 * error:.3f} um = {100 * error / extent:.2f} %, "
                f"{1e6 * duration:.1f} us",
                flush=True,
            )


if __name__ == "__main__":
    main()
