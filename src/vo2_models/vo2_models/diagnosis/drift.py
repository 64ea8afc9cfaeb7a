"""Which constants have moved since the calibration, how far, and how surely."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from vo2_models.diagnosis.nuisance import Constant
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = ["Drift", "drift_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Drift:
    """Posterior of the constants that another day may have moved.

    Attributes
    ----------
    constants : the constants
    move : (d,) posterior mean, in each constant's unit
    std : (d,) posterior standard deviation, what the calibration left open included, widened for misfit that is
        correlated over long stretches
    chi_square : squared move over its covariance: of an unchanged device a chi-square of d degrees of freedom
    weights : (t,) of all thermal columns
    """

    constants: tuple[Constant, ...]
    move: Floats
    std: Floats
    chi_square: float
    weights: Floats

    def widened(self, by: float) -> Drift:
        """Return the same with standard deviations `by` times as large, where more than noise is left.

        Birge's ratio: Phys. Rev. 40, 207, 1932.

        Parameters
        ----------
        by : r.m.s. of what is left over that of the noise, 1 or more
        """
        return replace(self, std=by * self.std, chi_square=self.chi_square / by**2)

    def significant(self, probability: float) -> bool:
        """Whether unchanged constants would move as far with at most this probability."""
        return bool(self.chi_square > chi2.isf(probability, len(self.constants)))

    @property
    def sigmas(self) -> Floats:
        """Distance (d,) of each constant from where it was, in standard deviations."""
        return np.asarray(np.abs(self.move) / self.std)


def drift_of(problem: LinearisedProblem, residual: Floats) -> Drift:
    """Return the posterior of the drifting constants.

    The covariance is (B'B + I)^-1 of the whole nuisance model. It is widened by the sandwich: the influence of each
    sample on an estimate, times what is left of the residual, summed over long stretches, scatters as the deviation says
    only if the residual is noise.

    Parameters
    ----------
    problem : without effects
    residual : (N,) whitened, about the model's own constants
    """
    first = problem.nuisance.shape[1] - len(problem.constants)
    places = [k for k, c in enumerate(problem.constants) if c.drifts]
    constants = tuple(problem.constants[k] for k in places)
    unit = np.zeros((problem.nuisance.shape[1], len(places)))
    unit[[first + k for k in places], np.arange(len(places))] = 1.0
    inverse = problem.nuisance_weights(unit)
    covariance = inverse[[first + k for k in places]]
    influence = problem.nuisance.times(inverse)
    weights = problem.fit_nuisance(residual)
    left = residual - problem.nuisance.times(weights)
    scatter = np.sum(problem.over_stretches(influence * left[:, None]) ** 2, axis=0)
    plain = np.sum(influence**2, axis=0)
    wider = np.sqrt(np.maximum(scatter / np.maximum(plain, 1e-300), 1.0))
    spread = np.array([c.spread for c in constants])
    z = weights[first:][places]
    scaled = covariance * np.outer(wider, wider)
    move, std = spread * z, spread * np.sqrt(np.diag(scaled))
    # of a gain of the resistance the logarithm was fitted
    logarithm = np.where([c.name == "resistance.gain" for c in constants], np.clip(move, -50.0, 50.0), 0.0)
    return Drift(
        constants,
        np.where(logarithm, np.expm1(logarithm), move),
        np.exp(logarithm) * std,
        float(z @ np.linalg.pinv(scaled, hermitian=True) @ z),
        weights[first:],
    )
