"""A dense set of plays of which a convex fit takes the ones it needs: any loop shape, without a start that can be wrong.

Each play has tanh envelopes of one slope, a centre and a half width; together they tile the half plane of centres and
widths as the cells of a Preisach model tile it, but smoothly. Weights that are not negative, beside a polynomial, come
from one quadratic program; a ridge keeps down what the data do not tell. Levenberg-Marquardt on the strongest plays can
then move and sharpen them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import nnls

from vo2_models.hysteresis.fitting_kernels import regressors, without_closed_loops
from vo2_models.identification.bank_fit import POLYNOMIAL_CENTRE, POLYNOMIAL_SCALE, BankShape, Late

__all__ = ["FOLDS", "DictionaryFit", "PlayDictionary", "fit_dictionary", "fold_of", "nonnegative_weights"]

Floats = NDArray[np.float64]
FOLDS = 4
"""Parts of a calibration that are held out in turn."""
_BLOCKS_PER_FOLD = 6
_RIDGES = (1e-6, 1e-4, 1e-2)
"""Ridges tried, as shares of the mean information of a column."""
_FADED = 1e-5
"""Share of the largest weight below which a play is left out."""
_MARGIN = 0.05
_ELEMENTS = 10_000_000
"""Outputs of plays that are held at a time."""
_NARROWEST, _WIDEST = 0.004, 0.5


@dataclass(frozen=True)
class PlayDictionary:
    """Plays over a range of the loop coordinate.

    Attributes
    ----------
    centre, half_width : (N,) [degC, K]
    slope : of all envelopes [1/K]
    """

    centre: Floats
    half_width: Floats
    slope: float

    @classmethod
    def over(cls, low: float, high: float, *, centres: int, widths: int) -> PlayDictionary:
        """Return plays on a grid: evenly in the centre over (low, high) and a little beyond, geometrically in width."""
        span = high - low
        centre = np.linspace(low - _MARGIN * span, high + _MARGIN * span, centres)
        half_width = np.geomspace(_NARROWEST * span, _WIDEST * span, widths)
        grid = np.meshgrid(centre, half_width, indexing="ij")
        return cls(grid[0].ravel(), grid[1].ravel(), 1.0 / float(centre[1] - centre[0]))

    def features(self, path: Floats) -> Floats:
        """Outputs (n, N) of the plays along a path (n,), each from 0 in lower saturation to 2 in upper."""
        rise, fall = self.centre + self.half_width, self.centre - self.half_width
        slope = np.full(self.centre.size, self.slope)
        envelopes = np.array(
            [slope, -slope * (rise - POLYNOMIAL_CENTRE), slope, -slope * (fall - POLYNOMIAL_CENTRE)]
        )
        out = np.empty((path.size, self.centre.size))
        regressors(path - POLYNOMIAL_CENTRE, envelopes, np.zeros(self.centre.size), True, out)
        out += 1.0
        return out

    def at(self, path: Floats, rows: NDArray[np.intp], late: Late | None) -> Floats:
        """Outputs (m, N) at some samples (m,) of a path (n,), behind what is behind the plays."""
        if late is None:
            needed = np.zeros(path.size, dtype=np.bool_)
            needed[rows] = True
            few = without_closed_loops(path, needed)
            return self.features(path[few])[np.searchsorted(few, rows)]
        # not all at once: a long path by many plays does not fit into memory
        pieces = -(-path.size * self.centre.size // _ELEMENTS)
        parts = np.array_split(np.arange(self.centre.size), pieces)
        plays = [PlayDictionary(self.centre[k], self.half_width[k], self.slope) for k in parts]
        return np.hstack([late.through(some.features(path))[rows] for some in plays])


@dataclass(frozen=True)
class DictionaryFit:
    """Weights of a dictionary's plays, and how well they predict what they were not given.

    Attributes
    ----------
    dictionary : the plays
    weights : (N,) in units of the channel, not negative unless that was asked for
    polynomial : (degree + 1,) in powers of (path - 60) / 30
    misfit : root mean square of the residual on held-out parts
    held_out : (n,) residual of each sample in the fit that was not given it; NaN where there is no value
    """

    dictionary: PlayDictionary
    weights: Floats
    polynomial: Floats
    misfit: float
    held_out: Floats = field(repr=False)

    def residual(self, path: Floats, values: Floats) -> Floats:
        """Return what the fit leaves of values (n,) along a path (n,) [degC], NaN where missing, nothing behind the plays."""
        x = (path - POLYNOMIAL_CENTRE) / POLYNOMIAL_SCALE
        output = self.dictionary.features(path) @ self.weights
        return np.asarray(values - output - np.polynomial.polynomial.polyval(x, self.polynomial))

    def shape(self, most: int | None = None, *, degree: int = 3) -> BankShape:
        """Return the plays with a weight, at most the `most` heaviest, as the shape of a bank."""
        order = np.argsort(-self.weights)[:most]
        kept = order[self.weights[order] > _FADED * self.weights.max()] if self.weights.any() else order[:1]
        weight = np.maximum(self.weights[kept], 1e-300)
        polynomial = np.zeros(degree + 1)
        polynomial[: self.polynomial.size] = self.polynomial
        polynomial[0] += weight.sum()  # a play of the bank runs from -1, one of the features from 0
        return BankShape(
            np.full(kept.size, np.log(self.dictionary.slope)),
            self.dictionary.centre[kept],
            np.log(self.dictionary.half_width[kept]),
            np.log(weight),
            polynomial,
        )


def fold_of(good: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the part (n,) that each sample with a value belongs to, in blocks of time; -1 for the others.

    Parameters
    ----------
    good : (n,) whether a sample has a value
    """
    count = int(np.count_nonzero(good))
    block = np.arange(count) * FOLDS * _BLOCKS_PER_FOLD // max(count, 1)
    fold = np.full(good.size, -1, dtype=np.int64)
    # the order turns on after each round, so that recordings of equal length are not cut at the same places
    fold[good] = (block + block // FOLDS) % FOLDS
    return fold


def fit_dictionary(
    dictionary: PlayDictionary,
    path: Floats,
    values: Floats,
    *,
    degree: int,
    most: int = 4000,
    fold: NDArray[np.int64] | None = None,
    late: Late | None = None,
    signed: bool = False,
) -> DictionaryFit:
    """Fit weights and polynomial; the ridge is the one that predicts held-out blocks best.

    Parameters
    ----------
    path : (n,) loop coordinate, from lower saturation on
    values : (n,) measured, NaN where missing
    degree : of the polynomial
    most : samples used, spread evenly over those with a value
    dictionary : plays on a grid
    fold : (n,) part that each sample is held out with, -1 for none; by default blocks of time
    late : what comes behind the plays, or behind all
    signed : whether weights may be negative, as where a response turns within the loop (a butterfly)

    Returns
    -------
    DictionaryFit : weights, polynomial and the error on held-out blocks

    Raises
    ------
    ValueError : fewer values than twice the folds.
    """
    good = np.flatnonzero(np.isfinite(values))
    if good.size < 2 * FOLDS:
        raise ValueError(f"values: found {good.size} measured, need at least {2 * FOLDS}")
    rows = good[np.unique(np.linspace(0, good.size - 1, min(good.size, most)).astype(int))]
    powers = np.vander((path - POLYNOMIAL_CENTRE) / POLYNOMIAL_SCALE, degree + 1, increasing=True)
    if late and late.whole:
        powers = late.through(powers)
    columns = np.hstack([dictionary.at(path, rows, late), powers[rows]])
    centre = float(np.mean(values[rows]))
    target = values[rows] - centre
    plays = dictionary.centre.size
    part = fold_of(np.ones(rows.size, dtype=np.bool_)) if fold is None else fold[rows]
    parts = np.unique(part[part >= 0])
    grams = [columns[part == k].T @ columns[part == k] for k in parts]
    rights = [columns[part == k].T @ target[part == k] for k in parts]
    if np.any(part < 0):
        always = columns[part < 0]
        gram, right = always.T @ always + sum(grams), always.T @ target[part < 0] + sum(rights)
    else:
        gram, right = sum(grams), sum(rights)
    size = np.mean(np.diag(gram)[:plays])

    def solved(normal: Floats, side: Floats, ridge: float) -> Floats:
        damped = normal.copy()
        damped[np.diag_indices_from(damped)] += ridge * size
        return cho_solve(cho_factor(damped), side) if signed else nonnegative_weights(damped, side, plays)

    tried = []
    for ridge in _RIDGES:
        gap = np.full(rows.size, np.nan)
        for k, own, side in zip(parts, grams, rights, strict=True):
            weights = solved(gram - own, right - side, ridge)
            gap[part == k] = target[part == k] - columns[part == k] @ weights
        tried.append((float(np.sqrt(np.nanmean(gap**2))), ridge, gap))
    misfit, ridge, gap = min(tried, key=lambda one: one[0])
    weights = solved(gram, right, ridge)
    held_out = np.full(values.size, np.nan)
    held_out[rows] = gap
    polynomial = weights[plays:].copy()
    polynomial[0] += centre
    return DictionaryFit(dictionary, weights[:plays], polynomial, misfit, held_out)


def nonnegative_weights(normal: Floats, right: Floats, bounded: int) -> Floats:
    """Minimise x'Nx/2 - r'x with the first `bounded` elements not negative; N (n, n) positive definite.

    The free elements are eliminated; the rest is least squares with the Cholesky factor, by Lawson and Hanson's active
    set, which always ends, also where plays are alike.

    Parameters
    ----------
    normal : (n, n) matrix N
    right : (n,) vector r
    bounded : number of elements that are not negative, the first ones

    Returns
    -------
    (n,) x
    """
    free = cho_factor(normal[bounded:, bounded:])
    cross = normal[:bounded, bounded:]
    reduced = normal[:bounded, :bounded] - cross @ cho_solve(free, cross.T)
    # rounding must not make it indefinite where plays are alike
    reduced[np.diag_indices(bounded)] += 1e-12 * np.trace(reduced) / bounded
    factor = cholesky(reduced, lower=True)
    target = solve_triangular(factor, right[:bounded] - cross @ cho_solve(free, right[bounded:]), lower=True)
    weights, _ = nnls(factor.T, target, maxiter=30 * bounded)
    return np.concatenate([weights, cho_solve(free, right[bounded:] - cross.T @ weights)])
