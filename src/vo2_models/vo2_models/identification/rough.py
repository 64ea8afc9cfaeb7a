"""Cells of the Preisach plane as plays with a ramp: the part of a density that is rough, not smooth.

A film of N domains has a density that scatters: a cell that should hold a share p of them holds p with a
standard deviation of sqrt(p / N), independent of its neighbours. No smooth basis follows that. One basis
function per cell does: a domain group that switches on while the temperature rises from alpha to alpha + h
and off while it falls from beta + h to beta (a play of (B.5)-(B.6) with clipped linear envelopes).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.numerics.kernel import kernel

__all__ = ["cell_features", "cell_sum"]

Floats = NDArray[np.float64]


@kernel(nogil=True)
def _move(x, last, p):
    """Bring the cells' on-fractions p (a, w) from grid coordinate `last` to x; beta of cell (i, j) is i - 1 - j."""
    rows, widths = p.shape
    if x > last:
        for i in range(max(int(np.floor(last)), 0), min(int(np.floor(x)), rows - 1) + 1):
            c = min(max(x - i, 0.0), 1.0)
            for j in range(widths):
                if p[i, j] < c:
                    p[i, j] = c
    elif x < last:
        first, final = int(np.floor(x)), int(np.floor(last))
        for i in range(max(first + 1, 0), min(final + widths, rows - 1) + 1):
            for j in range(max(i - 1 - final, 0), min(i - 1 - first, widths - 1) + 1):
                c = min(max(x - (i - 1 - j), 0.0), 1.0)
                if p[i, j] > c:
                    p[i, j] = c


@kernel(nogil=True)
def _features(temperature, low, step, chosen, rows, widths, out):
    p = np.zeros((rows, widths))
    flat = p.reshape(-1)
    last = -1.0
    for k in range(temperature.size):
        x = min(max((temperature[k] - low) / step, -float(widths) - 2.0), rows + 1.0)
        _move(x, last, p)
        last = x
        for b in range(chosen.size):
            out[k, b] = flat[chosen[b]]


@kernel(nogil=True)
def _sum(temperature, low, step, weights, out):
    rows, widths = weights.shape
    p = np.zeros((rows, widths))
    last = -1.0
    total = 0.0
    for k in range(temperature.size):
        x = min(max((temperature[k] - low) / step, -float(widths) - 2.0), rows + 1.0)
        if x > last:
            for i in range(max(int(np.floor(last)), 0), min(int(np.floor(x)), rows - 1) + 1):
                c = min(max(x - i, 0.0), 1.0)
                for j in range(widths):
                    if p[i, j] < c:
                        total += weights[i, j] * (c - p[i, j])
                        p[i, j] = c
        elif x < last:
            first, final = int(np.floor(x)), int(np.floor(last))
            for i in range(max(first + 1, 0), min(final + widths, rows - 1) + 1):
                for j in range(max(i - 1 - final, 0), min(i - 1 - first, widths - 1) + 1):
                    c = min(max(x - (i - 1 - j), 0.0), 1.0)
                    if p[i, j] > c:
                        total += weights[i, j] * (c - p[i, j])
                        p[i, j] = c
        last = x
        out[k] = total


def cell_features(
    temperature: Floats, *, low: float, step: float, shape: tuple[int, int], chosen: NDArray[np.int64]
) -> Floats:
    """On-fractions of chosen cells, from a cold rest.

    Parameters
    ----------
    temperature : (n,) [degC]
    low, step : alpha of the lowest row, and size of a cell [degC, K]
    shape : rows (alpha = low + i step) and widths (beta = alpha - (1 + j) step)
    chosen : (m,) flat indices of the cells wanted

    Returns
    -------
    (n, m), each 0 to 1
    """
    out = np.empty((temperature.size, chosen.size))
    _features(temperature, low, step, chosen, *shape, out)
    return out


def cell_sum(temperature: Floats, *, low: float, step: float, weights: Floats) -> Floats:
    """Weighted sum of all cells' on-fractions, (n,); `weights` (rows, widths).

    Parameters
    ----------
    temperature : (n,) [degC]
    low : lowest threshold [degC]
    step : side of a cell [K]

    Returns
    -------
    array : (n,)
    """
    out = np.empty(temperature.size)
    _sum(temperature, low, step, weights, out)
    return out
