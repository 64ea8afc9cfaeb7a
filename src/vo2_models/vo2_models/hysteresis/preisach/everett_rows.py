"""The outputs of a recording as sparse combinations of the Everett function at the nodes of the grid.

A sample's output is a sum of one Everett value per leg of the memory that is not wiped out, and inside a cell each value
is that of four nodes and two diagonal triangles. So in the node values, output = bias - E[L, 0] + rows @ E has a
handful of entries a row where the matrix of signed areas has L (L + 1) / 2, and the constraint "no negative mass" is
a second difference of four of them. Normal equations cost what the data weigh, not what the plane does.

Nodes (a, b), b < a <= L are packed like the cells: (1, 0), (2, 0), (2, 1), ...
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from vo2_models.hysteresis.preisach.grid import cell_count, checked_walls
from vo2_models.hysteresis.preisach.kernels import HEADER, turn_and_wipe
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array

__all__ = ["everett_rows", "mass_gradient", "mass_gram", "mass_map", "node_values"]

Floats = NDArray[np.float64]


@kernel(inline="always")
def _add(a, b, value, at, row, rows, columns, values):
    """Append `value` times E[a, b], which is symmetric and zero for a = b."""
    if a == b or value == 0.0:
        return at
    high = max(a, b)
    rows[at] = row
    columns[at] = high * (high - 1) // 2 + min(a, b)
    values[at] = value
    return at + 1


@kernel
def _legs(v, state, walls, kept, rows, columns, values):
    """Follow the memory; write the entries of the samples `kept` if there is room for any, and count the legs.

    Returns the number of entries written, or of legs if `rows` is empty.
    """
    at = 0
    sample = 0
    for k in range(v.size):
        x = min(max(v[k], walls[0]), walls[-1])
        if x != state[1]:
            turn_and_wipe(x, state, walls)
            state[1] = x
        if not kept[k]:
            continue
        n = int(state[0])
        if rows.size == 0:
            at += n
            continue
        for leg in range(n):
            y = state[HEADER + 2 * leg]
            z = state[HEADER + 2 * (leg + 1)] if leg + 1 < n else x
            sign = 2.0 if leg % 2 == 0 else -2.0
            q = min(np.searchsorted(walls, y, side="right") - 1, walls.size - 2)
            p = min(np.searchsorted(walls, z, side="right") - 1, walls.size - 2)
            g = (y - walls[q]) / (walls[q + 1] - walls[q])
            f = (z - walls[p]) / (walls[p + 1] - walls[p])
            at = _add(q, p, sign * (1.0 - g) * (1.0 - f), at, sample, rows, columns, values)
            at = _add(q + 1, p, sign * g * (1.0 - f), at, sample, rows, columns, values)
            at = _add(q, p + 1, sign * (1.0 - g) * f, at, sample, rows, columns, values)
            at = _add(q + 1, p + 1, sign * g * f, at, sample, rows, columns, values)
            # the triangles on the diagonal, (q, q) and (p, p), fill with the square of the share
            at = _add(q + 1, q, sign * g * (g - 1.0), at, sample, rows, columns, values)
            at = _add(p + 1, p, sign * f * (f - 1.0), at, sample, rows, columns, values)
        sample += 1
    return at


def everett_rows(
    v: ArrayLike,
    walls: ArrayLike,
    *,
    history: ArrayLike | None = None,
    kept: ArrayLike | None = None,
) -> sparse.csr_array:
    """Return R with output = bias - E[L, 0] + R @ E along the input.

    Parameters
    ----------
    v : (n,) input
    walls : (L + 1,) increasing input levels
    history : (m,) input before `v`, from negative saturation; none means negative saturation
    kept : (n,) True for the samples that get a row, all by default

    Returns
    -------
    (kept samples, L (L + 1) / 2), E packed as the module says.

    Raises
    ------
    ValueError : `v`, `walls` or `history` not finite, walls not increasing, `kept` of another shape.

    Examples
    --------
    >>> everett_rows([0.0, 2.0, 1.0], [0.0, 1.0, 2.0]).toarray().tolist()
    [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 2.0, -2.0]]
    """
    grid = checked_walls(walls)
    values = finite_array(v, "v")
    before = finite_array(history, "history") if history is not None else np.empty(0)
    wanted = np.ones(values.size, dtype=np.bool_) if kept is None else np.asarray(kept, dtype=np.bool_)
    if wanted.shape != values.shape:
        raise ValueError(f"kept: found shape {wanted.shape}, need {values.shape} as v has")
    path = np.concatenate([before, values])
    mask = np.concatenate([np.zeros(before.size, dtype=np.bool_), wanted])
    none, nowhere = np.empty(0, dtype=np.int64), np.empty(0)

    def start() -> Floats:
        state = np.zeros(HEADER + 2 * (path.size + 2))
        state[:4] = 1.0, grid[0], 0.0, grid[0]
        return state

    room = 6 * max(_legs(path, start(), grid, mask, none, none, nowhere), 1)
    rows, columns, entries = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    used = _legs(path, start(), grid, mask, rows, columns, entries)
    shape = (int(np.count_nonzero(wanted)), cell_count(grid.size - 1))
    found = sparse.coo_array((entries[:used], (rows[:used], columns[:used])), shape=shape).tocsr()
    found.eliminate_zeros()
    return found


def mass_map(level: int) -> sparse.csr_array:
    """Return G with mass = G @ E: each cell is the second difference of its four nodes.

    >>> mass_map(2).toarray().tolist()
    [[1.0, 0.0, 0.0], [-1.0, 1.0, -1.0], [0.0, 0.0, 1.0]]

    Parameters
    ----------
    level : L, number of cells along one axis
    """
    i, j = np.tril_indices(level)
    cell = np.arange(i.size)
    rows, columns, values = [], [], []
    for a, b, sign in ((i + 1, j, 1.0), (i, j, -1.0), (i + 1, j + 1, -1.0), (i, j + 1, 1.0)):
        there = a > b
        rows.append(cell[there])
        columns.append(a[there] * (a[there] - 1) // 2 + b[there])
        values.append(np.full(np.count_nonzero(there), sign))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.coo_array(entries, shape=(i.size, i.size)).tocsr()


@kernel
def _accumulate(packed, level, outwards):
    """Node values from masses (`outwards`), or the adjoint of that, in place on each row."""
    for r in range(packed.shape[0]):
        row = packed[r]
        if outwards:
            for i in range(level):  # E[i + 1, j]: all cells with alpha up to i and beta from j
                k = i * (i + 1) // 2
                for j in range(i - 1, -1, -1):
                    row[k + j] += row[k + j + 1]
                for j in range(i):
                    row[k + j] += row[k - i + j]
        else:
            for i in range(level - 1, -1, -1):
                k = i * (i + 1) // 2
                if i + 1 < level:
                    for j in range(i + 1):
                        row[k + j] += row[k + i + 1 + j]
            for i in range(level):
                k = i * (i + 1) // 2
                for j in range(1, i + 1):
                    row[k + j] += row[k + j - 1]


def _level(size: int) -> int:
    return int((np.sqrt(8.0 * size + 1.0) - 1.0) / 2.0 + 0.5)


def node_values(masses: Floats) -> Floats:
    """Return the Everett function at the nodes from the masses of the cells, both packed (K,): the inverse of G."""
    nodes = np.array(masses, dtype=np.float64)[None]
    _accumulate(nodes, _level(nodes.shape[1]), True)
    return nodes[0]


def mass_gradient(gradient: Floats) -> Floats:
    """Return the derivatives to the masses (K,) from those to the node values: the transpose of `node_values`.

    Parameters
    ----------
    gradient : derivatives to the node values
    """
    masses = np.array(gradient, dtype=np.float64)[None]
    _accumulate(masses, _level(masses.shape[1]), False)
    return masses[0]


def mass_gram(gram: sparse.sparray) -> Floats:
    """Return the normal matrix (K, K) of the masses from that of the node values.

    Parameters
    ----------
    gram : normal matrix of the node values
    """
    dense = np.ascontiguousarray(gram.toarray(), dtype=np.float64)
    level = _level(dense.shape[1])
    _accumulate(dense, level, False)
    dense = np.ascontiguousarray(dense.T)
    _accumulate(dense, level, False)
    return dense
