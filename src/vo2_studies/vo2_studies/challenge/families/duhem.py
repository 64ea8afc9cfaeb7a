"""Duhem and Madelung's rule: each branch transforms a share of what is left, whatever the way there.

    heating  ds/dT = (1 - s) f_+ / (1 - F_+),        cooling  ds/dT = s f_- / F_-

with F_+, F_- (densities f_+, f_-) the logistic distributions of the transition's temperature on heating and on cooling.
Likhachev and Koval, Scripta Metall. Mater. 27, 223, 1992, use it for shape memory alloys; Duhem's class: Visintin,
Differential Models of Hysteresis, 1994, section V. Along one branch it integrates to

    (1 - s) / (1 - s_0) = (1 - F_+(T)) / (1 - F_+(T_0)),        s / s_0 = F_-(T) / F_-(T_0).

The fraction is all that is remembered: no wiping out, no congruence, and small loops wander towards a steady one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.law import Film, Statistics, draw_both, implement, logistic_volumes

__all__ = ["Duhem", "draw"]

Array = NDArray[np.floating]
VOLUMES = 3
HEAD = 2
"""Memory: fraction, last temperature; then the fraction of each volume."""


class Duhem(NamedTuple):
    """Of each volume (k,): mean on heating and on cooling [degC], scale of both distributions [K], share [1].

    One scale for both: with two the branches would cross far out in their tails.
    """

    up: Array
    down: Array
    scale: Array
    weight: Array


@kernel
def _softplus(x):
    """Return log(1 + exp(x)): minus the logarithm of what a logistic distribution leaves above x."""
    return max(x, 0.0) + np.log1p(np.exp(-abs(x)))


@kernel
def _move(law, memory, level):
    before = memory[1]
    total = 0.0
    for k in range(law.weight.size):
        s = memory[HEAD + k]
        if level > before:
            mean, scale = law.up[k], law.scale[k]
            s = 1.0 - (1.0 - s) * np.exp(
                _softplus((before - mean) / scale) - _softplus((level - mean) / scale)
            )
        elif level < before:
            mean, scale = law.down[k], law.scale[k]
            s *= np.exp(_softplus((mean - before) / scale) - _softplus((mean - level) / scale))
        memory[HEAD + k] = s
        total += law.weight[k] * s
    memory[0], memory[1] = total, level
    return total


def _settle(law, level):
    memory = np.zeros(HEAD + law.weight.size)
    memory[1] = level - 1000.0
    _move(law, memory, level)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level)


def _widen(law: Duhem, width: float) -> Duhem:
    most = np.maximum((law.up - law.down) + width, 0.1) - (law.up - law.down)
    return law._replace(up=law.up + most / 2, down=law.down - most / 2)


implement(Duhem, settle=_settle, advance=_advance, widen=_widen)


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film of few volumes whose distributions scatter by `misfit` besides the material's spread."""

    def law(mean: float, spread: float) -> Duhem:
        share, up, width, scale = logistic_volumes(rng, film, misfit, mean, spread, count=VOLUMES)
        return Duhem(up, up - width, scale, share)

    return draw_both(rng, film, law)
