"""Smoothness-regularised non-negative identification, its strength chosen by cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from vo2_models.preisach.grid import Diagonal, cell_count, checked_walls
from vo2_models.preisach.least_squares import PreisachFit
from vo2_models.preisach.nnls import RankDeficientError, normal_equations
from vo2_models.preisach.operator import PreisachOperator
from vo2_models.preisach.signed_area import signed_area_matrix
from vo2_models.validation import finite_array

__all__ = ["STRENGTHS", "SmoothFit", "fit_smooth", "roughness"]

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

STRENGTHS = tuple(np.logspace(-1, -9, 9).tolist())
"""Strengths tried by default, relative to the data's weight, from the smoothest down."""

_RIDGE = 1e-10
"""Relative to the data's weight on each density: far below the noise of any recording."""


@dataclass(frozen=True, eq=False)
class SmoothFit(PreisachFit):
    """What `fit_smooth` found, beside a `PreisachFit`.

    Attributes
    ----------
    strength : the one used
    strengths, held_out_rmse : those tried, and the error on the folds left out [output unit]
    """

    strength: float
    strengths: Floats
    held_out_rmse: Floats


def roughness(walls: Floats) -> sparse.csr_matrix:
    """Return R (m, L (L + 1) / 2): second differences of the density along alpha, beta and the diagonal.

    The cells on the diagonal, which also carry what is reversible, are compared with each other only. Cells
    more than three times as wide as the median are left alone.
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


def fit_smooth(
    v: ArrayLike,
    u: ArrayLike,
    walls: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    strengths: Sequence[float] = STRENGTHS,
    folds: int = 5,
    diagonal: Diagonal = "triangle",
    history: ArrayLike | None = None,
) -> SmoothFit:
    """Minimise |S w - u|^2 + strength |R mu|^2 over densities mu >= 0 and a free bias.

    The strength is in units of trace(S'S) / trace(R'R). Each candidate is fitted with a part of the recording left
    out, in turn, and the one that predicts the parts left out best is used on all. Neighbouring samples resemble each
    other, so parts are whole `groups`: reversal curves, or blocks of time.

    Parameters
    ----------
    v, u : (n,) input and measured output
    walls : (L + 1,) increasing input levels
    groups : (n,) integer label of the curve or block of each sample; by default ten blocks per fold
    measured : (n,) False where the output is not to be used and only the input matters
    strengths : candidates; a single one is used without cross-validation
    folds : number of parts, each of every `folds`-th group
    diagonal, history : as in `fit_preisach`. There is no linear term: a constant density on the diagonal is one, and
        smooth, so that the two could not be told apart.

    Raises
    ------
    ValueError : not finite, shapes differ, negative strengths, or fewer groups than folds.
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
    if groups is None:
        label = np.arange(inputs.size) * 10 * folds // inputs.size
    else:
        label = np.asarray(groups)
        if label.shape != inputs.shape:
            raise ValueError(f"groups: found shape {label.shape}, need {inputs.shape}")
    part = np.searchsorted(np.unique(label[used]), label[used]) % folds
    if tried.size > 1 and np.unique(part).size < folds:
        raise ValueError(
            f"groups: found {np.unique(label[used]).size}, need at least as many as folds, {folds}"
        )

    cells = cell_count(grid.size - 1)
    matrix = signed_area_matrix(inputs, grid, diagonal=diagonal, history=history)[used]
    target = outputs[used]
    free = np.arange(matrix.shape[1]) >= cells
    normal, right = matrix.T @ matrix, matrix.T @ target
    rough = roughness(grid)
    penalty = np.zeros_like(normal)
    penalty[:cells, :cells] = (rough.T @ rough).toarray()
    penalty *= float(np.trace(normal[:cells, :cells]) / np.trace(penalty))

    # what neither the data nor a difference reaches still needs a value: as little as possible
    ridge = np.diag(np.where(free, 0.0, _RIDGE * np.diag(normal)))

    def solve(a: Floats, b: Floats, strength: float, start: Booleans | None) -> tuple[Floats, Booleans]:
        try:
            return normal_equations(a + strength * penalty + ridge, b, free, start)
        except RankDeficientError as error:
            raise ValueError(
                f"v: found too little excitation ({error}), need inputs at several levels"
            ) from error

    errors = np.zeros(tried.size)
    if tried.size > 1:
        for fold in range(folds):
            out = part == fold
            left, wanted = matrix[out], target[out]
            a, b = normal - left.T @ left, right - left.T @ wanted
            inner = None
            for k in np.argsort(-tried):
                w, inner = solve(a, b, float(tried[k]), inner)
                errors[k] += float(np.sum((left @ w - wanted) ** 2))
        errors = np.sqrt(errors / target.size)
    best = float(tried[int(np.argmin(errors))])
    w, _ = solve(normal, right, best, None)
    operator = PreisachOperator(grid, w[:cells], float(w[cells]), diagonal)
    return SmoothFit(operator, 0.0, target - matrix @ w, best, tried, errors)
