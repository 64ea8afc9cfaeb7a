"""Recordings against the simulation and each other, before physics is looked for: what only a mistake can make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.check import Unusable
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nominal import Nominal, Response, loop_ends
from vo2_models.diagnosis.part import Part
from vo2_models.recording import RESISTANCE

__all__ = ["check_consistency", "runs_against"]

Floats = NDArray[np.float64]


def check_consistency(
    started: Sequence[tuple[Part, Response]], nominal: Nominal, calibrations: int, limits: Limits
) -> None:
    """Raise where recordings contradict the model or each other as physics does not.

    Parameters
    ----------
    started : recordings with their nominal responses
    nominal : fitted simulation
    calibrations : so many of them, the first ones, are those that the model was fitted to
    limits : of what physics does

    Raises
    ------
    Unusable : one recording twice, a sign reversed, two films, a calibration that is of another model; one line.
    """
    for (one, _), (other, _) in combinations(started, 2):
        if _same(one, other):
            raise Unusable(f"{other.name}: is {one.name} once more; need each recording once")
    for part, response in started:
        pairs = {
            c: (part.observed[c][part.valid[c]], response.channels[c][part.valid[c]]) for c in part.channels
        }
        if told := runs_against(pairs, limits):
            raise Unusable(f"{part.name}: {told}")
    _check_films(started, nominal, limits)
    for part, response in started[:calibrations]:
        if told := _foreign(part, response, nominal, limits):
            raise Unusable(f"{part.name}: {told}")


def _same(one: Part, other: Part) -> bool:
    """Whether two recordings hold the same values, noise and all."""
    return one.channels == other.channels and all(
        np.array_equal(one.observed[c], other.observed[c]) for c in one.channels
    )


def runs_against(pairs: Mapping[str, tuple[Floats, Floats]], limits: Limits) -> str:
    """Return what says that a sign is the other way round; empty for nothing.

    Parameters
    ----------
    pairs : channel -> what was seen and what was expected (n,), in judged units
    limits : of what runs the other way
    """
    against = []
    for channel, (seen, expected) in pairs.items():
        if seen.size and np.ptp(seen) > 0.0 and np.ptp(expected) > 0.0:
            against.append((channel, float(np.corrcoef(seen, expected)[0, 1])))
    upside = [channel for channel, cosine in against if cosine < limits.reverse]
    if not upside:
        return ""
    if len(upside) == len(against) > 1:
        return (
            f"{' and '.join(upside)} run against the simulation: is the sign of heater_current reversed, or are the two "
            "channels swapped?"
        )
    return (
        f"{' and '.join(upside)} runs against the simulation: is its sign reversed, is it another column, "
        "or late by half a cycle?"
    )


def _check_films(started: Sequence[tuple[Part, Response]], nominal: Nominal, limits: Limits) -> None:
    """Raise where resistances on both sides of the loops are those of two films: a bad contact changes one side alone."""
    low, high = loop_ends(nominal.model)
    levels = []
    for part, response in started:
        if RESISTANCE not in part.channels:
            continue
        sides = [
            outside & part.valid[RESISTANCE]
            for outside in (response.temperature < low, response.temperature > high)
        ]
        if all(np.count_nonzero(side) >= limits.other_film_samples for side in sides):
            gap = part.observed[RESISTANCE] - response.channels[RESISTANCE]
            levels.append((part.name, [float(np.median(gap[side])) for side in sides]))
    for (first, one), (second, other) in combinations(levels, 2):
        apart = np.subtract(other, one)
        if np.min(np.abs(apart)) > np.log10(limits.other_film) and apart[0] * apart[1] > 0.0:
            factor = 10 ** float(np.mean(apart))
            raise Unusable(
                f"{second}: film_resistance is {factor:.3g} times that of {first} at the same temperatures, low and high: "
                "they are of different devices; give recordings of one"
            )


def _foreign(part: Part, response: Response, nominal: Nominal, limits: Limits) -> str:
    """What says that the model was not fitted to this recording; empty for nothing."""
    for channel, sensor in nominal.model.sensors.items():
        if channel not in part.channels or not sensor.residual:
            continue
        gap = (part.observed[channel] - response.channels[channel])[part.valid[channel]]
        # without the largest, so that neither outliers nor a wrong start count; of a normal one it is the deviation
        left = float(np.quantile(np.abs(gap), 0.9)) / 1.645
        if left > limits.foreign * sensor.residual:
            return (
                f"is {left / sensor.residual:.3g} times as far from the model in {channel} as the fit left its calibration: "
                "the model was fitted to another recording; give that one, or fit again"
            )
    return ""
