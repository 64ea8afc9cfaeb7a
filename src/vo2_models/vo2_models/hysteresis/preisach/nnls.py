"""Non-negative least squares by block principal pivoting, for dense problems and for the damped oscillation.

Lawson and Hanson's active set moves one variable per solve. Exchanging all variables of the wrong sign at once
(Portugal, Judice and Vicente 1994), with single exchanges as a fall-back when that stops making progress,
needs a handful of solves where most densities are positive.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator, splu

__all__ = ["RankDeficientError", "nonnegative_least_squares", "normal_equations", "projected_outputs"]

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

_PATIENCE = 3
_SMALLEST_PIVOT = 1e-12


class RankDeficientError(ValueError):
    """The columns of the problem are linearly dependent, so that its solution is not unique."""


def _pivot(
    solve: Callable[[Booleans], tuple[Floats, Floats]],
    inner: Booleans,
    fixed: Booleans,
    tolerance: tuple[float, float],
) -> tuple[Floats, Floats, Booleans]:
    """Exchange variables until x >= 0 and y >= 0 with x_k y_k = 0.

    `solve(inner)` returns x (zero outside `inner`) and y (zero inside); `fixed` variables are never exchanged.
    """
    best = inner.size + 1
    patience = _PATIENCE
    for _ in range(50 + 5 * inner.size):
        x, y = solve(inner)
        wrong = ((x < -tolerance[0]) & inner | (y < -tolerance[1]) & ~inner) & ~fixed
        count = int(np.count_nonzero(wrong))
        if count == 0:
            return x, y, inner
        if count < best:
            best, patience = count, _PATIENCE
        elif patience > 0:
            patience -= 1
        else:  # Murty's rule ends in finitely many steps
            wrong = np.arange(inner.size) == np.flatnonzero(wrong)[-1]
        inner = inner ^ wrong
    raise ArithmeticError("non-negative least squares did not settle; the problem is too badly conditioned")


def normal_equations(
    normal: Floats, right: Floats, free: Booleans, start: Booleans | None = None
) -> tuple[Floats, Booleans]:
    """Minimise x'Nx/2 - r'x over x >= 0 (`free` elements unbounded); return x and which elements are not held at 0.

    Parameters
    ----------
    normal : (n, n) symmetric positive definite
    right : (n,)
    free : (n,) True where the sign does not matter
    start : (n,) first guess of what is not held at 0, such as that of a similar problem

    Raises
    ------
    RankDeficientError : `normal` is singular to working precision.
    """
    size = np.sqrt(np.diag(normal))
    if np.any(size == 0):
        raise RankDeficientError(
            f"{np.count_nonzero(size == 0)} of {size.size} unknowns have no influence on the data"
        )
    scaled = normal / np.outer(size, size)
    target = right / size

    def solve(inner: Booleans) -> tuple[Floats, Floats]:
        x = np.zeros(inner.size)
        k = np.flatnonzero(inner)
        try:
            factor = linalg.cho_factor(scaled[np.ix_(k, k)], lower=True, check_finite=False)
        except linalg.LinAlgError as error:
            raise RankDeficientError(f"{k.size} unknowns are linearly dependent in the data") from error
        if k.size and np.min(np.diag(factor[0])) ** 2 < _SMALLEST_PIVOT:
            raise RankDeficientError(f"{k.size} unknowns are linearly dependent in the data")
        x[k] = linalg.cho_solve(factor, target[k], check_finite=False)
        x[k] += linalg.cho_solve(factor, target[k] - scaled[np.ix_(k, k)] @ x[k], check_finite=False)
        y = scaled @ x - target
        y[k] = 0.0
        return x, y

    largest = float(np.max(np.abs(target), initial=0.0))
    everywhere = np.ones(right.size, dtype=np.bool_) if start is None else start | free
    # errors of x are those of the gradient times the inverse's size; 1e-10 of the data is below any noise
    x, _, inner = _pivot(solve, everywhere, free, (1e-11 * largest, 1e-11 * largest))
    return np.where(free, x, np.maximum(x, 0.0)) / size, inner


def nonnegative_least_squares(
    matrix: Floats | LinearOperator,
    target: Floats,
    free: Booleans | None = None,
    normal: Floats | None = None,
) -> Floats:
    """Return x that minimises |matrix x - target|^2 with x >= 0 where `free` is not set.

    Solved by the normal equations, then refined on the positive unknowns from the residual itself.

    Parameters
    ----------
    matrix : (m, n), as numbers, or as an operator, and then with `normal`
    target : (m,)
    free : (n,) True where the sign does not matter
    normal : (n, n) matrix' matrix, where it is cheaper to come by otherwise

    Raises
    ------
    RankDeficientError : the columns are linearly dependent to working precision.
    """
    columns = matrix.shape[1]
    unbounded = np.zeros(columns, dtype=np.bool_) if free is None else free
    if matrix.shape[0] < columns:
        raise RankDeficientError(f"{matrix.shape[0]} samples cannot determine {columns} unknowns")
    gram = matrix.T @ matrix if normal is None else normal
    x, inner = normal_equations(gram, matrix.T @ target, unbounded)
    k = np.flatnonzero(inner)
    factor = linalg.cho_factor(gram[np.ix_(k, k)], lower=True, check_finite=False, overwrite_a=True)
    for _ in range(2):
        correction = linalg.cho_solve(factor, (matrix.T @ (target - matrix @ x))[k], check_finite=False)
        x[k] += correction
    return np.where(unbounded, x, np.maximum(x, 0.0))


def projected_outputs(faces: sparse.csr_matrix, outputs: Floats) -> tuple[Floats, Floats]:
    """Return the nearest z to `outputs` with faces z >= 0, and faces z (exactly 0 where a face holds z).

    The dual of non-negative least squares where the matrix has a sparse inverse: z = b + G'm, m >= 0, G z >= 0,
    m'G z = 0; only the faces that hold are solved for.

    Parameters
    ----------
    faces : (K, n) sparse, of full row rank
    outputs : (n,)
    """
    free_value = faces @ outputs
    gram = (faces @ faces.T).tocsc()
    none = np.zeros(free_value.size, dtype=np.bool_)

    def solve(holding: Booleans) -> tuple[Floats, Floats]:
        multiplier = np.zeros(holding.size)
        k = np.flatnonzero(holding)
        if k.size:
            multiplier[k] = splu(gram[k][:, k]).solve(-free_value[k])
        value = free_value + gram @ multiplier
        value[k] = 0.0
        return multiplier, value

    scale = 1e-13 * float(np.max(np.abs(outputs), initial=0.0))
    multiplier, value, _ = _pivot(solve, free_value < 0, none, (scale, scale))
    return outputs + faces.T @ multiplier, np.maximum(value, 0.0)
