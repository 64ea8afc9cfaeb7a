"""Compiled kernels of the Preisach operator: one step, a whole sequence, many devices.

Along one leg (monotone input since the last turning point `base`) the output is
`u = u(base) +- 2 E(v, base)` with the Everett function E, which inside a cell of the grid is a polynomial of
degree two in v. The memory is the stack of turning points that are not wiped out yet, each with the output
it had, so a step costs a comparison and a polynomial, and a wiped-out loop leaves no trace, not even of rounding.

State array: `[n, v, u, v_0, u_0, v_1, u_1, ...]`: the number of turning points, present input (clipped to
the grid) and output, then the turning points from the outermost inwards. Point 0 is the lowest wall
(negative saturation); odd n means a rising leg, even n a falling one.

A state has room for a fixed number of turning points. When it is full, two neighbouring ones are forgotten: those whose
corner of the staircase in the plane of thresholds, the rectangle between them and their neighbours, has the shortest sides.
With room for n points on a range R its area is at most (2 R / (n - 2))^2. Outputs at the points that are left stay exact, so
that what is forgotten shows between two of them only.

Operator arguments, in this order (`PreisachOperator.compiled`): `table` (L + 1, L + 1) from
`grid.everett_table`, `walls` (L + 1,), `half` (L,) half the density of the diagonal triangles, `buckets`
(B,) first guess of the cell, `scale` = B / (walls[-1] - walls[0]). `packed` is all of them in one vector:
`[L, B, scale, walls, half, buckets, table]`.
"""

from __future__ import annotations

import numpy as np

from vo2_models.numerics.kernel import kernel

__all__ = [
    "HEADER",
    "cell_polynomial",
    "leg_start",
    "locate",
    "move_preisach",
    "run",
    "run_devices",
    "step",
    "turn_and_wipe",
    "unpacked",
]

HEADER = 3
"""Elements of a state array before the turning points."""
PACKED_HEADER = 3
"""Elements of a packed operator before its arrays."""


@kernel(inline="always")
def unpacked(packed):
    """Return table, walls, half, buckets, scale of a packed operator, as views."""
    level = int(packed[0])
    nodes = PACKED_HEADER + level + 1
    guesses = nodes + level
    table = guesses + int(packed[1])
    return (
        packed[table:].reshape((level + 1, level + 1)),
        packed[PACKED_HEADER:nodes],
        packed[nodes:guesses],
        packed[guesses:table],
        packed[2],
    )


@kernel(inline="always")
def locate(v, walls, buckets, scale):
    """Return the cell that holds `v`, which must lie on the grid."""
    last = walls.size - 2
    k = min(int((v - walls[0]) * scale), buckets.size - 1)
    cell = int(buckets[k])
    upper = int(buckets[k + 1]) if k + 1 < buckets.size else last
    while upper - cell > 4:  # a strongly non-uniform grid: many cells in one bucket
        middle = (cell + upper) // 2
        if walls[middle] <= v:
            cell = middle
        else:
            upper = middle
    while cell > 0 and v < walls[cell]:
        cell -= 1
    while cell < last and v >= walls[cell + 1]:
        cell += 1
    return cell


@kernel(inline="always")
def leg_start(base_v, walls, half, buckets, scale):
    """Return q, share, parabola: cell of the leg's first point, where in it, and what the diagonal adds there."""
    q = locate(base_v, walls, buckets, scale)
    y = base_v - walls[q]
    width = walls[q + 1] - walls[q]
    return q, y / width, half[q] * y * (y - width)


@kernel(inline="always")
def _node(q, share, p, table):
    """Return the Everett function at wall `p`, between the nodes of the leg's first point."""
    return (1.0 - share) * table[q, p] + share * table[q + 1, p]


@kernel(inline="always")
def _polynomial(sign, base_u, left, right, parabola, p, walls, half):
    """Return `cell_polynomial` from the Everett function at the cell's walls."""
    width = walls[p + 1] - walls[p]
    c0 = base_u + 2.0 * sign * (left + parabola)
    c1 = 2.0 * sign * ((right - left) / width - half[p] * width)
    c2 = 2.0 * sign * half[p]
    return c0, c1, c2


@kernel(inline="always")
def cell_polynomial(sign, base_u, q, share, parabola, p, table, walls, half):
    """Return c0, c1, c2: the output on cell `p` is c0 + c1 t + c2 t^2 with t = v - walls[p].

    `sign` is +1 on a rising leg, -1 on a falling one; `base_u` is the output at its first point. The Everett
    function is bilinear between the nodes, plus the parabolas of the two diagonal triangles it cuts, which
    vanish at the nodes.
    """
    left, right = _node(q, share, p, table), _node(q, share, p + 1, table)
    return _polynomial(sign, base_u, left, right, parabola, p, walls, half)


@kernel(inline="always")
def _leg_of(v, state, walls):
    """Return how many turning points are left after a move to `v`, and whether the last is the present input."""
    n = int(state[0])
    rises = v > state[1]
    turns = rises != (n % 2 == 1)
    if turns:
        n += 1
    left = n
    if rises:
        while left >= 3 and v >= state[HEADER + 2 * (left - 2)]:
            left -= 2
    else:
        while left >= 4 and v <= state[HEADER + 2 * (left - 2)]:
            left -= 2
        if left == 2 and v <= walls[0]:
            left = 1
    return left, turns and left == n


@kernel
def _forget_smallest(state, n):
    """Take the smallest corner out of the first n turning points, to which the present input is the next one.

    By its sides and not by its area: a long and narrow one that grows at every turn would be taken again and again.
    """
    smallest = 1
    least = np.inf
    for k in range(1, n - 1):
        before, begin, end = state[HEADER + 2 * (k - 1)], state[HEADER + 2 * k], state[HEADER + 2 * (k + 1)]
        after = state[HEADER + 2 * (k + 2)] if k + 2 < n else state[1]
        sides = abs(end - before) + abs(after - begin)
        if sides < least:
            smallest = k
            least = sides
    for k in range(HEADER + 2 * smallest, HEADER + 2 * (n - 2)):
        state[k] = state[k + 4]


@kernel
def turn_and_wipe(v, state, walls):
    """Push the turning point if `v` reverses, wipe out what it passes, and return how many there are."""
    n, turned = _leg_of(v, state, walls)
    if turned:
        if HEADER + 2 * n > state.size:
            _forget_smallest(state, n - 1)
            n -= 2
        state[HEADER + 2 * (n - 1)] = state[1]
        state[HEADER + 2 * (n - 1) + 1] = state[2]
    state[0] = n
    return n


@kernel
def step(v, state, table, walls, half, buckets, scale, make=True):
    """Apply one input and return the output; `state` changes in place where `make` is true. NaN for a NaN input."""
    if v != v:
        return np.nan
    v = min(max(v, walls[0]), walls[-1])
    if v == state[1]:
        return state[2]
    n, turned = _leg_of(v, state, walls)
    base_v = state[1]
    base_u = state[2]
    if not turned:
        base_v = state[HEADER + 2 * (n - 1)]
        base_u = state[HEADER + 2 * (n - 1) + 1]
    q, share, parabola = leg_start(base_v, walls, half, buckets, scale)
    p = locate(v, walls, buckets, scale)
    sign = 1.0 if n % 2 == 1 else -1.0
    c0, c1, c2 = cell_polynomial(sign, base_u, q, share, parabola, p, table, walls, half)
    t = v - walls[p]
    u = c0 + t * (c1 + t * c2)
    if make:
        turn_and_wipe(v, state, walls)
        state[1] = v
        state[2] = u
    return u


@kernel
def move_preisach(v, packed, memory, make):
    """`step` of a packed operator: the law's compiled step, see `hysteresis.law`."""
    table, walls, half, buckets, scale = unpacked(packed)
    return step(v, memory, table, walls, half, buckets, scale, make)


@kernel
def sweep_preisach(v, packed, memory, out):
    """`run` of a packed operator."""
    table, walls, half, buckets, scale = unpacked(packed)
    run(v, out, memory, table, walls, half, buckets, scale)


@kernel
def run(v, out, state, table, walls, half, buckets, scale):
    """Apply the inputs `v` and write `out`; `state` changes in place.

    As long as the input neither turns nor crosses a wall, the same polynomial holds; as long as it neither
    turns nor wipes out a corner, the next cell's follows from two more nodes of the table.
    """
    low = walls[0]
    high = walls[-1]
    last = walls.size - 2
    now = state[1]
    u = state[2]
    up = True
    sign = 1.0
    p = 0
    q = 0
    share = 0.0
    parabola = 0.0
    base_u = 0.0
    left = 0.0
    right = 0.0
    c0 = 0.0
    c1 = 0.0
    c2 = 0.0
    begin = np.inf  # the cell's ends; none yet, so the first sample goes the long way
    end = -np.inf
    corner = -np.inf
    for k in range(v.size):
        x = min(max(v[k], low), high)
        if x == now:
            out[k] = u
            continue
        if (x > now) != up or ((x >= corner) if up else (x <= corner)):
            state[1] = now
            state[2] = u
            n = turn_and_wipe(x, state, walls)
            up = n % 2 == 1
            sign = 1.0 if up else -1.0
            base = HEADER + 2 * (n - 1)
            base_u = state[base + 1]
            q, share, parabola = leg_start(state[base], walls, half, buckets, scale)
            corner = state[base - 2] if n > 1 else np.inf
            begin = np.inf
            end = -np.inf
        if not (begin <= x < end):
            if begin <= x and p < last and x < walls[p + 2]:
                p += 1
                left, right = right, _node(q, share, p + 1, table)
            elif x < end and p > 0 and x >= walls[p - 1]:
                p -= 1
                left, right = _node(q, share, p, table), left
            else:
                p = locate(x, walls, buckets, scale)
                left, right = _node(q, share, p, table), _node(q, share, p + 1, table)
            c0, c1, c2 = _polynomial(sign, base_u, left, right, parabola, p, walls, half)
            begin = walls[p]
            end = walls[p + 1] if p < last else np.inf
        t = x - begin
        u = c0 + t * (c1 + t * c2)
        out[k] = u
        now = x
    state[1] = now
    state[2] = u


@kernel
def run_devices(v, out, state, table, walls, half, buckets, scale):
    """`run` for each row of `v` (devices, n) with its row of `state`."""
    for device in range(v.shape[0]):
        run(v[device], out[device], state[device], table, walls, half, buckets, scale)
