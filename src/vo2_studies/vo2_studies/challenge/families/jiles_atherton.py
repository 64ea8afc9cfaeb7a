"""Jiles and Atherton's differential law, with a coercivity that grows with the logarithm of the rate.

    dM/dT = (M_an(T_e) - M) / (d k),  not against the direction d of T,    T_e = T + alpha M,  M_an = tanh((T_e - T_c) / a)
    fraction = 1/2 + 1/2 ((1 - c) M + c M_an),    k = k_0 (1 + rho ln(1 + |dT/dt| / r_0))

Jiles and Atherton, J. Magn. Magn. Mater. 61, 48, 1986; thermally activated switching makes the coercivity logarithmic
in the rate: Sharrock, J. Appl. Phys. 76, 6413, 1994. Minor loops do not close at first and creep on cycling.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.families.law import Film, Statistics, draw_both, implement, trace

__all__ = ["JilesAtherton", "draw"]

Array = NDArray[np.floating]
VOLUMES = 3
STRIDE = 0.2
"""Longest step of the temperature in the integration [K]."""
HEAD = 2
"""Memory: fraction, last temperature; then M of each volume."""


class JilesAtherton(NamedTuple):
    """Of each volume (k,): T_c [degC], a [K], k_0 [K], alpha [K], c [1], share [1]; rho [1] and r_0 [K/s] of all."""

    middle: Array
    spread: Array
    coercivity: Array
    coupling: Array
    reversible: Array
    weight: Array
    growth: float
    rate: float


@kernel
def _move(law, memory, level, step):
    moved = level - memory[1]
    pace = 1 + law.growth * np.log(1 + abs(moved) / step / law.rate)
    count = max(1, int(np.ceil(abs(moved) / STRIDE)))
    direction = 1.0 if moved > 0 else -1.0
    stride = abs(moved) / count
    fraction = 0.5
    for k in range(law.weight.size):
        m = memory[HEAD + k]
        width = law.coercivity[k] * pace
        for j in range(count):
            # midpoint of the stride; exact for constant anhysteretic
            field = memory[1] + direction * (j + 0.5) * stride + law.coupling[k] * m
            goal = np.tanh((field - law.middle[k]) / law.spread[k])
            if (goal - m) * direction > 0:
                m = goal + (m - goal) * np.exp(-stride / width)
        memory[HEAD + k] = m
        goal = np.tanh((level + law.coupling[k] * m - law.middle[k]) / law.spread[k])
        fraction += 0.5 * law.weight[k] * ((1 - law.reversible[k]) * m + law.reversible[k] * goal)
    memory[0], memory[1] = fraction, level
    return fraction


def _settle(law, level):
    memory = np.full(HEAD + law.weight.size, -1.0)
    memory[1] = level - 100.0
    _move(law, memory, level, 3600.0)
    return memory


def _advance(law, memory, level, step):
    return _move(law, memory, level, step)


def _widen(law: JilesAtherton, width: float) -> JilesAtherton:
    # the loop opens by some 1.25 of the coercivity, while its anhysteretic curve is about as broad
    return law._replace(coercivity=np.maximum(law.coercivity + 0.8 * width, 0.05))


implement(JilesAtherton, settle=_settle, advance=_advance, widen=_widen)


def _moments(law: JilesAtherton) -> tuple[float, float, float]:
    """Return mean and s.d. of the heating threshold and mean of the cooling threshold [degC, K, degC]."""
    centre = float(np.sum(law.weight * law.middle))
    up = centre + np.linspace(-50.0, 50.0, 2001)
    fraction = trace(law, np.concatenate([up, up[::-1]]), 0.0, 3600.0)
    middles = (up[1:] + up[:-1]) / 2

    def of(branch: Array) -> tuple[float, float]:
        share = np.diff(branch) / np.sum(np.diff(branch))
        mean = float(np.sum(share * middles))
        return mean, float(np.sqrt(np.sum(share * (middles - mean) ** 2)))

    heating, cooling = of(fraction[:2001]), of(fraction[2001:][::-1])
    return (*heating, cooling[0])


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film of few volumes whose parameters scatter by `misfit` besides the material's spread."""
    growth = float(rng.uniform(0.01, 0.04))
    rate = float(np.exp(rng.uniform(np.log(0.2), np.log(3.0)))) / film.time_constant

    def law(mean: float, spread: float) -> JilesAtherton:
        scatter = np.clip(1 + misfit * rng.standard_normal((3, VOLUMES)), 0.5, 1.5)
        places = 0.3 * spread * np.clip(rng.standard_normal(VOLUMES), -1.5, 1.5)
        found = JilesAtherton(
            middle=mean - film.width_mean / 2 + places,
            spread=0.8 * spread * scatter[0],
            coercivity=film.width_mean / 2 * scatter[1],
            coupling=rng.uniform(0.0, 0.15) * spread * scatter[2],
            reversible=rng.uniform(0.02, 0.1, VOLUMES),
            weight=rng.dirichlet(np.full(VOLUMES, 6.0)),
            growth=growth,
            rate=rate,
        )
        for _ in range(12):  # moments of the branches from the parameters: fixed-point iteration
            heating, width_up, cooling = _moments(found)
            found = found._replace(
                middle=found.middle + mean - heating,
                spread=found.spread * np.clip(spread / width_up, 0.6, 1.6),
                coercivity=found.coercivity * np.clip(film.width_mean / (heating - cooling), 0.6, 1.6) ** 0.7,
            )
        return found

    return draw_both(rng, film, law)
