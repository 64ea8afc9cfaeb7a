"""Basis pursuit: the vector of least l1 norm that explains the measurements, (4.7).

Without a noise bound this is a linear programme, solved by Mehrotra's predictor-corrector interior-point
method (the kind of path-following method that l1-MAGIC's `l1eq_pd` is). With one it is a cone programme,
solved by Douglas-Rachford splitting, whose projection is in closed form because the rows are orthonormal.
Either returns a dual bound, so that what is left to the optimum is known and not hoped for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

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
    matrix: Floats, measured: Floats, *, noise: float = 0.0, tolerance: float = 1e-8, iterations: int = 20000
) -> BasisPursuit:
    """Minimise |q|_1 subject to |matrix q - measured|_2 <= noise.

    Parameters
    ----------
    matrix : (m, n), m <= n, with orthonormal rows (rows of an orthonormal transform)
    measured : (m,)
    noise : bound on the Euclidean norm of the noise, 0 for equality
    tolerance : relative duality gap to stop at
    iterations : at most so many (of the splitting; the interior-point method needs 10 to 20)

    Returns
    -------
    The minimiser (n,), with how it was reached.

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
    if noise > 0.0:
        return _splitting(matrix, measured, noise, tolerance, iterations)
    return _interior_point(matrix, measured, tolerance)


def _interior_point(matrix: Floats, measured: Floats, tolerance: float) -> BasisPursuit:
    """Solve min 1'(u + v), matrix (u - v) = measured, u, v >= 0."""
    scale = float(np.max(np.abs(measured)))
    b = measured / scale
    m, n = matrix.shape
    start = matrix.T @ b
    level = float(np.mean(np.abs(start))) + 1e-3
    x = np.stack([np.maximum(start, 0.0) + level, np.maximum(-start, 0.0) + level])
    dual = np.zeros(m)
    s = np.ones((2, n))
    sign = np.array([[1.0], [-1.0]])
    count = 0
    for _ in range(100):
        count += 1
        flat = matrix.T @ dual
        primal_left = b - matrix @ (x[0] - x[1])
        dual_left = 1.0 - sign * flat - s
        mu = float(np.sum(x * s)) / (2 * n)
        norm = float(np.sum(x))
        # what is left of the primal equations is projected away at the end
        if 2 * n * mu <= tolerance * norm and np.max(np.abs(primal_left)) <= 1e-7:
            break
        weight = x / s
        root = matrix * np.sqrt(weight[0] + weight[1])
        normal = root @ root.T
        normal[np.diag_indices(m)] += 1e-14 * np.trace(normal) / m
        factor = linalg.cho_factor(normal, lower=True, overwrite_a=True, check_finite=False)

        def direction(
            target: Floats,
            x: Floats = x,
            s: Floats = s,
            weight: Floats = weight,
            dual_left: Floats = dual_left,
            primal_left: Floats = primal_left,
            factor: tuple[Floats, bool] = factor,
        ) -> tuple[Floats, Floats, Floats]:
            residual = target / s - weight * dual_left
            right = primal_left - matrix @ (residual[0] - residual[1])
            d_dual = linalg.cho_solve(factor, right, check_finite=False)
            d_s = dual_left - sign * (matrix.T @ d_dual)
            return target / s - weight * d_s, d_dual, d_s

        d_x, d_dual, d_s = direction(-x * s)
        primal_step, dual_step = _longest(x, d_x), _longest(s, d_s)
        affine = float(np.sum((x + primal_step * d_x) * (s + dual_step * d_s))) / (2 * n)
        d_x, d_dual, d_s = direction((affine / mu) ** 3 * mu - x * s - d_x * d_s)
        primal_step, dual_step = 0.995 * _longest(x, d_x, 1.005), 0.995 * _longest(s, d_s, 1.005)
        x = x + min(primal_step, 1.0) * d_x
        dual = dual + min(dual_step, 1.0) * d_dual
        s = s + min(dual_step, 1.0) * d_s
    q = x[0] - x[1]
    q += matrix.T @ (b - matrix @ q)
    return BasisPursuit(scale * q, _gap(matrix, b, 0.0, q, dual), count)


def _longest(value: Floats, change: Floats, most: float = 1.0) -> float:
    falling = change < 0
    return min(most, float(np.min(-value[falling] / change[falling], initial=np.inf)))


def _gap(matrix: Floats, measured: Floats, noise: float, q: Floats, dual: Floats) -> float:
    """Return the relative gap between |q|_1 and the bound of the dual vector, scaled to be feasible."""
    feasible = dual / max(1.0, float(np.max(np.abs(matrix.T @ dual))))
    norm = float(np.sum(np.abs(q)))
    return (norm - float(measured @ feasible - noise * np.linalg.norm(feasible))) / norm


def _splitting(
    matrix: Floats, measured: Floats, noise: float, tolerance: float, iterations: int
) -> BasisPursuit:
    scale = float(np.max(np.abs(measured)))
    b, bound = measured / scale, noise / scale
    z = matrix.T @ b
    step = 0.3 * float(np.mean(np.abs(z)))
    q, gap, count = z, 1.0, 0
    for count in range(1, iterations + 1):
        left = matrix @ z - b
        norm = float(np.linalg.norm(left))
        pull = left * (1.0 - min(1.0, bound / norm)) if norm > 0 else left
        q = z - matrix.T @ pull
        reflected = 2.0 * q - z
        shrunk = np.sign(reflected) * np.maximum(np.abs(reflected) - step, 0.0)
        z = z + shrunk - q
        if count % 50 == 0:
            gap = _gap(matrix, b, bound, q, -pull / step)
            if gap <= tolerance:
                break
    return BasisPursuit(scale * q, gap, count)
