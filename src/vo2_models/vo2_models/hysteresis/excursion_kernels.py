"""Compiled search for outputs that one monotone move cannot give: an excursion first, then the move."""

from __future__ import annotations

import math

from vo2_models.hysteresis.inverse_kernels import SETTINGS, search_side, solve
from vo2_models.hysteresis.kernels import egpi_output, egpi_step, exact

_HALVINGS = 60


@exact
def _after_excursion(extreme, opposite, direction, u, tolerance, nearest, packed, state):
    """Move to `extreme`, then look back to `opposite` for u: found, input, distance of its output. Keeps the state."""
    trial = state.copy()
    egpi_step(extreme, packed, trial)
    gap = abs(egpi_output(packed, trial) - u)
    return search_side(-direction, extreme, opposite, u, tolerance, False, nearest, gap, packed, trial)


@exact
def plan_step(u, inverse, state):
    """Move the state to the wish u by one input or, where it takes that, two; returns first, second, output.

    `first` is NaN where one move suffices. An excursion is the shortest that makes u reachable, found by
    halving; the state ends where the last input brings it.
    """
    low = inverse[0]
    high = inverse[1]
    tolerance = inverse[2]
    packed = inverse[SETTINGS:]
    if u != u or state.size != int(packed[0]) + 1:
        return math.nan, math.nan, math.nan
    v = solve(u, inverse, state)
    trial = state.copy()
    best = abs(egpi_step(v, packed, trial) - u)
    excursion = math.nan
    if best > 10.0 * tolerance:
        now = state[0]
        for k in range(2):
            direction = 1.0 if (u > egpi_output(packed, state)) == (k == 0) else -1.0
            limit = high if direction > 0.0 else low
            opposite = low if direction > 0.0 else high
            if limit == now:
                continue
            found, second, gap = _after_excursion(
                limit, opposite, direction, u, tolerance, True, packed, state
            )
            if found:
                near = now
                far = limit
                for _ in range(_HALVINGS):
                    middle = 0.5 * (near + far)
                    if middle in (near, far):
                        break
                    here, at, _ = _after_excursion(
                        middle, opposite, direction, u, tolerance, False, packed, state
                    )
                    if here:
                        far = middle
                        second = at
                    else:
                        near = middle
                excursion = far
                v = second
                break
            if gap < best - tolerance:
                best = gap
                excursion = limit
                v = second
    if excursion == excursion:
        egpi_step(excursion, packed, state)
    return excursion, v, egpi_step(v, packed, state)
