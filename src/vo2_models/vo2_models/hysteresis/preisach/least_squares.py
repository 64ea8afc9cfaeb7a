"""Identification of a Preisach operator by (non-negative) least squares, sections 4.1, 4.4 and 5.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator

from vo2_models.hysteresis.preisach.damped import inverse_map
from vo2_models.hysteresis.preisach.everett_rows import everett_rows, mass_gradient, mass_gram, node_values
from vo2_models.hysteresis.preisach.grid import Diagonal, cell_areas, cell_count, checked_walls, pack
from vo2_models.hysteresis.preisach.nnls import (
    RankDeficientError,
    nonnegative_least_squares,
    projected_outputs,
)
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.validation import finite_array

__all__ = ["PreisachFit", "fit_preisach"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PreisachFit:
    """What an identification found.

    Attributes
    ----------
    operator : density and bias
    slope : the coefficient c_d of the linear term of (4.19), 0 without one [output unit / input unit]
    residual : (n,) measured minus modelled output
    """

    operator: PreisachOperator
    slope: float
    residual: Floats

    @property
    def rmse(self) -> float:
        """Root mean square of the residual [output unit]."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def predict(self, v: ArrayLike, history: ArrayLike = ()) -> Floats:
        """Return the output under `v` (n,) after `history`, which starts in negative saturation."""
        values = finite_array(v, "v")
        return self.operator(values, self.operator.memory(history)) + self.slope * values


def fit_preisach(
    v: ArrayLike,
    u: ArrayLike,
    walls: ArrayLike,
    *,
    nonnegative: bool = True,
    linear: bool = False,
    diagonal: Diagonal = "triangle",
    history: ArrayLike | None = None,
) -> PreisachFit:
    """Minimise |S w - u|_2 over densities, bias and, if asked for, the slope of a linear term.

    For the damped oscillation (`excitation.damped_oscillation(walls)`, exactly) the sparse inverse of S is
    used: milliseconds where the dense problem takes seconds. Any other input goes through the normal equations, which are
    assembled from the sparse form of the recording (`everett_rows`); a signed fit through the dense matrix.

    With inputs on the walls only, a linear term cannot be told from the cells on the diagonal: one sample
    more, at an input outside the grid or (with `diagonal="triangle"`) between walls, is needed. Section 4.4
    says that any non-zero input serves; one on a wall does not.

    Parameters
    ----------
    v, u : (n,) input and measured output
    walls : (L + 1,) increasing input levels
    nonnegative : demand densities >= 0 (bias and slope are free); else the signed Preisach operator of 5.3.2
    linear : include the linear term of (4.19)
    diagonal : how the cells on the diagonal count, see `PreisachOperator`
    history : (m,) inputs before `v` from negative saturation; None where `v` starts in negative saturation

    Returns
    -------
    PreisachFit : operator, slope of the linear term, residual

    Raises
    ------
    ValueError : not finite, shapes differ, or too little excitation: fewer samples than unknowns, cells that
        never switch, or unknowns that the input does not tell apart.

    Examples
    --------
    >>> walls = np.linspace(0.0, 1.0, 9)
    >>> truth = PreisachOperator(walls, np.arange(1.0, 37.0), bias=-2.0)
    >>> v = np.append(damped_oscillation(walls), [1.2, 0.3])
    >>> fit = fit_preisach(v, truth(v) - 5.0 * v, walls, linear=True)
    >>> round(fit.slope, 6), bool(np.max(np.abs(fit.operator.density - truth.density)) < 1e-6)
    (-5.0, True)
    """
    checked = checked_walls(walls)
    inputs = finite_array(v, "v")
    outputs = finite_array(u, "u", size=inputs.size)
    level = checked.size - 1
    cells = cell_count(level)
    areas = pack(cell_areas(checked, diagonal))
    if not linear and history is None and _is_damped_oscillation(inputs, checked):
        inverse = inverse_map(level)
        weights = inverse[:cells] @ outputs
        bias = float((inverse[cells] @ outputs)[0])
        if nonnegative:
            # a face per cell, in units of density: where it holds, that density is zero
            faces = sparse.csr_matrix(sparse.diags_array(1.0 / areas) @ inverse[:cells])
            fitted, density = projected_outputs(faces, outputs)
            bias = float((inverse[cells] @ fitted)[0])
            weights = density * areas
        operator = PreisachOperator(checked, weights / areas, bias, diagonal)
        return PreisachFit(operator, 0.0, outputs - operator(inputs))

    free = np.arange(cells + 1 + linear) >= cells
    unknowns = free.size
    try:
        if nonnegative:
            areas_of, normal = _signed_areas(inputs, checked, areas, linear, history)
            _refuse_still_cells(normal, areas_of, cells, checked)
            solution = nonnegative_least_squares(areas_of, outputs, free, normal)
            residual = outputs - areas_of @ solution
        else:
            matrix = signed_area_matrix(inputs, checked, linear=linear, diagonal=diagonal, history=history)
            _refuse_still_cells(matrix.T @ matrix, matrix, cells, checked)
            solution, _, rank, _ = linalg.lstsq(matrix, outputs, lapack_driver="gelsy", cond=1e-11)
            residual = outputs - matrix @ solution
            if rank < unknowns:
                raise RankDeficientError(
                    f"the matrix of signed areas has rank {rank} for {unknowns} unknowns"
                )
    except RankDeficientError as error:
        raise ValueError(
            f"v: found too little excitation ({error}), need an input for which the {unknowns} unknowns are "
            "independent, such as excitation.damped_oscillation(walls)"
            + (
                " with one more sample outside the walls for the linear term"
                if linear
                else ", or a smoothness-regularised fit"
            )
        ) from error
    slope = float(solution[-1]) if linear else 0.0
    operator = PreisachOperator(checked, solution[:cells], float(solution[cells]), diagonal)
    return PreisachFit(operator, slope, residual)


def _signed_areas(
    inputs: Floats, walls: Floats, areas: Floats, linear: bool, history: ArrayLike | None
) -> tuple[LinearOperator, Floats]:
    """Return the matrix of signed areas as an operator, and its normal matrix, from their sparse form.

    signed areas = (rows C - 1) diag(areas) with node values = C masses: nothing of the size samples times cells is
    formed, and the product with the transpose costs what the sparse rows weigh.
    """
    rows = everett_rows(inputs, walls, history=history)
    count, cells = rows.shape
    extra = np.column_stack([np.ones(count), inputs]) if linear else np.ones((count, 1))

    def apply(x: Floats) -> Floats:
        masses = areas * x[:cells]
        found = rows @ node_values(masses) - masses.sum() + extra @ x[cells:]
        return np.asarray(found, dtype=np.float64)

    def adjoint(y: Floats) -> Floats:
        return np.concatenate([areas * (mass_gradient(rows.T @ y) - y.sum()), extra.T @ y])

    normal = np.empty((cells + extra.shape[1],) * 2)
    border = np.column_stack([mass_gradient(rows.T @ column) - column.sum() for column in extra.T])
    sums = border[:, 0] + count
    inside = mass_gram(rows.T @ rows)
    inside += count - sums - sums[:, None]
    inside *= areas
    inside *= areas[:, None]
    normal[:cells, :cells] = inside
    normal[:cells, cells:] = areas[:, None] * border
    normal[cells:, :cells] = normal[:cells, cells:].T
    normal[cells:, cells:] = extra.T @ extra
    shape = (count, cells + extra.shape[1])
    return LinearOperator(shape, matvec=apply, rmatvec=adjoint, dtype=np.float64), normal


def _refuse_still_cells(normal: Floats, matrix: Floats | LinearOperator, cells: int, walls: Floats) -> None:
    """Raise if the column of a cell does not vary, by its variance."""
    square = np.diag(normal)[:cells]
    mean = (matrix.T @ np.ones(matrix.shape[0]))[:cells] / matrix.shape[0]
    still = square - matrix.shape[0] * mean**2 <= 1e-11 * square
    if np.any(still):
        i, j = (int(k[np.flatnonzero(still)[0]]) for k in np.tril_indices(walls.size - 1))
        raise ValueError(
            f"v: found {np.count_nonzero(still)} of {cells} cells that never switch (the first: alpha in "
            f"[{walls[i]:g}, {walls[i + 1]:g}], beta in [{walls[j]:g}, {walls[j + 1]:g}]), need an input that "
            "excites all, such as excitation.damped_oscillation(walls), or fewer cells"
        )


def _is_damped_oscillation(inputs: Floats, walls: Floats) -> bool:
    level = walls.size - 1
    return inputs.size == cell_count(level) + 1 and bool(
        np.all(np.abs(inputs - damped_oscillation(walls)) <= 1e-12 * (walls[-1] - walls[0]))
    )
