"""Starting values for the envelopes, read from the data: where, and over what width, each branch moves."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

__all__ = ["branch_moments", "starting_arguments"]

FloatArray = NDArray[np.float64]

TANH_SPREAD = np.pi / (2 * np.sqrt(3))
"""Standard deviation of the density (1 - tanh^2 x) / 2, the slope of a tanh, in x."""
_BINS = 60


def branch_moments(z: FloatArray, y: FloatArray, rising: bool) -> tuple[float, float]:
    """Centre and standard deviation in z of the output's slope along one branch.

    The slope is the output change per input travel in 60 bins, less its lower quartile (a memoryless background),
    and noise cancels within a bin because changes are summed with their signs.

    Parameters
    ----------
    z : (n,) inputs on [-1, 1]
    y : (n,) outputs
    rising : which branch

    Returns
    -------
    tuple : centre and standard deviation
    """
    dz, dy = np.diff(z), np.diff(y)
    chosen = dz > 0 if rising else dz < 0
    if np.count_nonzero(chosen) < 4:
        return 0.0, 0.5
    at = (0.5 * (z[1:] + z[:-1]))[chosen]
    bins = np.clip(((at + 1) / 2 * _BINS).astype(int), 0, _BINS - 1)
    travel = np.bincount(bins, np.abs(dz[chosen]), _BINS)
    change = np.bincount(bins, dy[chosen], _BINS)
    visited = travel > 0
    slope = np.zeros(_BINS)
    slope[visited] = np.abs(change[visited]) / travel[visited]
    slope[visited] = np.maximum(slope[visited] - np.quantile(slope[visited], 0.25), 0.0)
    total = slope.sum()
    if total <= 0:
        return 0.0, 0.5
    centres = (np.arange(_BINS) + 0.5) / _BINS * 2 - 1
    mean = float(slope @ centres / total)
    spread = float(np.sqrt(slope @ (centres - mean) ** 2 / total))
    return mean, max(spread, 1.0 / _BINS)


def starting_arguments(z: FloatArray, y: FloatArray) -> list[FloatArray]:
    """Candidate envelope arguments (4, 1) = s_R, c_R, s_L, c_L on z in [-1, 1].

    A tanh whose slope has standard deviation d has s = pi / (2 sqrt 3 d). Plays of large radius widen the
    branch beyond their envelopes and move their switching apart, so steeper and closer envelopes are
    tried too, and flat ones for a loop that does not saturate.

    Parameters
    ----------
    z : (n,) inputs on [-1, 1]
    y : (n,) outputs

    Returns
    -------
    list : of arrays (4, 1)
    """
    (rise, rise_width), (fall, fall_width) = branch_moments(z, y, True), branch_moments(z, y, False)
    candidates = []
    for steeper, apart in product((0.25, 0.7, 1.0, 1.6, 2.5), (1.0, 0.4)):
        middle, gap = (rise + fall) / 2, apart * (rise - fall) / 2
        s_r, s_l = steeper * TANH_SPREAD / rise_width, steeper * TANH_SPREAD / fall_width
        candidates.append(np.array([[s_r], [-s_r * (middle + gap)], [s_l], [-s_l * (middle - gap)]]))
    return candidates
