"""Non-negative least squares on large Preisach planes by a primal-dual interior-point method in the node values.

With tens of thousands of cells the normal matrix of the masses is dense and an active set is out of reach. In the node
values E of `everett_rows` both the data and the constraint (mass = G E >= 0) are sparse, so each Newton step
(R'R + Q + G' D G, D diagonal and positive) is one sparse factorisation, and Mehrotra's predictor and corrector
need some thirty of them at any size. Where the solution is not unique, a ridge far below the tolerance of any recording
picks the one of least norm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from vo2_models.hysteresis.preisach.everett_rows import mass_gradient, mass_map, node_values

__all__ = ["ConstrainedSolution", "nonnegative_masses", "signed_masses"]

Floats = NDArray[np.float64]

_ITERATIONS = 100
_SMALLEST_STEP = 1e-4
_CRAMPED = 0.1
"""Step from which the predictor and corrector get on."""
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


def _reach(values: Floats, step: Floats) -> float:
    """How far along `step` all values stay above zero, at most 1."""
    falls = step < 0
    return min(1.0, float(np.min(-values[falls] / step[falls]))) if np.any(falls) else 1.0


class _Iterate(NamedTuple):
    """Masses, multipliers, and what the three linear conditions still lack."""

    s: Floats
    m: Floats
    dual: Floats
    total: float
    primal: Floats


def _step(
    newton: _Bordered,
    at: _Iterate,
    mass: sparse.csr_array,
    spread: sparse.csr_array,
    target: float | Floats,
) -> tuple[Floats, float, Floats, Floats]:
    """Newton's step of nodes, constant, masses and multipliers to s m = target, to first order."""
    right = target / at.s - at.m
    ratio = at.m / at.s
    dx, db = newton(-at.dual + spread @ (right - ratio * at.primal), -at.total)
    ds = mass @ dx + at.primal
    return dx, db, ds, right - ratio * ds


def nonnegative_masses(
    rows: sparse.csr_array,
    outputs: Floats,
    penalty: sparse.sparray | None = None,
    *,
    tolerance: float = 1e-7,
) -> ConstrainedSolution:
    """Minimise |rows x + b - outputs|^2 + x' penalty x over b and node values x with masses G x >= 0.

    Parameters
    ----------
    rows : (n, K) from `everett_rows`
    outputs : (n,) [output unit]
    penalty : (K, K) symmetric, positive semidefinite; none by default
    tolerance : of the duality gap, relative to the objective (or to 1e-6 of the data's square, if larger)

    Returns
    -------
    ConstrainedSolution : masses, constant part, and how near the optimum they are

    Raises
    ------
    ArithmeticError : the iterations stall more than 1000 tolerances away from the optimum.
    """
    n, size = rows.shape
    mass = mass_map(_level(size))
    spread = mass.T.tocsr()
    mean = float(outputs.mean())
    wanted = outputs - mean
    hessian = (rows.T @ rows).tocsr()
    if penalty is not None:
        hessian = (hessian + penalty).tocsr()
    given = hessian
    hessian = (hessian + _RIDGE * n * (spread @ mass)).tocsr()
    border, linear = np.asarray(rows.sum(axis=0)).ravel(), rows.T @ wanted
    floor = 1e-6 * float(wanted @ wanted)
    strongest = float(np.max(np.abs(linear), initial=0.0))
    if strongest == 0.0:
        return ConstrainedSolution(np.zeros(size), mean, 0.0, 0.0, 0)

    s = np.full(size, float(np.ptp(outputs)) / size)
    x, b = node_values(s), 0.0
    m = np.full(size, strongest)
    iterations = 0
    while iterations < _ITERATIONS:
        dual = hessian @ x + border * b - linear - spread @ m
        total = float(border @ x) + n * b
        primal = mass @ x - s
        residual = rows @ x + b - wanted
        objective = float(residual @ residual) + (float(x @ (penalty @ x)) if penalty is not None else 0.0)
        gap = float(s @ m)
        if 2 * gap <= tolerance * max(objective, floor) and np.max(np.abs(dual)) <= 1e-9 * strongest:
            break
        newton = _Bordered((hessian + spread @ sparse.diags_array(m / s) @ mass).tocsr(), border, n)

        state = _Iterate(s, m, dual, total, primal)
        _, _, ds, dm = _step(newton, state, mass, spread, 0.0)
        after = float((s + _reach(s, ds) * ds) @ (m + _reach(m, dm) * dm))
        centring = (after / gap) ** 3 * gap / size
        dx, db, ds, dm = _step(newton, state, mass, spread, centring - ds * dm)
        length = min(1.0, 0.995 * _reach(s, ds), 0.995 * _reach(m, dm))
        if length < _CRAMPED:
            # a mass far off the central path stops the corrector: back towards the path first
            dx, db, ds, dm = _step(newton, state, mass, spread, gap / size)
            length = min(1.0, 0.995 * _reach(s, ds), 0.995 * _reach(m, dm))
        x, b, s, m = x + length * dx, b + length * db, s + length * ds, m + length * dm
        iterations += 1
        if length < _SMALLEST_STEP:
            break
    masses = np.maximum(mass @ x, 0.0)
    nodes = node_values(masses)
    b = -float(border @ nodes) / n
    slope = mass_gradient(given @ nodes + border * b - linear)
    residual = rows @ nodes + b - wanted
    objective = float(residual @ residual) + (
        float(nodes @ (penalty @ nodes)) if penalty is not None else 0.0
    )
    found = ConstrainedSolution(
        masses,
        b + mean,
        float(np.min(slope)) / float(np.max(np.abs(mass_gradient(linear)))),
        2 * float(np.abs(masses @ slope)) / max(objective, floor),
        iterations,
    )
    if not found.slackness <= 1e3 * tolerance:
        raise ArithmeticError(
            f"interior point: found a duality gap of {found.slackness:.1e} after {iterations} steps, need {tolerance:.0e}; "
            "the problem is too badly conditioned"
        )
    return found
