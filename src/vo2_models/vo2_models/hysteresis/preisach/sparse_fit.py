"""Preisach densities that are sparse in a basis: compressive sensing for recordings of any input.

Section 4.2 takes the *outputs* of one damped oscillation as sparse after a cosine transform. That needs this very input, and
leaves the densities to a matrix inverse. Here it is the density mu over the plane that is sparse, whatever the input was:

    minimise  |S w(mu) - u|^2 / 2 + strength |Psi mu|_1    over mu >= 0 (or of any sign) and a free bias,

with Psi one of `BASES`: the orthonormal DCT-II ("cosine", that of the dissertation), Haar wavelets ("haar"), or first
differences ("variation", total variation: Rudin, Osher and Fatemi, Physica D 60, 1992), which hold densities that jump. The
two first mirror the triangle at the diagonal; the cells on the diagonal, which also carry what is reversible, are transformed
apart. Basis, strength and sign are those that predict held-out parts of the recording best.

Solved by the alternating direction method of multipliers (Boyd et al., Foundations and Trends in Machine Learning 3, 2011),
all strengths at a time: a product of matrices per iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct
from scipy.linalg import block_diag, cho_factor, cho_solve

from vo2_models.hysteresis.preisach.everett_rows import everett_rows, mass_map
from vo2_models.hysteresis.preisach.grid import cell_areas, cell_count, checked_walls, pack
from vo2_models.hysteresis.preisach.least_squares import PreisachFit
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.validation import finite_array

__all__ = ["BASES", "STRENGTHS", "SparseFit", "choose_sparse", "fit_sparse", "haar", "transform"]

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

STRENGTHS = tuple(np.logspace(-1, -6, 6).tolist())
"""Strengths tried by default, relative to the largest correlation of a cell with the outputs."""
_LEVELS = (20, 32)
"""Levels of `choose_sparse`: the first for basis and sign, the second against it."""
_SAMPLES = 4000
"""Samples that `choose_sparse` uses at most."""
_STEP = 0.1
"""Penalty of the splitting, in units of the mean of the normal matrix' diagonal."""
_TOLERANCE, _ITERATIONS = 1e-4, 2000


@dataclass(frozen=True, eq=False)
class SparseFit(PreisachFit):
    """What `fit_sparse` found, beside a `PreisachFit`.

    Attributes
    ----------
    basis : of `BASES`, the one used
    strength : the one used
    nonnegative : whether densities were held at or above 0
    error : root mean square of the residual on the parts left out, of the one used [output unit]
    held_out_rmse : basis -> the same, the least over strengths and signs
    """

    basis: str
    strength: float
    nonnegative: bool
    error: float
    held_out_rmse: Mapping[str, float]


def haar(size: int) -> Floats:
    """Return the orthonormal Haar transform (size, size) of any size: halves need not be equal (Girardi and Sweldens 1997).

    >>> np.round(haar(2), 3).tolist()
    [[0.707, 0.707], [0.707, -0.707]]

    Parameters
    ----------
    size : number of values
    """
    rows = [np.full(size, size**-0.5)]
    spans = [(0, size)]
    while spans:
        low, high = spans.pop(0)
        if high - low < 2:
            continue
        middle = (low + high + 1) // 2
        left, right = middle - low, high - middle
        row = np.zeros(size)
        row[low:middle] = np.sqrt(right / (left * (left + right)))
        row[middle:high] = -np.sqrt(left / (right * (left + right)))
        rows.append(row)
        spans += [(low, middle), (middle, high)]
    return np.array(rows)


def _cosine(size: int) -> Floats:
    return np.asarray(dct(np.eye(size), axis=0, norm="ortho"))


def _mirrored(one: Callable[[int], Floats]) -> Callable[[int], tuple[Floats, Floats]]:
    """The two-dimensional transform of the plane mirrored at its diagonal, and of the cells on the diagonal."""

    def both(level: int) -> tuple[Floats, Floats]:
        size = level - 1
        b = one(size)
        i, j = np.tril_indices(size)
        plane = b[np.ix_(i, i)] * b[np.ix_(j, j)] + b[np.ix_(i, j)] * b[np.ix_(j, i)]
        plane *= np.where(i == j, 0.5, 1.0)[None, :] * np.where(i == j, np.sqrt(0.5), 1.0)[:, None]
        psi = block_diag(plane, one(level))
        weight = np.ones(psi.shape[0])
        weight[[0, plane.shape[0]]] = 0.0  # the means are no detail
        return psi[:, _order(level)], weight

    return both


def _order(level: int) -> NDArray[np.intp]:
    """Place of each packed cell in (cells below the diagonal, cells on it)."""
    i, j = np.tril_indices(level)
    below = i > j
    place = np.empty(i.size, dtype=np.intp)
    place[below] = np.arange(np.count_nonzero(below))
    place[~below] = np.count_nonzero(below) + np.arange(level)
    return place


def _variation(level: int) -> tuple[Floats, Floats]:
    """First differences along alpha, beta and the diagonal."""
    i, j = np.tril_indices(level)
    cell = np.full((level, level), -1)
    cell[i, j] = np.arange(i.size)
    pairs = [
        (cell[a, b], cell[a + da, b + db])
        for a, b in zip(i, j, strict=True)
        for da, db in (((1, 0), (0, 1)) if a > b else ((1, 1),))
        if a + da < level and b + db < level and (a == b or a + da > b + db)
    ]
    psi = np.zeros((len(pairs), i.size))
    for row, (here, there) in enumerate(pairs):
        psi[row, here], psi[row, there] = -1.0, 1.0
    return psi, np.ones(len(pairs))


BASES: Mapping[str, Callable[[int], tuple[Floats, Floats]]] = {
    "cosine": _mirrored(_cosine),
    "haar": _mirrored(haar),
    "variation": _variation,
}
"""Name -> level -> Psi (m, L (L + 1) / 2) and the weights (m,) of its coefficients in the norm."""


def transform(basis: str, level: int) -> tuple[Floats, Floats]:
    """Return Psi (m, K) for the K = L (L + 1) / 2 packed cells, and the weights (m,) of the coefficients, 0 for means.

    Parameters
    ----------
    basis : of `BASES`
    level : L, at least 3

    Raises
    ------
    ValueError : another basis, a level below 3.
    """
    if basis not in BASES:
        raise ValueError(f"basis: found {basis!r}, need one of {', '.join(BASES)}")
    if level < 3:
        raise ValueError(f"walls: found level {level}, need at least 3")
    return BASES[basis](level)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Outputs (n,) = constant + columns (n, K) densities."""

    columns: Floats
    outputs: Floats

    def solve(
        self, part: Booleans, psi: Floats, weight: Floats, strengths: Floats, nonnegative: bool
    ) -> tuple[Floats, Floats]:
        """Return densities (K, strengths) and constants (strengths,) fitted to a part of the samples."""
        a, u = self.columns[part], self.outputs[part]
        middle, mean = a.mean(axis=0), float(u.mean())
        a = a - middle
        correlation = a.T @ (u - mean) / u.size
        gram = a.T @ a / u.size
        size = float(np.trace(gram)) / gram.shape[0] or 1.0
        limit = np.outer(weight, strengths) * float(np.max(np.abs(correlation))) / size
        x = _split(gram / size, correlation / size, psi, limit, nonnegative)
        return x, mean - middle @ x


def _areas_seen(inputs: Floats, walls: Floats, used: Booleans) -> Floats:
    """Signed areas (samples used, K), by the sparse form of the recording: no dense matrix of all samples."""
    rows = everett_rows(inputs, walls, kept=used)
    nodes = np.linalg.inv(mass_map(walls.size - 1).toarray())
    corner = cell_count(walls.size - 2)
    return np.asarray((rows @ nodes - nodes[corner]) * pack(cell_areas(walls, "triangle")))


def _split(gram: Floats, wanted: Floats, psi: Floats, limit: Floats, nonnegative: bool) -> Floats:
    """Minimise x' gram x / 2 - wanted' x + sum |limit * psi x| for every column of `limit`."""
    count = gram.shape[0]
    step = _STEP
    scale = float(np.max(np.abs(wanted))) or 1.0
    b, bound = wanted[:, None] / scale, limit / scale

    def factored(step: float) -> Floats:
        normal = gram + step * (psi.T @ psi) + (step if nonnegative else 1e-9) * np.eye(count)
        return np.asarray(cho_solve(cho_factor(normal), np.eye(count)))

    inverse = factored(step)
    x = np.zeros((count, limit.shape[1]))
    z, y = np.zeros((psi.shape[0], limit.shape[1])), np.zeros((psi.shape[0], limit.shape[1]))
    p, q = np.zeros_like(x), np.zeros_like(x)
    for k in range(1, _ITERATIONS + 1):
        right = b + step * (psi.T @ (z - y))
        if nonnegative:
            right += step * (p - q)
        x = inverse @ right
        image = psi @ x
        z_before, p_before = z, p
        z = np.sign(image + y) * np.maximum(np.abs(image + y) - bound / step, 0.0)
        y = y + image - z
        if nonnegative:
            p = np.maximum(x + q, 0.0)
            q = q + x - p
        if k % 20 == 0:
            gap = np.hypot(np.linalg.norm(image - z), np.linalg.norm(x - p) if nonnegative else 0.0)
            moved = step * np.hypot(np.linalg.norm(psi.T @ (z - z_before)), np.linalg.norm(p - p_before))
            gap /= max(float(np.linalg.norm(z)), 1e-300)
            moved /= max(float(np.linalg.norm(step * (psi.T @ y))), float(np.linalg.norm(b)))
            if max(gap, moved) < _TOLERANCE:
                break
            if k % 100 == 0 and not 0.1 < gap / max(moved, 1e-300) < 10.0:
                factor = float(np.clip(np.sqrt(gap / max(moved, 1e-300)), 0.1, 10.0))
                step, y, q = step * factor, y / factor, q / factor
                inverse = factored(step)
    return scale * (p if nonnegative else x)


def fit_sparse(
    v: ArrayLike,
    u: ArrayLike,
    walls: ArrayLike,
    *,
    bases: Sequence[str] = tuple(BASES),
    nonnegative: bool | None = True,
    groups: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    strengths: Sequence[float] = STRENGTHS,
    folds: int = 5,
) -> SparseFit:
    """Fit the density whose transform has the least l1 norm beside its misfit; see the module.

    Parameters
    ----------
    v, u : (n,) input from lower saturation on, and measured output; there may be fewer samples than cells
    walls : (L + 1,) increasing input levels, evenly spaced for the bases to mean what they say
    bases : candidates, of `BASES`
    nonnegative : demand densities >= 0; False admits negative ones; None lets the parts left out decide
    groups : (n,) label of the curve or block of each sample, which are held out together; negative ones never are; by
        default ten blocks per fold
    measured : (n,) False where the output is not to be used and only the input matters
    strengths : candidates
    folds : number of parts, each of every `folds`-th group

    Returns
    -------
    SparseFit : operator, residual of the samples used, what was chosen, and the held-out error of each basis

    Raises
    ------
    ValueError : not finite, shapes differ, an unknown basis, strengths not above 0, or nothing to hold out.

    Examples
    --------
    >>> from vo2_models.identification.excitation import damped_oscillation
    >>> walls = np.arange(13.0)
    >>> truth = PreisachOperator(walls, np.where(np.arange(78) > 40, 2.0, 0.5))
    >>> v = damped_oscillation(walls)
    >>> seen = np.random.default_rng(1).random(v.size) < 0.6  # fewer than the 79 unknowns
    >>> found = fit_sparse(v, truth(v), walls, measured=seen)
    >>> found.basis, bool(np.max(np.abs(found.operator(v) - truth(v))) < 0.05 * np.ptp(truth(v)))
    ('variation', True)
    """
    grid = checked_walls(walls)
    inputs = finite_array(v, "v")
    outputs = finite_array(u, "u", size=inputs.size)
    tried = np.atleast_1d(finite_array(strengths, "strengths", ndim=(0, 1)))
    if tried.size == 0 or np.any(tried <= 0) or not bases:
        raise ValueError(f"strengths, bases: found {tried.tolist()}, {list(bases)}, need one each, above 0")
    used = np.ones(inputs.size, dtype=np.bool_) if measured is None else np.asarray(measured, dtype=np.bool_)
    label = np.arange(inputs.size) * 10 * folds // inputs.size if groups is None else np.asarray(groups)
    for name, array in (("measured", used), ("groups", label)):
        if array.shape != inputs.shape:
            raise ValueError(f"{name}: found shape {array.shape}, need {inputs.shape}")
    there = label[used]
    part = np.where(there < 0, -1, np.searchsorted(np.unique(there[there >= 0]), there) % folds)
    parts = np.unique(part[part >= 0])
    if parts.size < 2:
        raise ValueError(
            f"groups: found {parts.size} part(s) of the samples used, need at least 2 to hold out"
        )
    problem = _Problem(_areas_seen(inputs, grid, used), outputs[used])
    signs = (True, False) if nonnegative is None else (bool(nonnegative),)
    best = np.inf, bases[0], float(tried[0]), signs[0]
    errors: dict[str, float] = {}
    for basis in bases:
        psi, weight = transform(basis, grid.size - 1)
        for sign in signs:
            squares = np.zeros(tried.size)
            for one in parts:
                x, constant = problem.solve(part != one, psi, weight, tried, sign)
                left = problem.outputs[part == one, None] - problem.columns[part == one] @ x - constant
                squares += np.sum(left**2, axis=0)
            rmse = np.sqrt(squares / np.count_nonzero(part >= 0))
            k = int(np.argmin(rmse))
            errors[basis] = min(errors.get(basis, np.inf), float(rmse[k]))
            if rmse[k] < best[0]:
                best = float(rmse[k]), basis, float(tried[k]), sign
    error, basis, strength, sign = best
    psi, weight = transform(basis, grid.size - 1)
    x, constant = problem.solve(np.ones(part.size, dtype=np.bool_), psi, weight, np.array([strength]), sign)
    residual = problem.outputs - problem.columns @ x[:, 0] - constant[0]
    operator = PreisachOperator(grid, x[:, 0], float(constant[0]))
    return SparseFit(operator, 0.0, residual, basis, strength, sign, error, errors)


def choose_sparse(v: Floats, u: Floats, groups: NDArray[np.int64], measured: Booleans) -> SparseFit:
    """Fit on evenly spaced walls over the input; basis, sign and level by what predicts held-out parts best, in this order.

    Parameters
    ----------
    v, u : (n,) input from lower saturation on, output
    groups : (n,) part that each sample is held out with, negative for none
    measured : (n,) whether the output is used

    Returns
    -------
    SparseFit : its `held_out_rmse` compares the bases on the first level

    Raises
    ------
    ValueError : as `fit_sparse`.
    """
    rows = np.flatnonzero(measured)
    used = np.zeros(v.size, dtype=np.bool_)
    used[rows[np.unique(np.linspace(0, rows.size - 1, min(rows.size, _SAMPLES)).astype(np.intp))]] = True

    def fit(level: int, bases: Sequence[str], nonnegative: bool) -> SparseFit:
        walls = np.linspace(v.min(), v.max(), level + 1)
        return fit_sparse(v, u, walls, bases=bases, nonnegative=nonnegative, groups=groups, measured=used)

    best = fit(_LEVELS[0], tuple(BASES), True)
    compared = best.held_out_rmse
    best = min(best, fit(_LEVELS[0], (best.basis,), False), key=lambda one: one.error)
    best = min(best, fit(_LEVELS[1], (best.basis,), best.nonnegative), key=lambda one: one.error)
    return replace(best, held_out_rmse=compared)
