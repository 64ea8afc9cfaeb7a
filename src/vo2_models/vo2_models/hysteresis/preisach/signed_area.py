"""The matrix of signed areas: how much of each cell is switched up minus how much is down, sample by sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.preisach.grid import Diagonal, cell_areas, cell_count, checked_walls, pack
from vo2_models.hysteresis.preisach.kernels import HEADER, turn_and_wipe
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array

__all__ = ["signed_area_matrix"]

Floats = NDArray[np.float64]


@kernel
def _add_strip(row, factor, begin, end, top, walls, square):
    """Add `factor` times the area under height `top` for beta in [begin, end] to the packed cells."""
    for j in range(walls.size - 1):
        left = max(begin, walls[j])
        right = min(end, walls[j + 1])
        if left >= right:
            continue
        for i in range(j, walls.size - 1):
            if walls[i] >= top:
                break
            upper = min(walls[i + 1], top)
            if i > j:
                area = (right - left) * (upper - walls[i])
            else:
                stop = min(right, upper)
                area = (stop - left) * (upper - 0.5 * (left + stop)) if stop > left else 0.0
                if square:
                    area *= 2.0
            row[i * (i + 1) // 2 + j] += factor * area


@kernel
def _signed_areas(v, state, walls, square, areas, out):
    """Fill `out[:, :K]`, or only follow the memory if `areas` is empty."""
    cells = areas.size
    for k in range(v.size):
        x = min(max(v[k], walls[0]), walls[-1])
        if x != state[1]:
            turn_and_wipe(x, state, walls)
            state[1] = x
        if cells == 0:
            continue
        for c in range(cells):
            out[k, c] = -areas[c]
        n = int(state[0])
        for top in range(1, n, 2):
            low = state[HEADER + 2 * (top - 1)]
            high = state[HEADER + 2 * (top + 1)] if top + 1 < n else x
            _add_strip(out[k], 2.0, low, high, state[HEADER + 2 * top], walls, square)
        if n % 2 == 1:
            _add_strip(out[k], 2.0, state[HEADER + 2 * (n - 1)], x, x, walls, square)


def signed_area_matrix(
    v: ArrayLike,
    walls: ArrayLike,
    *,
    bias: bool = True,
    linear: bool = False,
    diagonal: Diagonal = "triangle",
    history: ArrayLike | None = None,
) -> Floats:
    """Return S with output = S w: (4.3), and (4.19) with the linear term.

    Parameters
    ----------
    v : (n,) input
    walls : (L + 1,) increasing input levels
    bias : append the column of ones for the bias
    linear : append the column of inputs for the linear term
    diagonal : how the cells on the diagonal count, see `PreisachOperator`
    history : (m,) input before `v`, from negative saturation; none means negative saturation

    Returns
    -------
    (n, L (L + 1) / 2 and one more for each of `bias` and `linear`) areas [input unit^2], the cells packed row by row.

    Raises
    ------
    ValueError : `v`, `walls` or `history` not finite, walls not increasing.

    Examples
    --------
    >>> signed_area_matrix([0.0, 2.0, 1.0], [0.0, 1.0, 2.0], diagonal="square").tolist()
    [[-1.0, -1.0, -1.0, 1.0], [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, -1.0, 1.0]]
    """
    checked = checked_walls(walls)
    values = finite_array(v, "v")
    before = finite_array(history, "history") if history is not None else np.empty(0)
    areas = pack(cell_areas(checked, diagonal))
    cells = cell_count(checked.size - 1)
    # room for every turning point, so that none is forgotten
    state = np.zeros(HEADER + 2 * (before.size + values.size + 2))
    state[:4] = 1.0, checked[0], 0.0, checked[0]
    matrix = np.empty((values.size, cells + bias + linear))
    square = diagonal == "square"
    _signed_areas(before, state, checked, square, areas[:0], np.empty((before.size, 0)))
    _signed_areas(values, state, checked, square, areas, matrix)
    if bias:
        matrix[:, cells] = 1.0
    if linear:
        matrix[:, cells + bias] = values
    return matrix
