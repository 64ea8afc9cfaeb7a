"""Non-negative least squares on Preisach planes of any size, as a sparse quadratic programme in the node values.

With tens of thousands of cells the normal matrix of the masses is dense and an active set is out of reach. In the node
values E of `everett_rows` both the data and the constraint (mass = G E >= 0) are sparse, and the interior-point solver
Clarabel (Goulart and Chen 2024) needs some ten sparse factorisations at any size, also where few samples leave
much open. There, a ridge far below the tolerance of any recording picks the solution of least norm.
"""

from __future__ import annotations

from typing import NamedTuple

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from vo2_models.hysteresis.preisach.everett_rows import mass_gradient, mass_map, node_values

__all__ = ["ConstrainedSolution", "nonnegative_masses", "signed_masses"]

Floats = NDArray[np.float64]

_RIDGE = 1e-12
"""On the square of each mass, relative to what the samples weigh."""


class ConstrainedSolution(NamedTuple):
    """Masses of the cells (K,), the constant part of the output, and how near the optimum they are.

    `slope` is the most negative derivative of the objective to a mass, over the largest absolute correlation of a mass
    with the data, and `slackness` the sum of mass times derivative over the objective: both 0 at the optimum of
    the constrained problem (Karush, Kuhn, Tucker).
    """

    masses: Floats
    constant: float
    slope: float
    slackness: float
    iterations: int


def _factor(matrix: sparse.sparray) -> SuperLU:
    # symmetric and positive definite: no pivoting, and an ordering for the sum of matrix and transpose
    return splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


class _Bordered:
    """Solves [[M, a], [a', n]] [x, b] = [p, q] with one factorisation of the sparse M."""

    def __init__(self, matrix: sparse.sparray, border: Floats, corner: float) -> None:
        self._matrix = matrix
        self._border = border
        self._lu = _factor(matrix)
        self._column = self._solve(border)
        self._pivot = corner - float(border @ self._column)

    def _solve(self, right: Floats) -> Floats:
        x = self._lu.solve(right)
        return np.asarray(x + self._lu.solve(right - self._matrix @ x), dtype=np.float64)

    def __call__(self, right: Floats, last: float) -> tuple[Floats, float]:
        x = self._solve(right)
        b = (last - float(self._border @ x)) / self._pivot
        return x - b * self._column, b


def signed_masses(rows: sparse.csr_array, outputs: Floats, penalty: sparse.sparray) -> tuple[Floats, float]:
    """Minimise |rows x + b - outputs|^2 + x' penalty x over node values x and b; return masses and b.

    `penalty` must make the problem definite.
    """
    mean = float(outputs.mean())
    solve = _Bordered((rows.T @ rows + penalty).tocsr(), np.asarray(rows.sum(axis=0)).ravel(), rows.shape[0])
    x, b = solve(rows.T @ (outputs - mean), 0.0)
    return np.asarray(mass_map(_level(rows.shape[1])) @ x, dtype=np.float64), b + mean


def _level(cells: int) -> int:
    return int((np.sqrt(8 * cells + 1) - 1) / 2 + 0.5)


def nonnegative_masses(
    rows: sparse.csr_array,
    outputs: Floats,
    penalty: sparse.sparray | None = None,
    *,
    tolerance: float = 1e-11,
) -> ConstrainedSolution:
    """Minimise |rows x + b - outputs|^2 + x' penalty x over b and node values x with masses G x >= 0.

    Parameters
    ----------
    rows : (n, K) from `everett_rows`
    outputs : (n,) [output unit]
    penalty : (K, K) symmetric, positive semidefinite; none by default
    tolerance : of the duality gap, relative to what the data explain

    Returns
    -------
    ConstrainedSolution : masses, constant part, and how near the optimum they are

    Raises
    ------
    ArithmeticError : the solver came to no solution at all.
    """
    n, size = rows.shape
    mass = mass_map(_level(size))
    spread = mass.T.tocsr()
    mean, scale = float(outputs.mean()), float(np.ptp(outputs))
    if scale == 0.0:
        return ConstrainedSolution(np.zeros(size), mean, 0.0, 0.0, 0)
    given = (rows.T @ rows).tocsr() if penalty is None else (rows.T @ rows + penalty).tocsr()
    wanted = outputs - mean
    border, linear = np.asarray(rows.sum(axis=0)).ravel(), rows.T @ wanted
    strongest = max(float(np.max(np.abs(linear))), np.finfo(float).tiny)
    hessian = sparse.block_array(
        [[given + _RIDGE * n * (spread @ mass), border[:, None]], [border[None, :], np.array([[float(n)]])]]
    )
    # the objective in units of the strongest correlation, the masses in units of the output's range
    weight = scale / strongest
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_rel = settings.tol_gap_abs = tolerance
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(hessian * weight)),
        -np.append(linear, 0.0) * weight / scale,
        sparse.csc_matrix(sparse.hstack([-mass, sparse.csc_array((size, 1))])),
        np.zeros(size),
        [clarabel.NonnegativeConeT(size)],
        settings,
    ).solve()
    x = np.asarray(solution.x[:size]) * scale
    if not np.all(np.isfinite(x)):
        raise ArithmeticError(
            f"interior point: found no solution ({solution.status}), need outputs of one scale"
        )
    masses = np.maximum(mass @ x, 0.0)
    nodes = node_values(masses)
    b = -float(border @ nodes) / n
    slope = mass_gradient(given @ nodes + border * b - linear)
    residual = rows @ nodes + b - wanted
    objective = float(residual @ residual)
    objective += float(nodes @ (penalty @ nodes)) if penalty is not None else 0.0
    return ConstrainedSolution(
        masses,
        b + mean,
        float(np.min(slope)) / max(float(np.max(np.abs(mass_gradient(linear)))), np.finfo(float).tiny),
        2 * float(np.abs(masses @ slope)) / max(objective, 1e-6 * float(wanted @ wanted)),
        int(solution.iterations),
    )
