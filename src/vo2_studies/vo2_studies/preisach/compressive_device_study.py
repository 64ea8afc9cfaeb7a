"""The comparison of section 4.4 on the simulated `integrated` device: what compressive sensing gains there.

    python -m vo2_studies.preisach.compressive_device_study [--runs 10] [--outside-always]

The deflection is measured once under the damped oscillation of level 30 and one temperature more, for the
linear term of (4.19); a part of these 467 outputs is then used, drawn anew in each run. As in section 4.4, what
all outputs give counts as the true density, and "CS Order" takes its order from all of them: an oracle.

The published order of CS, CS Order and CS Order Non-negative holds on every device tried. Their ratios to least
squares do not settle to one value: the linear term hangs on the one sample outside the walls, and where its noise
asks for a slope that non-negative densities cannot make up for, least squares is about five times worse than CS
Order Non-negative (ratios 0.14 to 0.19 of the modelling error, published 0.13); on the other devices the two are
nearly equal (0.65 to 0.95; 300 and 150 outputs, two runs). CS without the oracle is worse than least squares on all
of them (published 0.77).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from vo2_models.device import preset, truth
from vo2_models.hysteresis.preisach.grid import cell_count
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.recording import TIP_DEFLECTION

from vo2_studies.preisach.compressive_sensing import identify_compressed

__all__ = ["METHODS", "PUBLISHED", "CompressiveDeviceStudy", "compressive_device_study", "main"]

Floats = NDArray[np.float64]

METHODS = ("Least Squares", "CS", "CS Order", "CS Order Non-negative")
PUBLISHED = {
    "model": {"CS": 0.768, "CS Order": 0.253, "CS Order Non-negative": 0.134},
    "random input": {"CS": 0.845, "CS Order": 0.784, "CS Order Non-negative": 0.729},
}
"""Section 4.4.2: average error as a share of that of "Least Squares"."""

LEVEL = 30
COLD, HOT, BEYOND = 36.0, 94.0, 96.0
"""Walls' ends and the sample outside them [degC]."""
SETTLE_S = 0.05


@dataclass(frozen=True, eq=False)
class CompressiveDeviceStudy:
    """Averages over the runs: measure -> (P, methods) RMSE, deflections in um, density in um/K^2."""

    measurements: tuple[int, ...]
    errors: dict[str, Floats]

    def ratio(self, measure: str, method: str) -> float:
        """Return the mean over the numbers of measurements of the error over that of least squares."""
        table = self.errors[measure]
        return float(np.mean(table[:, METHODS.index(method)] / table[:, 0]))


def compressive_device_study(
    measurements: Sequence[int] = tuple(range(100, 451, 50)),
    *,
    runs: int = 10,
    seed: int = 0,
    outside_always: bool = False,
) -> CompressiveDeviceStudy:
    """Identify (4.19) from parts of one recording of a simulated device.

    Parameters
    ----------
    measurements : numbers of outputs used
    runs : choices of outputs per number; the dissertation has 1000
    seed : of the device and the choices
    outside_always : measure the sample outside the walls in every run, instead of by chance

    Raises
    ------
    ValueError : `runs` below 1.
    """
    if runs < 1:
        raise ValueError(f"runs: found {runs}, need at least 1")
    device, nominal = truth("integrated", seed=seed), preset("integrated")
    factor = (nominal.steady_temperature(0.008) - nominal.steady_temperature(0.0)) / 0.008**2

    def deflection_um(temperature: Floats, run: int) -> Floats:
        current = np.sqrt((temperature - nominal.steady_temperature(0.0)) / factor)
        return 1e6 * device.simulate(current, dt=SETTLE_S, seed=run)[TIP_DEFLECTION]

    walls = np.linspace(COLD, HOT, LEVEL + 1)
    inputs = np.append(damped_oscillation(walls), BEYOND)
    rng = np.random.default_rng(seed)
    probe = np.r_[COLD, random_levels(COLD, HOT, 300, seed=rng)]
    measured, answer = deflection_um(inputs, 1), deflection_um(probe, 2)
    cells = cell_count(LEVEL)
    # the linear term is centred and scaled like the areas, which changes its coefficient only
    matrix, probing = (signed_area_matrix(v, walls, linear=True) for v in (inputs, probe))
    for system in (matrix, probing):
        system[:, -1] = (system[:, -1] - 0.5 * (COLD + HOT)) / (HOT - COLD)
    bounded = np.arange(matrix.shape[1]) < cells
    complete = np.linalg.solve(matrix, measured)
    order = np.argsort(measured)
    errors = {
        key: np.zeros((len(measurements), len(METHODS))) for key in ("density", "model", "random input")
    }
    for point, count in enumerate(measurements):
        for _ in range(runs):
            rows = np.sort(rng.choice(measured.size - outside_always, count - outside_always, replace=False))
            if outside_always:
                rows = np.append(rows, measured.size - 1)
            wide = nnls(np.hstack([matrix[rows], -matrix[rows][:, cells:]]), measured[rows])[0]
            plain = wide[: cells + 2].copy()
            plain[cells:] -= wide[cells + 2 :]
            found = [plain]
            for oracle, positive in ((None, None), (order, None), (order, bounded)):
                found.append(
                    identify_compressed(
                        measured[rows], rows, matrix, order=oracle, nonnegative=positive
                    ).parameters
                )
            for column, w in enumerate(found):
                for key, error in (
                    ("density", (w - complete)[:cells]),
                    ("model", matrix @ w - measured),
                    ("random input", probing @ w - answer),
                ):
                    errors[key][point, column] += np.sqrt(np.mean(error**2)) / runs
    return CompressiveDeviceStudy(tuple(int(m) for m in measurements), errors)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of section 4.4 beside the published ratios."""
    parser = argparse.ArgumentParser(
        prog="python -m vo2_studies.preisach.compressive_device_study", description=main.__doc__
    )
    parser.add_argument(
        "--runs", type=int, default=10, help="per number of measurements (dissertation: 1000)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the device and the choices")
    parser.add_argument(
        "--outside-always", action="store_true", help="always measure the sample outside the walls"
    )
    chosen = parser.parse_args(arguments)
    study = compressive_device_study(runs=chosen.runs, seed=chosen.seed, outside_always=chosen.outside_always)
    for measure, table in study.errors.items():
        print(f"\nmean RMSE, {measure}")
        print("  measurements " + "".join(f"{name:>24}" for name in METHODS))
        for count, row in zip(study.measurements, table, strict=True):
            print(f"  {count:12d} " + "".join(f"{value:24.4g}" for value in row))
        for name in METHODS[1:]:
            published = PUBLISHED.get(measure, {}).get(name)
            print(
                f"  {name} over Least Squares: {study.ratio(measure, name):.3f} (published {published or '-'})"
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
