"""Neighbouring grains that pull each other over: a film on a square lattice switches in avalanches.

    q_k = 1 where T + J (m_k - 1/2) has passed the heating threshold of grain k, 0 where it has passed the cooling one,
    m_k = mean of q over the four neighbours of k

The random-field Ising model at zero temperature with grains of a width of their own: Sethna et al., Phys. Rev. Lett. 70,
3347, 1993. What a grain sees is its neighbourhood, not the whole film: small loops close, are not congruent, and depend
on where the film has switched.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.law import (
    Film,
    Statistics,
    draw_both,
    implement,
    pushed,
    widen_thresholds,
    widened,
)

__all__ = ["Avalanches", "draw"]

Array = NDArray[np.floating]
SIDE = 32
"""Grains along each side of the lattice, whose ends meet."""
SOFT = 0.15
"""Half the interval of temperature within which a grain switches [K]."""
SWEEPS = 200
"""Largest number of sweeps over the lattice until it rests."""
REST = 1e-7
"""Change of the fraction by a sweep from which it rests [1]."""
HEAD = 1
"""Memory: fraction; then q of each grain."""


class Avalanches(NamedTuple):
    """Of each grain (k,), row by row: thresholds [degC]; J (1,) [K]."""

    up: Array
    down: Array
    coupling: Array


@kernel
def _move(law, memory, level):
    count = SIDE * SIDE
    for _ in range(SWEEPS):
        changed, total = 0.0, 0.0
        for k in range(count):
            row, column = k // SIDE, k % SIDE
            above, below = (row - 1) % SIDE * SIDE + column, (row + 1) % SIDE * SIDE + column
            left, right = row * SIDE + (column - 1) % SIDE, row * SIDE + (column + 1) % SIDE
            near = memory[HEAD + above] + memory[HEAD + below] + memory[HEAD + left] + memory[HEAD + right]
            seen = level + law.coupling[0] * (0.25 * near - 0.5)
            q = pushed(memory[HEAD + k], seen, law.up[k], law.down[k], SOFT)
            changed += abs(q - memory[HEAD + k])
            memory[HEAD + k] = q
            total += q
        memory[0] = total / count
        if changed < REST * count:
            break
    return memory[0]


def _settle(law, level):
    memory = np.zeros(HEAD + law.up.size)
    _move(law, memory, level)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level)


implement(Avalanches, settle=_settle, advance=_advance, widen=widen_thresholds)


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film whose grains help their neighbours over by 2 to 6 K; `misfit` scatters the widths besides."""
    count = SIDE * SIDE
    coupling = np.array([np.exp(rng.uniform(np.log(2.0), np.log(6.0)))])

    def law(mean: float, spread: float) -> Avalanches:
        up = mean + spread * np.clip(rng.standard_normal(count), -3.0, 3.0)
        width = film.width_mean * (1 + misfit * rng.standard_normal(count))
        width += film.width_sd * np.clip(rng.standard_normal(count), -2.5, 2.5)
        down = up - np.maximum(width, 0.6)
        # what the neighbours add along the major loop is taken off beforehand
        up, down = (x + coupling[0] * (np.argsort(np.argsort(x)) / (count - 1) - 0.5) for x in (up, down))
        return Avalanches(*widened(up, down, 0.0), coupling)

    return draw_both(rng, film, law)
