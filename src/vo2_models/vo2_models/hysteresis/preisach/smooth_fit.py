"""Smoothness-regularised identification, its strength and the sign of the density chosen by cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from vo2_models.hysteresis.preisach.everett_rows import (
    everett_rows,
    mass_map,
    node_values,
)
from vo2_models.hysteresis.preisach.grid import Diagonal, cell_areas, cell_count, checked_walls, pack
from vo2_models.hysteresis.preisach.interior_point import nonnegative_masses, signed_masses
from vo2_models.hysteresis.preisach.least_squares import PreisachFit
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.numerics.parallel import parallel_map
from vo2_models.validation import finite_array

__all__ = ["STRENGTHS", "SmoothFit", "fit_smooth", "roughness"]

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

STRENGTHS = tuple(np.logspace(1, -9, 11).tolist())
"""Strengths tried by default, relative to the data's weight, from the smoothest down."""

_RIDGE = 1e-10
"""Relative to the data's weight on each mass: far below the noise of any recording."""

_STRIDE = 2
"""Every how many strengths one is tried until one predicts worse than the best; then the neighbours of the best."""
_HELD_OUT_GAP = 1e-8
"""Duality gap of a fit that is only compared with others: it moves the error by less than 1e-3 of itself."""


@dataclass(frozen=True, eq=False)
class SmoothFit(PreisachFit):
    """What `fit_smooth` found, beside a `PreisachFit`.

    Attributes
    ----------
    strength : the one used
    strengths, held_out_rmse : candidates, and the error on the folds left out [output unit], for the sign used; inf
        where a candidate was not tried any more
    nonnegative : whether densities were held at or above 0
    """

    strength: float
    strengths: Floats
    held_out_rmse: Floats
    nonnegative: bool


def roughness(walls: Floats) -> sparse.csr_matrix:
    """Return R (m, L (L + 1) / 2): second differences of the density along alpha, beta and the diagonal.

    The cells on the diagonal, which also carry what is reversible, are compared with each other only. Cells
    more than three times as wide as the median are left alone.

    Parameters
    ----------
    walls : (L + 1,) increasing
    """
    level = walls.size - 1
    width = np.diff(walls)
    usual = width <= 3 * np.median(width)

    def index(i: NDArray[np.intp], j: NDArray[np.intp]) -> NDArray[np.intp]:
        return i * (i + 1) // 2 + j

    i, j = np.tril_indices(level, -1)
    k = np.arange(level)
    rows, columns, values, count = [], [], [], 0
    for centre_i, centre_j, step_i, step_j in ((i, j, 1, 0), (i, j, 0, 1), (k, k, 1, 1)):
        low_i, low_j, high_i, high_j = (
            centre_i - step_i,
            centre_j - step_j,
            centre_i + step_i,
            centre_j + step_j,
        )
        apart = 1 if step_i != step_j else 0
        there = (low_j >= 0) & (high_i < level) & (low_i - low_j >= apart) & (high_i - high_j >= apart)
        a, b = np.clip(centre_i, 1, level - 2), np.clip(centre_j, 1, level - 2)
        there &= (usual[a - 1] & usual[a + 1] & usual[a]) if step_i else True
        there &= (usual[b - 1] & usual[b + 1] & usual[b]) if step_j else True
        row = count + np.arange(np.count_nonzero(there))
        count += row.size
        for place_i, place_j, value in (
            (low_i, low_j, 1.0),
            (centre_i, centre_j, -2.0),
            (high_i, high_j, 1.0),
        ):
            rows.append(row)
            columns.append(index(place_i[there], place_j[there]))
            values.append(np.full(row.size, value))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.coo_matrix(entries, shape=(count, cell_count(level))).tocsr()


@dataclass(frozen=True, eq=False)
class SmoothProblem:
    """The sparse form of a recording and of the penalty, for fits of parts of it.

    Attributes
    ----------
    rows, outputs : output = constant + rows @ E in the Everett function at the nodes, see `everett_rows`
    shift : bias = constant + shift * E[L, 0]
    penalty : (K, K) for a strength of 1, in the node values
    ridge : (K, K)
    areas : (K,) of the cells
    """

    rows: sparse.csr_array
    outputs: Floats
    shift: float
    penalty: sparse.csr_array
    ridge: sparse.csr_array
    areas: Floats

    @classmethod
    def of(
        cls,
        v: Floats,
        u: Floats,
        walls: Floats,
        used: Booleans,
        diagonal: Diagonal,
        history: ArrayLike | None,
    ) -> SmoothProblem:
        """Assemble the problem from the samples `used` of a recording."""
        level = walls.size - 1
        rows = everett_rows(v, walls, history=history, kept=used)
        # where all samples lie below the same saturation, the corner node fills a column that the constant can take
        corner = cell_count(level - 1)
        column = rows[:, [corner]].toarray().ravel()
        usual = float(np.median(column))
        column -= usual
        column[np.abs(column) < 1e-12] = 0.0
        keep = np.ones(rows.shape[1])
        keep[corner] = 0.0
        there = np.flatnonzero(column)
        place = (column[there], (there, np.full(there.size, corner)))
        rows = (rows @ sparse.diags_array(keep) + sparse.coo_array(place, shape=rows.shape)).tocsr()
        rows.eliminate_zeros()

        areas = pack(cell_areas(walls, diagonal))
        mass = mass_map(level)
        rough = sparse.csr_array(roughness(walls))
        curved = (rough @ sparse.diags_array(1.0 / areas) @ mass).tocsr()
        weight = rows.shape[0] * float(areas @ areas)
        weight /= max(float(rough.power(2).sum()), np.finfo(float).tiny)
        ridge = _RIDGE * rows.shape[0] * (mass.T @ mass)
        return cls(rows, u[used], 1.0 - usual, (weight * (curved.T @ curved)).tocsr(), ridge.tocsr(), areas)

    def solve(
        self, strength: float, part: Booleans, nonnegative: bool, **settings: float
    ) -> tuple[Floats, float]:
        """Return masses (K,) and the constant, fitted on a part of the samples; settings of `nonnegative_masses`."""
        rows, outputs = self.rows[part], self.outputs[part]
        penalty = strength * self.penalty
        if not nonnegative:
            return signed_masses(rows, outputs, penalty + self.ridge)
        found = nonnegative_masses(rows, outputs, penalty, **settings)
        return found.masses, found.constant

    def residual(self, masses: Floats, constant: float) -> Floats:
        """Measured minus modelled output of all samples (n,)."""
        return np.asarray(self.outputs - constant - self.rows @ node_values(masses), dtype=np.float64)

    def held_out(self, nonnegative: bool, case: tuple[float, Booleans]) -> float:
        """Return the squared error on a part (n,) of the samples of a fit of a strength to all others."""
        strength, out = case
        masses, constant = self.solve(strength, ~out, nonnegative, tolerance=_HELD_OUT_GAP)
        return float(np.sum(self.residual(masses, constant)[out] ** 2))

    def operator(
        self, masses: Floats, constant: float, walls: Floats, diagonal: Diagonal
    ) -> PreisachOperator:
        """Return the operator of these masses."""
        return PreisachOperator(
            walls, masses / self.areas, constant + self.shift * float(masses.sum()), diagonal
        )


def fit_smooth(
    v: ArrayLike,
    u: ArrayLike,
    walls: ArrayLike,
    *,
    nonnegative: bool | None = True,
    groups: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    strengths: Sequence[float] = STRENGTHS,
    folds: int = 5,
    diagonal: Diagonal = "triangle",
    history: ArrayLike | None = None,
) -> SmoothFit:
    """Minimise |S w - u|^2 + strength |R mu|^2 over densities mu (>= 0, or of any sign) and a free bias.

    The strength is in units of (samples) (sum of squared areas) / trace(R'R). Each candidate is fitted with a part of the
    recording left out, in turn, and the one that predicts the parts left out best is used on all. Neighbouring samples
    resemble each other, so parts are whole `groups`: reversal curves, or blocks of time.

    Any level will do: all is sparse in the Everett function at the nodes (`everett_rows`). Signed fits are one sparse
    factorisation each, non-negative ones an interior point. Every other strength is tried from the smoothest down until one
    predicts worse than the best so far, then the neighbours of the best.

    Parameters
    ----------
    v, u : (n,) input and measured output
    walls : (L + 1,) increasing input levels, evenly spaced or not
    nonnegative : demand densities >= 0; False admits negative ones, as measured first-order reversal curves show where
        hysterons interact; None lets the parts left out decide
    groups : (n,) integer label of the curve or block of each sample; by default ten blocks per fold
    measured : (n,) False where the output is not to be used and only the input matters
    strengths : candidates; a single one is used without cross-validation
    folds : number of parts, each of every `folds`-th group
    diagonal, history : as in `fit_preisach`. There is no linear term: a constant density on the diagonal is one, and
        smooth, so that the two could not be told apart.

    Returns
    -------
    SmoothFit : operator, residual, and the strength that held-out folds chose

    Raises
    ------
    ValueError : not finite, shapes differ, negative strengths, or fewer groups than folds.

    Examples
    --------
    >>> from vo2_models.identification.excitation import first_order_reversal_fan
    >>> walls = np.linspace(0.0, 1.0, 13)
    >>> truth = PreisachOperator(walls, np.ones(78))
    >>> fan = first_order_reversal_fan(walls)
    >>> fit = fit_smooth(fan, truth(fan), walls, groups=np.cumsum(fan == 1.0), nonnegative=None)
    >>> bool(np.max(np.abs(fit.operator.density - truth.density)) < 1e-3)
    True
    """
    grid = checked_walls(walls)
    inputs = finite_array(v, "v")
    outputs = finite_array(u, "u", size=inputs.size)
    tried = np.atleast_1d(finite_array(strengths, "strengths", ndim=(0, 1)))
    if tried.size == 0 or np.any(tried <= 0):
        raise ValueError(f"strengths: found {tried.tolist()}, need at least one, all above 0")
    used = np.ones(inputs.size, dtype=np.bool_) if measured is None else np.asarray(measured, dtype=np.bool_)
    if used.shape != inputs.shape or not used.any():
        raise ValueError(
            f"measured: found shape {used.shape} with {np.count_nonzero(used)} True, need {inputs.shape}"
        )
    if folds < 2:
        raise ValueError(f"folds: found {folds}, need at least 2: one is left out")
    if groups is None:
        label = np.arange(inputs.size) * 10 * folds // inputs.size
    else:
        label = np.asarray(groups)
        if label.shape != inputs.shape:
            raise ValueError(f"groups: found shape {label.shape}, need {inputs.shape}")
    part = np.searchsorted(np.unique(label[used]), label[used]) % folds
    signs = (True, False) if nonnegative is None else (bool(nonnegative),)
    compared = tried.size * len(signs) > 1
    if compared and np.unique(part).size < folds:
        raise ValueError(
            f"groups: found {np.unique(label[used]).size}, need at least as many as folds, {folds}"
        )
    problem = SmoothProblem.of(inputs, outputs, grid, used, diagonal, history)
    errors = {sign: np.full(tried.size, np.inf if compared else 0.0) for sign in signs}
    order = np.argsort(-tried)
    parts = [part == fold for fold in range(folds)]
    for sign in signs if compared else ():

        def judge(some: Sequence[int], sign: bool = sign) -> None:
            cases = [(float(tried[k]), out) for k in some for out in parts]
            squares = np.reshape(parallel_map(partial(problem.held_out, sign), cases), (len(some), folds))
            errors[sign][list(some)] = np.sqrt(squares.sum(axis=1) / part.size)

        for k in order[::_STRIDE]:
            judge([k])
            if errors[sign][k] > errors[sign].min():
                break
        best_place = int(np.argmin(errors[sign][order]))
        near = order[max(best_place - _STRIDE + 1, 0) : best_place + _STRIDE]
        if untried := [int(k) for k in near if np.isinf(errors[sign][k])]:
            judge(untried)
    chosen = min(signs, key=lambda sign: float(errors[sign].min()))
    best = float(tried[int(np.argmin(errors[chosen]))])
    masses, constant = problem.solve(best, np.ones(part.size, dtype=np.bool_), chosen)
    return SmoothFit(
        problem.operator(masses, constant, grid, diagonal),
        0.0,
        problem.residual(masses, constant),
        best,
        tried,
        errors[chosen],
        chosen,
    )
