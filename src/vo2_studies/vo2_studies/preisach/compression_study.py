"""The comparison of section 2.4 in simulation: four coarse grids, predicted output and inverse compensation.

    python -m vo2_studies.preisach.compression_study

The measured density of Fig. 2.2 is not published, so a density of the same kind stands in: a peak off the
diagonal, 40 levels from 30 to 80 degC, -log10 R from -4.28 to -2.34, with the roughness of an identified one.
What carries over: J_KL is best, and has about 0.4 of the uniform grid's error, as published. What does not: the
published J_1 and J_inf grids are worse than the uniform one, here they are nearly as good as J_KL.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vo2_models.hysteresis.preisach.compression import Criterion, compress, evaluate_partition
from vo2_models.hysteresis.preisach.inverse import PreisachInverse
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.identification.excitation import random_levels

__all__ = ["PUBLISHED_MAX_ERROR", "CompressionStudy", "compression_study", "main", "stand_in_density"]

Floats = NDArray[np.float64]

SCHEMES: dict[str, Criterion | None] = {"J_KL": "kl", "J_1": "sum", "J_inf": "max", "uniform": None}
PUBLISHED_MAX_ERROR = {
    "prediction": {"J_KL": 0.23, "uniform": 0.57, "J_1": 1.0, "J_inf": 1.0},
    "inverse": {"J_KL": 0.22, "uniform": 0.56, "J_1": 1.0, "J_inf": 1.0},
}
"""Section 2.4.2, in log10 ohm; those of J_1 and J_inf are lower bounds."""


@dataclass(frozen=True, eq=False)
class CompressionStudy:
    """Largest errors of each scheme, averaged over the densities drawn [log10 ohm].

    Attributes
    ----------
    prediction : scheme -> largest error of the output under a random temperature sequence
    inverse : scheme -> largest error when its inverse drives the original operator
    partitions : scheme -> kept walls of the last density
    """

    prediction: dict[str, float]
    inverse: dict[str, float]
    partitions: dict[str, list[int]]


def stand_in_density(seed: int | np.random.Generator, *, level: int = 40) -> PreisachOperator:
    """Return an operator like that of Fig. 2.2(b): heating near 66 degC, cooling near 58 degC, rough by a third."""
    rng = np.random.default_rng(seed)
    walls = np.linspace(30.0, 80.0, level + 1)
    middle = 0.5 * (walls[1:] + walls[:-1])
    centre_alpha, centre_beta = rng.normal(66.0, 1.0), rng.normal(58.0, 1.0)
    peak = np.exp(
        -0.5 * ((middle[:, None] - centre_alpha) / 3.0) ** 2
        - 0.5 * ((middle[None, :] - centre_beta) / 3.5) ** 2
    )
    cells = np.tril((peak + 0.003) * rng.uniform(2 / 3, 4 / 3, peak.shape))
    shape = PreisachOperator(walls, cells)
    half_range = shape.output_range[1]
    return PreisachOperator(walls, cells * (4.28 - 2.34) / 2 / half_range, -(4.28 + 2.34) / 2)


def compression_study(*, level: int = 4, densities: int = 20, seed: int = 0) -> CompressionStudy:
    """Compress to `level` by each scheme; predict a random sequence, and track a sine of falling amplitude."""
    rng = np.random.default_rng(seed)
    prediction = dict.fromkeys(SCHEMES, 0.0)
    inverse = dict.fromkeys(SCHEMES, 0.0)
    partitions: dict[str, list[int]] = {}
    for _ in range(densities):
        truth = stand_in_density(rng)
        temperature = random_levels(30.0, 80.0, 200, seed=rng)
        time = np.arange(300)
        low, high = truth.output_range
        wanted = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(0.1 * time) * np.exp(-time / 150)
        for name, criterion in SCHEMES.items():
            if criterion is None:
                found = evaluate_partition(
                    truth, np.linspace(0, truth.level, level + 1).round().astype(np.int64)
                )
            else:
                found = compress(truth, level, criterion)
            partitions[name] = found.partition.tolist()
            prediction[name] += (
                float(np.max(np.abs(found.operator(temperature) - truth(temperature)))) / densities
            )
            v, _ = PreisachInverse(found.operator).run(wanted, found.operator.initial_memory())
            inverse[name] += float(np.max(np.abs(truth(v) - wanted))) / densities
    return CompressionStudy(prediction, inverse, partitions)


def main() -> int:
    """Print the largest errors of the four schemes beside the published ones."""
    study = compression_study()
    print(
        f"{'scheme':8} {'prediction':>11} {'published':>10} {'inverse':>9} {'published':>10}   kept walls of 0..40"
    )
    for name in SCHEMES:
        print(
            f"{name:8} {study.prediction[name]:11.3f} {PUBLISHED_MAX_ERROR['prediction'][name]:10.2f} "
            f"{study.inverse[name]:9.3f} {PUBLISHED_MAX_ERROR['inverse'][name]:10.2f}   {study.partitions[name]}"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
