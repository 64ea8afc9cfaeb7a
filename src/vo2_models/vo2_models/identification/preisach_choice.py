"""A Preisach law for the loop of a rig: walls, sign and smoothness by what predicts held-out parts of the calibration.

Walls stand evenly over the loop coordinate, or closer where the response changes much: a film that switches within a
tenth of a volt needs narrow cells there, and nowhere else. The smoothness penalty fills in what the recordings do not
tell.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.hysteresis.preisach.smooth_fit import SmoothProblem

__all__ = ["PreisachChoice", "adapted_walls", "choose_preisach"]

Floats = NDArray[np.float64]
_SHARES = (0.0, 0.5, 0.8)
"""How much of the placing of walls goes by where the response changes."""
_LEVEL, _OTHERS = 20, (10, 30)
_FINE, _FINE_FROM = 60, 3000
"""Level tried where the finest of the others is the best and there are this many samples."""
_STRENGTHS = tuple(np.logspace(1, -9, 6).tolist())
_SAMPLES = 4000
"""Samples by which candidates are judged; the last fit takes all."""
_WORSE = 2
_MESH = 2000


@dataclass(frozen=True)
class PreisachChoice:
    """The chosen law.

    Attributes
    ----------
    law : fitted to all samples
    misfit : root mean square of the residual on held-out parts
    residual : (n,) measured minus law, NaN where there is no value
    words : what it is made of
    held_out : (n,) as `residual`, of fits without each part, NaN where no sample was held out
    """

    law: PreisachOperator
    misfit: float
    residual: Floats = field(repr=False)
    words: str
    held_out: Floats = field(repr=False)


def adapted_walls(path: Floats, values: Floats, level: int, share: float) -> Floats:
    """Return (level + 1,) walls over the path (n,), by `share` where the values (n,) change, the rest evenly.

    Parameters
    ----------
    path, values : (n,) without missing values
    level : number of cells along an axis
    share : 0 for even walls
    """
    low, high = float(path.min()), float(path.max())
    mesh = np.linspace(low, high, _MESH)
    even = (mesh - low) / (high - low)
    middle, change = 0.5 * (path[1:] + path[:-1]), np.abs(np.diff(values))
    order = np.argsort(middle)
    total = np.cumsum(change[order])
    placed = share * np.interp(mesh, middle[order], total / max(total[-1], 1e-300)) + (1.0 - share) * even
    # what changes while the path rests at an end of its range, such as noise, places nothing
    placed = np.maximum.accumulate((placed - placed[0]) / (placed[-1] - placed[0]))
    walls = np.interp(np.linspace(0.0, 1.0, level + 1), placed, mesh)
    walls[0], walls[-1] = low, high
    return walls


@dataclass(frozen=True)
class _Trial:
    error: float
    level: int
    share: float
    strength: float
    nonnegative: bool
    held_out: Floats


def choose_preisach(path: Floats, values: Floats, fold: NDArray[np.int64]) -> PreisachChoice:
    """Return the law that predicts the held-out parts best.

    Parameters
    ----------
    path : (n,) loop coordinate, from lower saturation on
    values : (n,) measured, NaN where missing
    fold : (n,) part that each sample is held out with, -1 for none

    Raises
    ------
    ValueError : nothing is held out, or a path that does not move.
    """
    good = np.isfinite(values)
    if not (fold[good] >= 0).any() or not np.ptp(path[good]) > 0.0:
        raise ValueError("values: found no sample to hold out on a path that moves, need some")
    # what comes before a recording lies far below all walls
    inside = np.maximum(path, path[good].min())
    filled = np.where(good, values, 0.0)
    rows = np.flatnonzero(good)
    rows = rows[np.unique(np.linspace(0, rows.size - 1, min(rows.size, _SAMPLES)).astype(int))]
    used = np.zeros(path.size, dtype=np.bool_)
    used[rows] = True
    part = fold[rows]

    def walls(level: int, share: float) -> Floats:
        return adapted_walls(inside[good], values[good], level, share)

    def tried(level: int, share: float, nonnegative: bool = True) -> _Trial:
        problem = SmoothProblem.of(inside, filled, walls(level, share), used, "triangle", None)
        best, worse = _Trial(np.inf, level, share, _STRENGTHS[0], nonnegative, np.zeros(0)), 0
        for strength in _STRENGTHS:
            left = np.full(part.size, np.nan)
            for k in np.unique(part[part >= 0]):
                masses, constant = problem.solve(strength, part != k, nonnegative)
                left[part == k] = problem.residual(masses, constant)[part == k]
            error = float(np.sqrt(np.nanmean(left**2)))
            worse = 0 if error < best.error else worse + 1
            if error < best.error:
                best = _Trial(error, level, share, strength, nonnegative, left)
            if worse == _WORSE:
                break
        return best

    def searched(nonnegative: bool) -> _Trial:
        best = min((tried(_LEVEL, share, nonnegative) for share in _SHARES), key=lambda one: one.error)
        others = [tried(level, best.share, nonnegative) for level in _OTHERS]
        best = min([best, *others], key=lambda one: one.error)
        if best.level == max(_OTHERS) and np.count_nonzero(good) >= _FINE_FROM:
            best = min(best, tried(_FINE, best.share, nonnegative), key=lambda one: one.error)
        return best

    best = searched(True)
    if tried(best.level, best.share, False).error < best.error:
        best = searched(False)
    grid = walls(best.level, best.share)
    problem = SmoothProblem.of(inside, filled, grid, good, "triangle", None)
    masses, constant = problem.solve(
        best.strength, np.ones(np.count_nonzero(good), dtype=np.bool_), best.nonnegative
    )
    residual = np.full(path.size, np.nan)
    residual[good] = problem.residual(masses, constant)
    placed = "closer where the response changes" if best.share else "evenly spaced"
    sign = "" if best.nonnegative else ", of both signs"
    words = f"Preisach law of {best.level} levels{sign}, {placed}"
    held_out = np.full(path.size, np.nan)
    held_out[rows] = best.held_out
    law = problem.operator(masses, constant, grid, "triangle")
    return PreisachChoice(law, best.error, residual, words, held_out)
