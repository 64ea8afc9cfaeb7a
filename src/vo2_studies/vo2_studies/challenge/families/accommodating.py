"""Domains that accommodate: while others switch, a part of each cluster takes the state of the whole film.

    q_k = 1 where T has passed the heating threshold of cluster k, 0 where it has passed the cooling one, then
    dq_k / d|s| = lambda (s - q_k),    s = sum_k share_k q_k

After Della Torre's accommodation, IEEE Trans. Magn. 30, 2701, 1994, with hysterons in clusters: small loops do not
close, they drift towards a place of their own as they are repeated, and what was wiped out is not forgotten at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.domains import draw_grains
from vo2_studies.challenge.families.law import Film, Statistics, implement, pushed, widen_thresholds

__all__ = ["Accommodating", "draw"]

Array = NDArray[np.floating]
COARSE = 20
"""Grains of the drawn ensemble that make one cluster."""
SOFT = 0.15
"""Half the interval of temperature within which a cluster switches [K]: it has many grains."""
HEAD = 1
"""Memory: fraction; then q of each cluster."""


class Accommodating(NamedTuple):
    """Of each cluster (k,): thresholds [degC] and share [1]; lambda (1,) [1]."""

    up: Array
    down: Array
    weight: Array
    rate: Array


@kernel
def _move(law, memory, level):
    before = memory[0]
    switched = 0.0
    for k in range(law.weight.size):
        q = pushed(memory[HEAD + k], level, law.up[k], law.down[k], SOFT)
        memory[HEAD + k] = q
        switched += law.weight[k] * q
    mixed = 1.0 - np.exp(-law.rate[0] * abs(switched - before))
    fraction = 0.0
    for k in range(law.weight.size):
        q = memory[HEAD + k]
        q = pushed(q + mixed * (switched - q), level, law.up[k], law.down[k], SOFT)
        memory[HEAD + k] = q
        fraction += law.weight[k] * q
    memory[0] = fraction
    return fraction


def _settle(law, level):
    memory = np.zeros(HEAD + law.weight.size)
    _move(law, memory, level)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level)


implement(Accommodating, settle=_settle, advance=_advance, widen=widen_thresholds)


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film of grain clusters whose states mix by 0.2 to 1 as all of the film switches once."""
    grains = draw_grains(rng, film, misfit, "clusters")
    rate = np.array([np.exp(rng.uniform(np.log(0.2), np.log(1.0)))])

    def law(up: Array, down: Array) -> Accommodating:
        share = grains.weight.reshape(-1, COARSE).sum(axis=1)
        rising, falling = (x.reshape(-1, COARSE).mean(axis=1) for x in (up, down))
        return Accommodating(rising, falling, share / share.sum(), rate)

    return Film(law(grains.up_metal, grains.down_metal), law(grains.up_structure, grains.down_structure))
