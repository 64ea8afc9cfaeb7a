"""Level and colour of the sensor noise in a residual that also holds a smooth misfit of the model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.noise import samples_apart

__all__ = ["correlation_inflation", "noise_of_residual", "residual_colour"]

Floats = NDArray[np.float64]
QUIETEST = 0.3
"""Share of the samples, those with the least motion, from which the noise is taken."""


def noise_of_residual(residual: Floats, signal: Floats) -> tuple[float, float]:
    """Return standard deviation and AR(1) coefficient of the noise in a residual (n,), NaN where missing.

    Both come from differences of neighbours where the model's own output `signal` (n,) moves least, so that a
    misfit of the loop shape cancels: for an AR(1) noise of variance v and
    coefficient rho, E d_k^2 = 2 v (1 - rho) and E d_k d_(k+1) = -v (1 - rho)^2. A coefficient that is not
    significant (5 standard errors of white noise) is given as 0. Of a channel that is sampled at every m-th sample the neighbours
    are m apart, and the coefficient is the m-th root of theirs; where the signal moves too fast for it, the misfit does not
    cancel and counts as noise, up to the whole residual.
    """
    apart = samples_apart(np.isfinite(residual))
    if apart > 1:
        first = int(np.bincount(np.flatnonzero(np.isfinite(residual)) % apart).argmax())
        level, rho = noise_of_residual(residual[first::apart], signal[first::apart])
        return min(level, float(np.nanstd(residual))), max(rho, 0.0) ** (1.0 / apart)
    d = np.diff(residual)
    motion = np.abs(np.diff(signal))
    motion = np.maximum(motion[:-1], motion[1:])
    pairs = np.isfinite(d[:-1]) & np.isfinite(d[1:])
    if np.any(pairs):
        pairs &= motion <= np.quantile(motion[pairs], QUIETEST)
    count = int(np.count_nonzero(pairs))
    if count < 8:
        raise ValueError(f"residual: found {count} neighbouring differences, need at least 8")
    a, b = d[:-1][pairs], d[1:][pairs]
    # robust against the few samples where a wrong loop shape jumps: clip at six times the median size
    limit = 6.0 * 1.4826 * float(np.median(np.abs(np.concatenate([a, b]))))
    a, b = np.clip(a, -limit, limit), np.clip(b, -limit, limit)
    square = float(0.5 * (a @ a + b @ b) / count)
    if square == 0.0:
        return 0.0, 0.0
    rho = float(np.clip(1.0 + 2.0 * (a @ b) / count / square, -0.95, 0.99))
    if abs(rho) < 5.0 / np.sqrt(count):
        rho = 0.0
    return float(np.sqrt(0.5 * square / (1.0 - rho))), rho


def _autocorrelation(residual: Floats, lags: int) -> Floats:
    e = np.where(np.isfinite(residual), residual - np.nanmean(residual), 0.0)
    size = 2 ** int(np.ceil(np.log2(2 * e.size)))
    power = np.fft.irfft(np.abs(np.fft.rfft(e, size)) ** 2, size)
    if power[0] <= 0.0:
        return np.zeros(lags)
    return power[1 : lags + 1] / power[0]


def residual_colour(residual: Floats, order: int = 2) -> tuple[float, ...]:
    """Return autoregressive coefficients of the whole residual (n,), by Yule-Walker; empty where it is white.

    Parameters
    ----------
    order : most coefficients
    """
    rho = _autocorrelation(residual, order)
    if np.all(np.abs(rho) < 5.0 / np.sqrt(np.count_nonzero(np.isfinite(residual)))):
        return ()
    full = np.concatenate([[1.0], rho])
    matrix = full[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    return tuple(float(v) for v in np.linalg.solve(matrix, rho))


def correlation_inflation(residual: Floats, lags: int = 100) -> float:
    """How much larger a variance is than for white residuals: 1 + 2 sum of the autocorrelations until they vanish.

    Parameters
    ----------
    residual : (n,)
    lags : most terms of the sum

    Returns
    -------
    float : at least 1
    """
    rho = _autocorrelation(residual, min(lags, residual.size // 4))
    stop = np.flatnonzero(rho <= 0.0)
    return 1.0 + 2.0 * float(np.sum(rho[: stop[0]] if stop.size else rho))
