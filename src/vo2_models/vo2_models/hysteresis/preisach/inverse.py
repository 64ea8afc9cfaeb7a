"""The exact inverse of a Preisach operator with non-negative density (appendix A, and (5.14))."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import REACHED, Inversion
from vo2_models.hysteresis.preisach.kernels import HEADER, cell_polynomial, leg_start, locate, step
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array

__all__ = ["PreisachInverse"]

Floats = NDArray[np.float64]


@kernel
def invert(target, state, table, walls, half, buckets, scale):
    """Return the input that leads from `state` to output `target`, and move the state there; NaN for NaN.

    The stored outputs of the turning points say which corners are wiped out on the way, a bisection over the
    walls finds the cell, and in it a quadratic is solved. An unreachable target ends in saturation.
    """
    if target != target:
        return np.nan
    now = state[1]
    if target == state[2]:
        return now
    n = int(state[0])
    rises = target > state[2]
    base_v = now
    base_u = state[2]
    corner = n - 1
    if rises == (n % 2 == 1):
        base_v = state[HEADER + 2 * (n - 1)]
        base_u = state[HEADER + 2 * (n - 1) + 1]
        corner = n - 2
    while corner >= 0:
        passed = state[HEADER + 2 * corner + 1]
        if (target <= passed) if rises else (target >= passed):
            break
        if corner == 0:  # beyond negative saturation
            step(walls[0], state, table, walls, half, buckets, scale)
            return walls[0]
        base_v = state[HEADER + 2 * (corner - 1)]
        base_u = state[HEADER + 2 * (corner - 1) + 1]
        corner -= 2
    sign = 1.0 if rises else -1.0
    q, share, parabola = leg_start(base_v, walls, half, buckets, scale)
    # the output grows with the input on either kind of leg; where it is flat, the end nearer to the start counts
    low = locate(base_v, walls, buckets, scale) if rises else 0
    high = walls.size - 2 if rises else q
    while low < high:
        middle = (low + high + 1) // 2
        node = (1.0 - share) * table[q, middle] + share * table[q + 1, middle]
        output = base_u + 2.0 * sign * (node + parabola)
        if (output < target) if rises else (output <= target):
            low = middle
        else:
            high = middle - 1
    p = low
    c0, c1, c2 = cell_polynomial(sign, base_u, q, share, parabola, p, table, walls, half)
    # start where the leg enters the cell: from there the parabola opens towards the target
    width = walls[p + 1] - walls[p]
    entry = 0.0 if rises else width
    start = base_v - walls[p] if p == q else entry
    missing = sign * (target - (c0 + start * (c1 + start * c2)))
    slope = max(c1 + 2.0 * c2 * start, 0.0)
    root = slope + np.sqrt(max(slope * slope + 4.0 * sign * c2 * missing, 0.0))
    move = 2.0 * missing / root if missing > 0.0 and root > 0.0 else 0.0
    v = walls[p] + min(max(start + sign * move, 0.0), width)
    v = max(v, now) if rises else min(v, now)
    step(v, state, table, walls, half, buckets, scale)
    return v


@kernel
def invert_run(u, v, reached, tolerance, state, table, walls, half, buckets, scale):
    """`invert` along a sequence."""
    for k in range(u.size):
        v[k] = invert(u[k], state, table, walls, half, buckets, scale)
        reached[k] = abs(state[2] - u[k]) <= tolerance


@dataclass(frozen=True, eq=False)
class PreisachInverse:
    """The input sequence that makes a Preisach operator follow a desired output.

    Every output between the saturations is reached with one input; beyond them the saturating input is given
    and flagged. Where the density vanishes, so that many inputs serve, the one nearest to the present input is.

    Parameters
    ----------
    operator : with density >= 0

    Raises
    ------
    ValueError : a negative density, where the output is not monotone: see `NonMonotonicPreisach`.

    Examples
    --------
    >>> operator = PreisachOperator([0.0, 1.0, 2.0], [[1.0, 0.0], [2.0, 1.0]])
    >>> inverse, state = PreisachInverse(operator), operator.initial_memory()
    >>> inverse.update(-2.0, state), inverse.update(-2.25, state), inverse.update(9.0, state)
    ((1.0, True), (0.5, True), (2.0, False))
    """

    operator: PreisachOperator
    _tolerance: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        density = self.operator.density
        if np.any(density < 0):
            i, j = (int(k) for k in np.argwhere(density < 0)[0])
            raise ValueError(f"operator: found density {density[i, j]:g} at {(i, j)}, need densities >= 0")
        low, high = self.operator.output_range
        object.__setattr__(self, "_tolerance", REACHED * (high - low))

    def update(self, u: float, memory: Floats) -> tuple[float, bool]:
        """Return the input for output `u` and whether it is reached; `memory` moves along.

        Raises
        ------
        ValueError : `u` is NaN.
        """
        v = invert(float(u), memory, *self.operator.compiled)
        if v != v:
            raise ValueError("u: found nan, need a number; hold the last output or skip the sample")
        return v, bool(abs(memory[2] - u) <= self._tolerance)

    def invert(self, output: float, memory: Floats) -> Inversion:
        """`update` as every law's inverse gives it."""
        v, reached = self.update(output, memory)
        return Inversion(v, float(memory[2]), reached)

    def run(self, u: ArrayLike, memory: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the inputs (n,) for the outputs `u` (n,) and which are reached; `memory` moves along.

        Raises
        ------
        ValueError : `u` not finite or not one-dimensional.
        """
        outputs = finite_array(u, "u")
        v = np.empty_like(outputs)
        reached = np.zeros(outputs.size, dtype=np.bool_)
        invert_run(outputs, v, reached, self._tolerance, memory, *self.operator.compiled)
        return v, reached
