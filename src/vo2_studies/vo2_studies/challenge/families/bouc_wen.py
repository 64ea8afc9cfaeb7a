"""Bouc and Wen's law as the backlash of the transition: the film lags behind the temperature by a width that builds up.

    fraction = sum_k share_k / (1 + exp(-(T - w_k z_k / 2 - T_k) / a_k)),
    dz/dT = rho (1 - |z|^n (sigma sgn(z dT) + 1 - sigma))

Wen, J. Eng. Mech. Div. ASCE 102, 249, 1976, normalised as Ismail, Ikhouane and Rodellar, Arch. Comput. Methods Eng. 16,
161, 2009. z is all that is remembered; small loops neither close nor are they congruent. The film's fraction rises with
the temperature where w rho sigma is below 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.law import Film, Statistics, draw_both, implement, logistic_volumes

__all__ = ["BoucWen", "draw"]

Array = NDArray[np.floating]
VOLUMES = 3
STRIDE = 0.05
"""Longest step of the temperature in the integration [K]."""
HEAD = 2
"""Memory: fraction, last temperature; then z of each volume."""


class BoucWen(NamedTuple):
    """Of each volume (k,): T_k [degC], w [K], a [K], rho [1/K], sigma [1], n [1], share [1]."""

    middle: Array
    width: Array
    scale: Array
    rate: Array
    sigma: Array
    power: Array
    weight: Array


@kernel
def _move(law, memory, level):
    moved = level - memory[1]
    count = max(1, int(np.ceil(abs(moved) / STRIDE)))
    stride = moved / count
    fraction = 0.0
    for k in range(law.weight.size):
        z = memory[HEAD + k]
        if moved != 0.0:
            for _ in range(count):
                half = z
                for part in (0.5, 1.0):  # midpoint
                    side = law.sigma[k] if half * moved > 0 else -law.sigma[k]
                    slope = 1 - abs(half) ** law.power[k] * (side + 1 - law.sigma[k])
                    half = min(max(z + part * stride * law.rate[k] * slope, -1.0), 1.0)
                z = half
        memory[HEAD + k] = z
        lagging = level - 0.5 * law.width[k] * z - law.middle[k]
        fraction += law.weight[k] * 0.5 * (1 + np.tanh(0.5 * lagging / law.scale[k]))
    memory[0], memory[1] = fraction, level
    return fraction


def _settle(law, level):
    memory = np.zeros(HEAD + law.weight.size)
    memory[1] = level
    memory[HEAD:] = 1.0  # after a long rise
    _move(law, memory, level)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level)


def _widen(law: BoucWen, width: float) -> BoucWen:
    wider = np.maximum(law.width + width, 0.1)
    return law._replace(width=wider, rate=law.rate * law.width / wider)


implement(BoucWen, settle=_settle, advance=_advance, widen=_widen)


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film of few volumes whose loops scatter by `misfit` besides the material's spread."""

    def law(mean: float, spread: float) -> BoucWen:
        share, up, width, scale = logistic_volumes(rng, film, misfit, mean, spread, count=VOLUMES)
        sigma = rng.uniform(0.5, 0.9, VOLUMES)
        rate = rng.uniform(0.6, 0.95, VOLUMES) / (width * sigma)
        power = rng.uniform(1.0, 2.0, VOLUMES)
        return BoucWen(up - width / 2, width, scale, rate, sigma, power, share)

    return draw_both(rng, film, law)
