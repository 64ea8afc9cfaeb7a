"""The relay law: thousands of grains, each with its own two thresholds (Preisach's bistable units).

The input keeps its place in both sorted lists of thresholds, so that a move costs only the thresholds it crosses.
Latent heat is a Stefan problem: on heating the film stays at a grain's threshold until that grain has taken up its
share, and gives it back on cooling.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.law import implement, widened

__all__ = ["Relays", "relays"]

Array = NDArray[np.floating]
HEAD = 3
"""Memory: fraction, rank of the input among the rising thresholds, among the falling, then every grain's state."""


class Relays(NamedTuple):
    """Thresholds in rising order [degC], the grain of each, and every grain's share; all (n,)."""

    up: Array
    up_grain: NDArray[np.int64]
    down: Array
    down_grain: NDArray[np.int64]
    weight: Array


def relays(up: Array, down: Array, weight: Array) -> Relays:
    """Return the law of grains that transform above `up` and return below `down` (n,) [degC]."""
    rising, falling = np.argsort(up, kind="stable"), np.argsort(down, kind="stable")
    return Relays(up[rising], rising, down[falling], falling, weight)


@kernel
def _move(law, memory, level):
    n = law.weight.size
    above, below = int(memory[1]), int(memory[2])
    while above < n and law.up[above] <= level:
        grain = law.up_grain[above]
        if memory[HEAD + grain] == 0.0:
            memory[HEAD + grain] = 1.0
            memory[0] += law.weight[grain]
        above += 1
    while below < n and law.down[below] <= level:
        below += 1
    while below > 0 and law.down[below - 1] > level:
        grain = law.down_grain[below - 1]
        if memory[HEAD + grain] == 1.0:
            memory[HEAD + grain] = 0.0
            memory[0] -= law.weight[grain]
        below -= 1
    while above > 0 and law.up[above - 1] > level:
        above -= 1
    memory[1], memory[2] = above, below
    return memory[0]


@kernel
def _stefan(law, memory, temperature, shift, heat, latent):
    """Add `heat` grain by grain; return the temperature and the heat owed to the next step."""
    before = memory[0]  # the shift may have moved since the last step: settle first
    heat -= latent * (_move(law, memory, temperature + shift) - before)
    n = law.weight.size
    while heat > 0 and memory[1] < n and temperature + shift + heat >= law.up[int(memory[1])]:
        above = int(memory[1])
        heat -= max(law.up[above] - shift - temperature, 0.0)
        temperature = max(law.up[above] - shift, temperature)
        grain = law.up_grain[above]
        memory[1] += 1
        if memory[HEAD + grain] == 0.0:
            memory[HEAD + grain] = 1.0
            memory[0] += law.weight[grain]
            heat -= latent * law.weight[grain]
            if heat <= 0:
                return temperature, heat
    while heat < 0 and memory[2] > 0 and temperature + shift + heat < law.down[int(memory[2]) - 1]:
        below = int(memory[2]) - 1
        heat += max(temperature + shift - law.down[below], 0.0)
        temperature = min(law.down[below] - shift, temperature)
        grain = law.down_grain[below]
        memory[2] -= 1
        if memory[HEAD + grain] == 1.0:
            memory[HEAD + grain] = 0.0
            memory[0] -= law.weight[grain]
            heat += latent * law.weight[grain]
            if heat >= 0:
                return temperature, heat
    temperature += heat
    _move(law, memory, temperature + shift)
    return temperature, 0.0


def _settle(law, level):
    memory = np.zeros(HEAD + law.weight.size)
    _move(law, memory, level)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level)


def _absorb(law, memory, temperature, shift, heat, latent, step):
    return _stefan(law, memory, temperature, shift, heat, latent)


def _widen(law: Relays, width: float) -> Relays:
    up, down = np.empty_like(law.up), np.empty_like(law.down)
    up[law.up_grain], down[law.down_grain] = law.up, law.down
    return relays(*widened(up, down, width), law.weight)


implement(Relays, settle=_settle, advance=_advance, widen=_widen, absorb=_absorb)
