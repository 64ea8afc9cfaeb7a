"""What the identifier plays: the current of every sample, from a few parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_interface.model import operating_point
from vo2_interface.parameters import ParameterTable
from vo2_models.device.description import preset
from vo2_models.device.surrogate import surrogate_of_temperature
from vo2_models.identification.excitation import (
    Excitation,
    composite_recording,
    damped_oscillation,
    random_levels,
)
from vo2_models.parameters import Parameter

__all__ = [
    "EXCITATION_KINDS",
    "EXCITATION_PARAMETERS",
    "INFORMATIVE_SAMPLES",
    "excitation_currents",
    "informative_excitation",
]

EXCITATION_KINDS = ("damped_oscillation", "random_levels", "levels", "informative", "listen")

EXCITATION_PARAMETERS = (
    Parameter(
        "excitation.kind",
        "damped_oscillation",
        "",
        "What is played; informative is for a diagnosis: loops, steps, chirps, random levels and holds; listen plays "
        "nothing and takes what another commander or a replayed bag brings.",
        choices=EXCITATION_KINDS,
    ),
    Parameter(
        "excitation.level", 30, "1", "Cells of the damped oscillation, between level + 1 walls.", 2, 400
    ),
    Parameter("excitation.count", 400, "1", "Number of random levels.", 1, 1_000_000),
    Parameter("excitation.seed", 1, "1", "Seed of the random levels.", 0),
    Parameter(
        "excitation.duration_s",
        0.0,
        "s",
        "Length of kind informative; 0 for 10 000 samples with what is cold before and after.",
        0.0,
        1e6,
    ),
    Parameter("excitation.levels_a", [], "A", "Levels for kind levels.", -1e6, 1e6, kind="float_array"),
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

INFORMATIVE_SAMPLES = 10_000
_SPREADS = 2.0
"""Standard deviations from the mean at which the transition counts as begun and ended."""


def informative_excitation(
    preset_id: str, duration_s: float, sample_period_s: float, *, seed: int
) -> Excitation:
    """Return a recording on which every known effect leaves a mark, across the transition of a preset [A].

    Parameters
    ----------
    preset_id : preset, or path of a device file
    duration_s : about how long [s]
    sample_period_s : [s]
    seed : of the random levels
    """
    device, point = preset(preset_id), operating_point(preset_id)
    (mean, spread), (width, _) = device.heating, device.width
    transition = surrogate_of_temperature(
        preset_id, np.array([mean - width - _SPREADS * spread, mean + _SPREADS * spread])
    )
    return composite_recording(
        point.cold_a,
        point.hot_a,
        transition=(float(transition[0]), float(transition[1])),
        duration_s=duration_s,
        sample_period_s=sample_period_s,
        seed=seed,
    )


def excitation_currents(preset_id: str, sample_period_s: float, table: ParameterTable) -> NDArray[np.float64]:
    """Return the current [A] of every sample (n,); empty for kind `listen`.

    Parameters
    ----------
    preset_id : preset, or path of a device file
    sample_period_s : [s]
    table : parameters of the node

    Raises
    ------
    ValueError : no levels for kind `levels`, fewer than 500 samples for kind `informative`.
    """
    point = operating_point(preset_id)
    kind = table.text("excitation.kind")
    hold = table.number("excitation.hold_s") or point.settle_s
    rate = table.number("excitation.rate_a_per_s")
    if kind == "listen":
        return np.empty(0)
    cold = np.full(max(1, round(table.number("excitation.cold_s") / sample_period_s)), point.cold_a)
    if kind == "damped_oscillation":
        # even steps of current from the coldest to the hottest wall; negative currents heat on a Peltier stage
        share = damped_oscillation(np.linspace(0.0, 1.0, int(table.number("excitation.level")) + 1))
        levels = point.cold_a + (point.hot_a - point.cold_a) * share
    elif kind == "informative":
        # the sample before the first current is recorded too
        left = INFORMATIVE_SAMPLES - 1 - 2 * cold.size
        duration = table.number("excitation.duration_s") or left * sample_period_s
        seed = int(table.number("excitation.seed"))
        play = informative_excitation(preset_id, duration, sample_period_s, seed=seed)
        currents = play.sample(sample_period_s)
        if not table.number("excitation.duration_s"):
            # its segments last whole samples: it may be a few samples longer or shorter than asked for
            currents = np.concatenate([currents, np.full(left, point.cold_a)])[:left]
        return np.concatenate([cold, currents, cold])
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
    return np.concatenate([cold, play.sample(sample_period_s), cold])
