"""The triangular grid of the Preisach plane: cells, their areas, and the Everett table over its nodes.

A cell (i, j), j <= i, holds the hysterons with upper threshold alpha in [walls[i], walls[i + 1]] and lower
threshold beta in [walls[j], walls[j + 1]]. Cell quantities are kept as lower triangular (L, L) arrays, or
packed row by row into vectors of L (L + 1) / 2 elements: (0,0), (1,0), (1,1), (2,0), ...
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.validation import finite_array, increasing

__all__ = ["Diagonal", "cell_areas", "cell_count", "checked_walls", "everett_table", "pack", "unpack"]

Floats = NDArray[np.float64]

Diagonal = Literal["triangle", "square"]
"""How the area of a cell on the diagonal counts: its true half, or like all others (section 4.1)."""


def checked_walls(walls: ArrayLike, name: str = "walls") -> Floats:
    """Return `walls` (L + 1,) as increasing finite floats, at least two.

    Parameters
    ----------
    name : what the walls are called in the message
    """
    array = increasing(finite_array(walls, name), name)
    if array.size < 2:
        raise ValueError(f"{name}: found {array.size} value(s), need at least 2 (one cell)")
    return array


def cell_count(level: int) -> int:
    """Return L (L + 1) / 2.

    Parameters
    ----------
    level : L, number of cells along one axis
    """
    return level * (level + 1) // 2


def pack(cells: Floats) -> Floats:
    """Return the lower triangle of (L, L) as a vector, row by row.

    Parameters
    ----------
    cells : (L, L), used on and below the diagonal
    """
    return np.ascontiguousarray(cells[np.tril_indices(cells.shape[0])])


def unpack(vector: Floats) -> Floats:
    """Return the (L, L) lower triangular array of a packed vector; raise `ValueError` for an odd length."""
    level = int((np.sqrt(8 * vector.size + 1) - 1) / 2 + 0.5)
    if cell_count(level) != vector.size:
        raise ValueError(f"vector: found {vector.size} elements, need L (L + 1) / 2 for some level L")
    cells = np.zeros((level, level))
    cells[np.tril_indices(level)] = vector
    return cells


def cell_areas(walls: Floats, diagonal: Diagonal = "triangle") -> Floats:
    """Return the areas of the cells (L, L), zero above the diagonal.

    Parameters
    ----------
    walls : (L + 1,) increasing

    Raises
    ------
    ValueError : `diagonal` is neither "triangle" nor "square".
    """
    if diagonal not in ("triangle", "square"):
        raise ValueError(f"diagonal: found {diagonal!r}, need 'triangle' or 'square'")
    width = np.diff(walls)
    areas = np.tril(np.outer(width, width))
    if diagonal == "triangle":
        areas[np.diag_indices_from(areas)] *= 0.5
    return areas


def everett_table(weights: Floats) -> Floats:
    """Return the Everett function at the nodes: E[i, j] = sum of weights with walls[j] <= beta, alpha <= walls[i].

    Parameters
    ----------
    weights : (L, L) integral of the density over each cell, lower triangular

    Returns
    -------
    (L + 1, L + 1) symmetric: E[j, i] = E[i, j]. With this extension one interpolation formula holds for
    every pair of cells, the diagonal included, and a sweep of either argument reads neighbouring memory.
    """
    level = weights.shape[0]
    table = np.zeros((level + 1, level + 1))
    sums = np.cumsum(weights, axis=0)
    table[1:, :level] = np.cumsum(sums[:, ::-1], axis=1)[:, ::-1]
    table = np.tril(table, -1)
    return table + table.T
