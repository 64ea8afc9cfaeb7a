"""The comparison of section 7.3.1 and Fig. 7.9: errors and time per estimate over the level of the schemes.

`python -m vo2_studies.self_sensing.level_study [SEED ...]` prints one line a level and scheme. Level means plays
for composite and direct EGPI, cells a side for Preisach, degree for the polynomial.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np
from vo2_models.device import preset, truth
from vo2_models.device.simulation import TRUE_DEFLECTION
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing.characterisation import characterise
from vo2_models.self_sensing.scheme import SelfSensing, self_sensing

__all__ = ["LEVELS", "SCHEMES", "SchemeErrors", "level_errors", "main", "time_per_estimate"]

DEVICE = "integrated"
LEVELS = (6, 7, 8, 9, 10)
SCHEMES = ("composite", "egpi", "preisach", "polynomial")


class SchemeErrors(NamedTuple):
    """What one scheme does on one device.

    Attributes
    ----------
    mean_m, largest_m : absolute error on the recording that it was identified from [m]
    random_m : mean absolute error on a random sequence [m]
    time_s : per estimate [s]
    """

    mean_m: float
    largest_m: float
    random_m: float
    time_s: float


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


def level_errors(seed: int, level: int, *, walls: int = 30, count: int = 200) -> dict[str, SchemeErrors]:
    """Return scheme -> errors and time of one device and level.

    Identified from the damped oscillation of section 7.3.1 over `walls` cells, 10 ms a level; tested on that and on `count`
    random levels of 10 ms. Errors are of the true deflection.
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
        identification, random = (
            np.abs(np.asarray(scheme.estimate(one[RESISTANCE])[0].deflection) - one[TRUE_DEFLECTION])[30:]
            for one in (recorded, test)
        )
        found[kind] = SchemeErrors(
            float(identification.mean()),
            float(identification.max()),
            float(random.mean()),
            time_per_estimate(scheme, test[RESISTANCE].tolist()),
        )
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
            found = SchemeErrors(*np.mean([row[kind] for row in rows], axis=0))
            print(
                f"level {level:2d} {kind:10s} {1e6 * found.random_m:.3f} um = {100 * found.random_m / extent:.2f} %, "
                f"identification {1e6 * found.mean_m:.3f} um, largest {1e6 * found.largest_m:.2f}; "
                f"{1e6 * found.time_s:.1f} us",
                flush=True,
            )


if __name__ == "__main__":
    main()
