"""The yardstick: a lag and a Preisach operator with piecewise-constant, non-negative density, of the same data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.identification.play_dictionary import nonnegative_weights

__all__ = ["LEVELS", "PlainPrediction", "plain_preisach"]

Floats = NDArray[np.float64]
LEVELS = (10, 20, 30, 40, 60, 80)
"""Cells along an axis that are tried, from the first on until one predicts no better than the one before."""
_LAGS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_SAMPLES = 4000
_RIDGE = 1e-9
"""Share of the mean information of a cell; only cells that never switch feel it."""


@dataclass(frozen=True)
class PlainPrediction:
    """Held-out error of the yardstick.

    Attributes
    ----------
    error : root mean square over the held-out samples, in judged units, at the level that is best there
    level : cells along an axis
    lag_s : [s]
    """

    error: float
    level: int
    lag_s: float


def plain_preisach(
    drives: Sequence[Floats], values: Sequence[Floats], held: Sequence[NDArray[np.bool_]], dt: float
) -> PlainPrediction:
    """Fit the yardstick to the samples that are not held out and judge it on those that are.

    Lag and sense are those that fit the calibration best at the lowest level; the level is the one that predicts best of those
    that are tried, which favours the yardstick.

    Parameters
    ----------
    drives, values, held : (n,) for each recording: drive, judged response (NaN where missing), whether it is held out
    dt : sample period [s]
    """
    target, hidden = np.concatenate(list(values)), np.concatenate(list(held))
    good = np.isfinite(target)
    train, test = np.flatnonzero(good & ~hidden), good & hidden
    train = train[np.unique(np.linspace(0, train.size - 1, min(train.size, _SAMPLES)).astype(int))]
    low, high = min(float(d.min()) for d in drives), max(float(d.max()) for d in drives)

    def predicted(lag: float, sense: float, level: int) -> Floats:
        first, last = sorted((sense * low, sense * high))
        walls = np.linspace(first, last, level + 1)
        cells = []
        for drive in drives:
            felt = sense * drive
            if lag:
                keep = np.exp(-1.0 / lag)
                felt = lfilter([1.0 - keep], [1.0, -keep], felt, zi=[keep * felt[0]])[0]
            cells.append(signed_area_matrix(felt, walls))
        columns = np.vstack(cells)
        used, y = columns[train], target[train]
        normal = used.T @ used
        count = level * (level + 1) // 2
        normal[np.diag_indices(count)] += _RIDGE * float(np.mean(np.diag(normal)[:count]))
        return np.asarray(columns @ nonnegative_weights(normal, used.T @ y, count))

    def error(output: Floats, where: NDArray[np.bool_] | NDArray[np.intp]) -> float:
        return float(np.sqrt(np.mean((output - target)[where] ** 2)))

    tried = [(lag, sense) for lag in _LAGS for sense in (1.0, -1.0)]
    lag, sense = min(tried, key=lambda one: error(predicted(one[0], one[1], LEVELS[0]), train))
    best = PlainPrediction(np.inf, LEVELS[0], lag * dt)
    for level in LEVELS:
        there = error(predicted(lag, sense, level), test)
        if there >= best.error:
            break
        best = replace(best, error=there, level=level)
    return best
