"""The damped oscillation solved exactly: its matrix of signed areas has a sparse inverse.

Each level of the sequence closes one cell of the plane, so the integral of the density over a cell is a
second difference of four outputs (`inverse_map`). This proves full rank for every level, gives the
densities in O(N) operations, and turns non-negative least squares into the projection of the outputs onto
a polyhedron with sparse faces: minimise |z - b|^2 subject to G z >= 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from vo2_models.hysteresis.preisach.grid import cell_count

__all__ = ["inverse_map", "sample_index"]

Floats = NDArray[np.float64]


def sample_index(level: int) -> NDArray[np.intp]:
    """Return (L + 1, L + 1, 2): which two samples, `high` and `low`, give the Everett function at node (i, j).

    E[i, j] = (output[high] - output[low]) / 2 for i > j, from the leg of the damped oscillation that
    connects the walls i and j. Entries with i <= j are -1.

    Parameters
    ----------
    level : L, number of cells along one axis
    """
    index = np.full((level + 1, level + 1, 2), -1, dtype=np.intp)
    position = 0
    for k in range((level + 1) // 2):
        # rise from wall k to wall L - k, then fall to wall k + 1
        up = np.arange(k + 1, level - k + 1)
        index[up, k, 0] = position + 1 + np.arange(up.size)
        index[up, k, 1] = position
        position += up.size
        down = np.arange(level - k - 1, k, -1)
        index[level - k, down, 0] = position
        index[level - k, down, 1] = position + 1 + np.arange(down.size)
        position += down.size
    return index


def inverse_map(level: int) -> sparse.csr_matrix:
    """Return the (N, N) inverse of S for cells of unit area (the diagonal too): at most four entries a row.

    Rows are the cells, packed row by row, then the bias; columns the N = L (L + 1) / 2 + 1 outputs of
    `excitation.damped_oscillation`. For other areas divide each cell's row by its area.

    Parameters
    ----------
    level : L, number of cells along one axis
    """
    index = sample_index(level)
    cells = cell_count(level)
    i, j = np.tril_indices(level)
    k = np.arange(cells)
    rows, columns, values = [], [], []
    # E[i+1, j] - E[i, j] - E[i+1, j+1] + E[i, j+1]; E vanishes on and above the diagonal
    for di, dj, sign in ((1, 0, 0.5), (0, 0, -0.5), (1, 1, -0.5), (0, 1, 0.5)):
        pair = index[i + di, j + dj]
        there = pair[:, 0] >= 0
        for end, factor in ((0, sign), (1, -sign)):
            rows.append(k[there])
            columns.append(pair[there, end])
            values.append(np.full(int(np.sum(there)), factor))
    rows.append(np.full(2, cells))
    columns.append(index[level, 0])
    values.append(np.full(2, 0.5))
    matrix = sparse.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(cells + 1, cells + 1),
    ).tocsr()
    matrix.eliminate_zeros()
    return matrix
