"""Basis pursuit: the vector of least l1 norm that explains the measurements, (4.7).

Without a noise bound this is a linear programme, with one a second-order cone programme; the interior-point solver
Clarabel takes both. A dual bound is returned, so that what is left to the optimum is known and not hoped for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

__all__ = ["BasisPursuit", "basis_pursuit"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BasisPursuit:
    """Result of `basis_pursuit`.

    Attributes
    ----------
    solution : (n,)
    gap : (l1 norm - dual bound) / l1 norm: how far above the optimum the norm can be at most
    iterations : of the solver
    """

    solution: Floats
    gap: float
    iterations: int


def basis_pursuit(
    matrix: Floats, measured: Floats, *, noise: float = 0.0, tolerance: float = 1e-8
) -> BasisPursuit:
    """Minimise |q|_1 subject to |matrix q - measured|_2 <= noise.

    Parameters
    ----------
    matrix : (m, n), m <= n, with orthonormal rows (rows of an orthonormal transform)
    measured : (m,)
    noise : bound on the Euclidean norm of the noise, 0 for equality
    tolerance : relative duality gap to stop at

    Returns
    -------
    BasisPursuit : solution and duality gap

    Raises
    ------
    ValueError : shapes that do not fit, rows not orthonormal, or a negative noise bound.
    """
    m, n = matrix.shape
    if measured.shape != (m,) or m > n:
        raise ValueError(
            f"matrix: found shape {matrix.shape} for {measured.size} measurement(s), need (m, n), m <= n"
        )
    if noise < 0:
        raise ValueError(f"noise: found {noise:g}, need a bound >= 0")
    probe = np.random.default_rng(0).normal(size=m)
    if not np.allclose(matrix @ (matrix.T @ probe), probe, atol=1e-8 * np.abs(probe).max()):
        raise ValueError("matrix: found rows that are not orthonormal, need rows of an orthonormal transform")
    if float(np.linalg.norm(measured)) <= noise:
        return BasisPursuit(np.zeros(n), 0.0, 0)
    scale = float(np.max(np.abs(measured)))
    b, bound = measured / scale, noise / scale
    # minimise the sum of t with -t <= q <= t, and what is measured within a ball, or met
    one, rows, nothing = sparse.identity(n), sparse.csr_matrix(matrix), sparse.csr_matrix((m, n))
    blocks = [[one, -one], [-one, -one], [rows, nothing]]
    right = np.concatenate([np.zeros(2 * n), b])
    cones: list[Any] = [clarabel.NonnegativeConeT(2 * n), clarabel.ZeroConeT(m)]
    if noise > 0.0:
        blocks = [*blocks[:2], [sparse.csr_matrix((1, n)), sparse.csr_matrix((1, n))], [-rows, nothing]]
        right = np.concatenate([np.zeros(2 * n), [bound], -b])
        cones[1] = clarabel.SecondOrderConeT(m + 1)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_rel = settings.tol_gap_abs = tolerance
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((2 * n, 2 * n)),
        np.repeat([0.0, 1.0], n),
        sparse.csc_matrix(sparse.bmat(blocks)),
        right,
        cones,
        settings,
    ).solve()
    q = np.asarray(solution.x[:n])
    # the rows are orthonormal: what the tolerance left of the constraint is projected away
    left = matrix @ q - b
    excess = max(1.0 - bound / max(float(np.linalg.norm(left)), np.finfo(float).tiny), 0.0)
    q = q - matrix.T @ (excess * left)
    dual = np.asarray(solution.z[-m:]) * (1.0 if noise > 0.0 else -1.0)
    return BasisPursuit(scale * q, _gap(matrix, b, bound, q, dual), int(solution.iterations))


def _gap(matrix: Floats, measured: Floats, noise: float, q: Floats, dual: Floats) -> float:
    """Return the relative gap between |q|_1 and the bound of the dual vector, scaled to be feasible."""
    feasible = dual / max(1.0, float(np.max(np.abs(matrix.T @ dual))))
    norm = float(np.sum(np.abs(q)))
    return (norm - float(measured @ feasible - noise * np.linalg.norm(feasible))) / norm
