"""Limiting-loop proximity: minor loops drawn from the major loop by one analytic formula, no domains at all.

De Almeida, Deep, Lima, Neff and Freire, IEEE Trans. Instrum. Meas. 50, 1030, 2001, and Opt. Eng. 41, 2582, 2002, made
for VO2: with g the semiconducting fraction, d = +-1 the direction of the temperature, and the last reversal at
(T_r, g_r),

    g = 1/2 + 1/2 tanh(b (d w/2 + T_c - (T + T_p P((T - T_r) / T_p))))
    T_p = d w/2 + T_c - atanh(2 g_r - 1) / b - T_r,    P(x) = 1/2 (1 - sin(c x)) (1 + tanh(pi^2 - 2 pi x)).

Only the last reversal is remembered: no wiping out, no congruence. The film is a sum of few such volumes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.law import Film, Statistics, draw_both, implement

__all__ = ["Proximity", "draw"]

Array = NDArray[np.floating]
VOLUMES = 3
STILL = 1e-9
"""A temperature that moves less than this [K] in a step rests."""
SATURATED = 1e-6
"""A fraction this near to 0 or 1 is on both limiting loops."""
HEAD = 3
"""Memory: transformed fraction, last temperature, direction; then of each volume reversal temperature and its g."""


class Proximity(NamedTuple):
    """Of each volume (k,): middle [degC], loop width [K], steepness [1/K], shape c [1], share [1]."""

    middle: Array
    width: Array
    steepness: Array
    shape: Array
    weight: Array


@kernel
def _volume(law, k, level, direction, reversal, at_reversal):
    """Return g of volume `k`."""
    side = direction * law.width[k] / 2 + law.middle[k]
    shifted, distance = level, 0.0
    if SATURATED < at_reversal < 1 - SATURATED:
        distance = side - np.arctanh(2 * at_reversal - 1) / law.steepness[k] - reversal
    if distance * direction > 1e-9:
        x = (level - reversal) / distance
        nearness = 0.5 * (1 - np.sin(law.shape[k] * x)) * (1 + np.tanh(np.pi**2 - 2 * np.pi * x))
        shifted += distance * nearness
    return 0.5 + 0.5 * np.tanh(law.steepness[k] * (side - shifted))


@kernel
def _move(law, memory, level):
    moved = level - memory[1]
    if abs(moved) < STILL:
        return memory[0]
    count = law.weight.size
    direction = 1.0 if moved > 0 else -1.0
    if direction != memory[2]:
        for k in range(count):
            at = HEAD + 2 * k
            memory[at + 1] = _volume(law, k, memory[1], memory[2], memory[at], memory[at + 1])
            memory[at] = memory[1]
        memory[2] = direction
    semiconducting = 0.0
    for k in range(count):
        at = HEAD + 2 * k
        semiconducting += law.weight[k] * _volume(law, k, level, direction, memory[at], memory[at + 1])
    memory[0], memory[1] = 1 - semiconducting, level
    return memory[0]


def _settle(law, level):
    memory = np.zeros(HEAD + 2 * law.weight.size)
    memory[1], memory[2] = level - 1.0, 1.0
    for k in range(law.weight.size):
        # a point of the limiting loop as the last reversal: nothing to be near to
        memory[HEAD + 2 * k], memory[HEAD + 2 * k + 1] = law.middle[k] + law.width[k] / 2, 0.5
    _move(law, memory, level)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level)


def _widen(law: Proximity, width: float) -> Proximity:
    return law._replace(width=np.maximum(law.width + width, 0.1))


implement(Proximity, settle=_settle, advance=_advance, widen=_widen)


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film of few volumes whose loops scatter by `misfit` besides the material's spread."""

    def law(mean: float, spread: float) -> Proximity:
        places = np.clip(rng.standard_normal(VOLUMES), -1.5, 1.5)
        between = 0.35 * film.heating_sd * places
        width = film.width_mean + 0.5 * film.width_sd * rng.permutation(places)
        width = np.maximum(width * (1 + misfit * rng.standard_normal(VOLUMES)), 1.0)
        weight = rng.dirichlet(np.full(VOLUMES, 6.0))
        heating = mean + between - np.sum(weight * between)
        # tanh(b x) is a logistic distribution of standard deviation pi / (2 sqrt(3) b); the volumes' means add theirs
        inner = np.sqrt(max(spread**2 - np.sum(weight * (heating - mean) ** 2), 0.3 * spread**2))
        scatter = np.clip(1 + misfit * rng.standard_normal(VOLUMES), 0.5, 1.5)
        steepness = np.pi / (2 * np.sqrt(3) * inner) * scatter
        shape = rng.uniform(0.7, 1.1, VOLUMES)  # 0.956 in the paper
        return Proximity(heating - width / 2, width, steepness, shape, weight)

    return draw_both(rng, film, law)
