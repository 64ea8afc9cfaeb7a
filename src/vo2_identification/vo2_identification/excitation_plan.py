"""What the identifier plays: the current of every sample, from a few parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_models.excitation import Excitation, damped_oscillation, random_levels
from vo2_models.parameters import Parameter
from vo2_plant_sim.interface.model import operating_point
from vo2_plant_sim.interface.parameters import ParameterTable

__all__ = ["EXCITATION_KINDS", "EXCITATION_PARAMETERS", "excitation_currents"]

EXCITATION_KINDS = ("damped_oscillation", "random_levels", "levels", "listen")

EXCITATION_PARAMETERS = (
    Parameter(
        "excitation.kind",
        "damped_oscillation",
        "",
        "What is played; listen plays nothing and takes what another commander or a replayed bag brings.",
        choices=EXCITATION_KINDS,
    ),
    Parameter(
        "excitation.level", 30, "1", "Cells of the damped oscillation, between level + 1 walls.", 2, 400
    ),
    Parameter("excitation.count", 400, "1", "Number of random levels.", 1, 1_000_000),
    Parameter("excitation.seed", 1, "1", "Seed of the random levels.", 0),
    Parameter("excitation.levels_a", [], "A", "Levels for kind levels.", -10.0, 10.0, kind="float_array"),
    Parameter(
        "excitation.hold_s", 0.0, "s", "Time at each level; 0 for quasi-static on the preset.", 0.0, 1e5
    ),
    Parameter(
        "excitation.rate_a_per_s",
        0.0,
        "A/s",
        "Levels are approached at this rate; 0 for steps.",
        0.0,
        1e6,
    ),
    Parameter(
        "excitation.cold_s", 0.03, "s", "Time at the coldest operating current before and after.", 0.0, 1e5
    ),
)


def excitation_currents(preset: str, sample_period_s: float, table: ParameterTable) -> NDArray[np.float64]:
    """Return the current [A] of every sample (n,); empty for kind `listen`.

    Raises
    ------
    ValueError : no levels for kind `levels`.
    """
    point = operating_point(preset)
    kind = table.text("excitation.kind")
    hold = table.number("excitation.hold_s") or point.settle_s
    rate = table.number("excitation.rate_a_per_s")
    if kind == "listen":
        return np.empty(0)
    if kind == "damped_oscillation":
        # even steps of current from the coldest to the hottest wall; negative currents heat on a Peltier stage
        share = damped_oscillation(np.linspace(0.0, 1.0, int(table.number("excitation.level")) + 1))
        levels = point.cold_a + (point.hot_a - point.cold_a) * share
    elif kind == "random_levels":
        count, seed = int(table.number("excitation.count")), int(table.number("excitation.seed"))
        levels = random_levels(point.lower_a, point.upper_a, count, seed=seed)
    else:
        levels = np.array(table.numbers("excitation.levels_a"))
        if levels.size == 0:
            raise ValueError("excitation.levels_a: found none, need at least one level for kind levels")
    play = (
        Excitation.at_rate(levels, rate_per_s=rate, hold_s=hold)
        if rate
        else Excitation(levels, np.zeros(levels.size), np.full(levels.size, hold))
    )
    cold = np.full(max(1, round(table.number("excitation.cold_s") / sample_period_s)), point.cold_a)
    return np.concatenate([cold, play.sample(sample_period_s), cold])
