"""Standard deviations of a fitted bank's parameters, as the model file states them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.identification.bank_fit import POLYNOMIAL_CENTRE, POLYNOMIAL_SCALE, BankFit
from vo2_models.identification.noise import correlation_inflation

__all__ = ["bank_uncertainty", "shape_covariance"]

Floats = NDArray[np.float64]


def shape_covariance(fit: BankFit) -> Floats:
    """Return the linearised covariance (p, p) of the fitting coordinates, for a residual that may be correlated.

    A ridge of one per mille of each parameter's own information stands for directions the data say nothing about.

    Parameters
    ----------
    fit : of one channel
    """
    ok = np.isfinite(fit.residual)
    j = fit.jacobian[ok]
    variance = float(np.mean(fit.residual[ok] ** 2)) * correlation_inflation(fit.residual)
    scale = np.sqrt(np.einsum("ij,ij->j", j, j))
    scale = np.where(scale > 0.0, scale, 1.0)
    normal = (j / scale).T @ (j / scale)
    inverse = np.linalg.inv(normal + 1e-3 * np.eye(normal.shape[0]))
    return inverse * variance / np.outer(scale, scale)


def bank_uncertainty(fit: BankFit) -> dict[str, tuple[float, ...]]:
    """Return one standard deviation of each array of the fitted `PlayBank`, by the array's name.

    Parameters
    ----------
    fit : of one channel
    """
    covariance = shape_covariance(fit)
    shape = fit.shape
    n = shape.centre.size
    order = np.argsort(shape.log_width)
    slope, width, weight = (np.exp(v) for v in (shape.log_slope, shape.log_width, shape.log_weight))
    found: dict[str, Floats] = {}
    rows = np.zeros((3, n, covariance.shape[0]))
    k = np.arange(n)
    for sign, name, row in ((1.0, "rising_offsets", 0), (-1.0, "falling_offsets", 1)):
        # offset = -a (m + sign h), in the coordinates log a, m, log h
        rows[row, k, k] = -slope * (shape.centre + sign * width)
        rows[row, k, n + k] = -slope
        rows[row, k, 2 * n + k] = -sign * slope * width
        found[name] = _deviation(rows[row], covariance)[order]
    deviation = np.sqrt(np.diag(covariance))
    found["rising_slopes"] = found["falling_slopes"] = (slope * deviation[:n])[order]
    found["weights"] = (weight * deviation[3 * n : 4 * n])[order]
    found["polynomial"] = _deviation(_to_powers(shape.polynomial.size), covariance[4 * n :, 4 * n :])
    return {name: tuple(values.tolist()) for name, values in found.items()}


def _deviation(rows: Floats, covariance: Floats) -> Floats:
    return np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows))


def _to_powers(size: int) -> Floats:
    """Matrix from coefficients of ((T - 60) / 30)^k to coefficients of T^k."""
    line = np.polynomial.Polynomial([-POLYNOMIAL_CENTRE / POLYNOMIAL_SCALE, 1.0 / POLYNOMIAL_SCALE])
    matrix = np.zeros((size, size))
    for k in range(size):
        power = (line**k).coef
        matrix[: power.size, k] = power
    return matrix
