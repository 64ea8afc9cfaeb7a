"""Inverse of the non-monotonic Preisach model by the algorithm of section 5.4.1."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis import law
from vo2_models.hysteresis.law import REACHED
from vo2_models.hysteresis.preisach.kernels import HEADER, cell_polynomial, leg_start, locate
from vo2_models.hysteresis.preisach.nonmonotonic import NonMonotonicPreisach
from vo2_models.numerics.kernel import kernel

__all__ = ["Inversion", "NonMonotonicInverse"]

Floats = NDArray[np.float64]


@kernel
def first_root(quadratic, linear, rise, limit):
    """Return the smallest d in (0, limit] with quadratic d^2 + linear d = rise, or -1: (5.19)."""
    if quadratic == 0.0:
        d = rise / linear if linear != 0.0 else -1.0
        other = -1.0
    else:
        discriminant = linear * linear + 4.0 * quadratic * rise
        if discriminant < 0.0:
            return -1.0
        q = -0.5 * (linear + np.copysign(np.sqrt(discriminant), linear))
        d = q / quadratic
        other = -rise / q if q != 0.0 else -1.0
    if d <= 0.0 or (0.0 < other < d):
        d = other
    if d <= 0.0 or d > limit * (1.0 + 1e-9):
        return -1.0
    return min(d, limit)


@kernel
def search(target, rises, state, q0, q1, q2, table, walls, half, buckets, scale):
    """Move monotonically until the output meets `target`; return that temperature (or NaN) and the iterations.

    Steps from wall to wall and from corner to corner of the memory curve; between them the output is one
    parabola. The state is only read.
    """
    n = int(state[0])
    now = state[1]
    base_v = now
    base_u = state[2]
    corner = n - 1
    if rises == (n % 2 == 1):
        base_v = state[HEADER + 2 * (n - 1)]
        base_u = state[HEADER + 2 * (n - 1) + 1]
        corner = n - 2
    sign = 1.0 if rises else -1.0
    last = walls.size - 2
    q, share, parabola = leg_start(base_v, walls, half, buckets, scale)
    p = locate(now, walls, buckets, scale)
    iterations = 0
    while True:
        if rises and p < last and now >= walls[p + 1]:
            p += 1
        elif not rises and p > 0 and now <= walls[p]:
            p -= 1
        end = walls[p + 1] if rises else walls[p]
        wiped = corner >= 1 and (
            state[HEADER + 2 * corner] <= end if rises else state[HEADER + 2 * corner] >= end
        )
        if wiped:
            end = state[HEADER + 2 * corner]
        limit = abs(end - now)
        if limit > 0.0:
            iterations += 1
            c0, c1, c2 = cell_polynomial(sign, base_u, q, share, parabola, p, table, walls, half)
            t = now - walls[p]
            output = c0 + t * (c1 + t * c2) + q0 + now * (q1 + now * q2)
            slope = c1 + 2.0 * c2 * t + q1 + 2.0 * q2 * now
            d = first_root(c2 + q2, sign * slope, target - output, limit)
            if d >= 0.0:
                return now + sign * d, iterations
            now = end
        if wiped:
            base_v = state[HEADER + 2 * (corner - 1)]
            base_u = state[HEADER + 2 * (corner - 1) + 1]
            corner -= 2
            q, share, parabola = leg_start(base_v, walls, half, buckets, scale)
        elif now >= walls[-1] if rises else now <= walls[0]:
            return np.nan, iterations


@dataclass(frozen=True)
class Inversion:
    """What `NonMonotonicInverse.update` found.

    Attributes
    ----------
    temperatures : one or two inputs to apply one after the other [degC]
    output : the output they lead to
    reached : whether that is the desired output, within 1e-9 of the output range
    iterations : segments searched; at most corners + L by Proposition 5
    """

    temperatures: tuple[float, ...]
    output: float
    reached: bool
    iterations: int


@dataclass(frozen=True, eq=False)
class NonMonotonicInverse:
    """At most two temperatures that lead from the present memory to a desired output: section 5.4.1.

    A higher output is sought by heating towards T_max; if it exceeds the output there, by heating to T_max
    and cooling from there (lower outputs: mirrored). Outside [minimum, maximum] the nearest reachable output
    is given, by Proposition 4 on the way back from saturation, and flagged.

    Attributes
    ----------
    minimum, maximum : the reachable outputs (temperature, output) within the grid, by Proposition 4

    Raises
    ------
    ValueError : a negative density.

    Examples
    --------
    >>> from vo2_models.hysteresis.preisach import PreisachOperator
    >>> operator = PreisachOperator([30.0, 50.0, 70.0], np.full(3, 0.5))
    >>> model = NonMonotonicPreisach(operator, k0=2.0, k1=4.0)
    >>> state = operator.initial_memory()
    >>> found = NonMonotonicInverse(model).update(150.0, state)
    >>> found.reached, round(found.output, 9), model(found.temperatures).round(9).tolist()[-1]
    (True, 150.0, 150.0)
    """

    model: NonMonotonicPreisach
    minimum: tuple[float, float] = field(init=False)
    maximum: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        operator = self.model.operator
        if np.any(operator.density < 0):
            raise ValueError(
                f"model: found density {operator.density.min():g}, need densities >= 0 (a signed operator has no such inverse)"
            )
        object.__setattr__(self, "maximum", self._extreme(+1))
        object.__setattr__(self, "minimum", self._extreme(-1))

    def _extreme(self, sign: int) -> tuple[float, float]:
        """Return where the branch that leaves saturation `sign` has its largest (smallest) output, and that."""
        table, walls, half, _, _ = self.model.operator.compiled
        q0, q1, q2 = self.model.parabola
        node = table[-1] if sign > 0 else table[0]
        width = np.diff(walls)
        start = self.model.operator.output_range[sign > 0]
        c2 = -2.0 * sign * half
        c1 = -2.0 * sign * (np.diff(node) / width - half * width)
        quadratic, linear = c2 + q2, c1 + q1 + 2.0 * q2 * walls[:-1]
        vertex = np.divide(-linear, 2.0 * quadratic, out=np.zeros_like(width), where=quadratic != 0)
        t = np.stack([np.zeros_like(width), width, np.clip(vertex, 0.0, width)])
        v = walls[:-1] + t
        u = start - 2.0 * sign * node[:-1] + t * (c1 + t * c2) + q0 + v * (q1 + v * q2)
        best = np.unravel_index(np.argmax(sign * u), u.shape)
        return float(v[best]), float(u[best])

    def update(self, target: float, state: Floats) -> Inversion:
        """Return the temperatures for output `target`; `state` moves along.

        Raises
        ------
        ValueError : `target` is NaN or infinite.
        """
        if not np.isfinite(target):
            raise ValueError(f"target: found {target}, need a finite number")
        model, operator = self.model, self.model.operator
        arguments = (*model.parabola, *operator.compiled)
        low, high = float(operator.walls[0]), float(operator.walls[-1])
        now = float(state[1])
        present = float(state[2]) + float(model.expansion(now))
        rises = bool(target > present)
        far, back = (high, low) if rises else (low, high)
        saturated = operator.output_range[rises] + float(model.expansion(far))
        iterations = 0
        wanted = min(max(target, self.minimum[1]), self.maximum[1])
        if target == present:
            temperatures: tuple[float, ...] = (now,)
        elif (wanted <= saturated) if rises else (wanted >= saturated):
            found, iterations = search(wanted, rises, state, *arguments)
            temperatures = (found if found == found else far,)
        else:
            start = operator.initial_memory("upper" if rises else "lower")
            if wanted != target:
                found = self.maximum[0] if rises else self.minimum[0]
            else:
                found, iterations = search(wanted, not rises, start, *arguments)
            temperatures = (far, found if found == found else back)
        output = present
        for temperature in temperatures:
            output = model.step(temperature, state)
        tolerance = REACHED * (self.maximum[1] - self.minimum[1])
        return Inversion(temperatures, output, bool(abs(output - target) <= tolerance), iterations)

    def invert(self, output: float, memory: Floats) -> law.Inversion:
        """`update` as every law's inverse gives it: the last of the temperatures, all of them applied."""
        found = self.update(output, memory)
        return law.Inversion(found.temperatures[-1], found.output, found.reached)
