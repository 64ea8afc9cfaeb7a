"""The family of what has no name: the part of the device, or the sensor, in which it acts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vo2_models.diagnosis.nonparametric_correction import Shape
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = ["family_of_unnamed"]

TAKES_PART = (0.1, 0.5)
"""Energy of a channel, as a share of what a temperature would make there of the excess of the other, below which the
channel does not take part, as what heats the film shows in both; and the same of a channel in which the correction
finds nothing to describe."""
BY_DEPENDENCE = {
    RESISTANCE: {
        "value": "sensor", "time": "sensor", "tone": "sensor", "lagged drive": "sensor", "rate": "sensor",
        "current": "film", "temperature": "film", "branch": "film", "time and temperature": "film",
        "travel": "film", "reversals": "transition", "felt temperature": "film", "felt tone": "film",
    },
    TIP_DEFLECTION: {
        "value": "sensor", "time": "sensor", "tone": "sensor", "current": "structure", "temperature": "structure",
        "branch": "structure", "lagged drive": "structure", "rate": "structure", "time and temperature": "structure",
        "travel": "structure", "reversals": "transition", "felt temperature": "structure", "felt tone": "structure",
    },
    "": {
        "reversals": "transition", "branch": "transition", "travel": "transition", "temperature": "heat",
        "time and temperature": "heat", "felt temperature": "heat", "felt tone": "heat", "lagged drive": "heat",
        "rate": "heat", "time": "heat", "tone": "heat", "current": "drive", "value": "transition",
    },
}  # fmt: skip
"""Channel that alone takes part (empty for both) -> what the correction depends on -> family."""

OF_ONE_LOOP = {
    "value": "sensor", "time": "sensor", "tone": "sensor", "time and value": "sensor", "lagged drive": "sensor",
    "rate": "sensor", "current": "drive", "temperature": "transition", "branch": "transition",
    "time and temperature": "transition", "travel": "transition", "reversals": "transition",
    "felt temperature": "transition", "felt tone": "transition",
}  # fmt: skip
"""The same of a device of which nothing but a loop is known between its drive and a single response: what depends on the
place in the loop is the loop's, what follows late or on the value itself is the sensor's. There is no structure behind the
loop, and no film apart from it, that could be told."""


def family_of_unnamed(
    problem: LinearisedProblem, excess: Mapping[str, float], shapes: Sequence[Shape]
) -> str:
    """Return the family of what has no name, by the channels in which it shows and by what the correction depends on.

    Something upstream of the film changes a temperature, and a temperature shows in resistance and deflection by their
    sensitivities to it. Where one of the two has next to nothing of what the other's excess would make of it, only that
    other takes part. A device with one response and nothing between it and the drive but a loop has families of its own,
    see `OF_ONE_LOOP`.

    Parameters
    ----------
    problem : without effects
    excess : channel -> excess power over noise power
    shapes : groups of functions that the correction uses, most important first
    """
    loudest = max(excess, key=lambda channel: excess[channel])
    if loudest == HEATER_CURRENT:
        return "drive"
    if loudest == STAGE_TEMPERATURE:
        return "heat"
    alone = _alone(problem, excess, {s.channel for s in shapes})
    by_dependence = OF_ONE_LOOP if problem.nominal.model.description.is_one_loop else BY_DEPENDENCE[alone]
    depends = next((s.group for s in shapes if not alone or s.channel == alone), "")
    if not depends:
        depends = "temperature" if alone else "felt temperature"
    family = by_dependence[depends]
    return f"sensor:{alone}" if family == "sensor" else family


def _alone(problem: LinearisedProblem, excess: Mapping[str, float], described: set[str]) -> str:
    """The one of resistance and deflection that alone takes part; empty for both."""
    both = [c for c in (RESISTANCE, TIP_DEFLECTION) if c in excess]
    if len(both) < 2:
        return both[0]
    place = problem.column_of("thermal.ambient")
    if place is None:
        return ""
    per_kelvin = problem.nuisance.thermal[:, place]
    felt = {c: float(np.sum(per_kelvin[problem.rows_of(c)] ** 2)) for c in both}
    for channel, other in (both, both[::-1]):
        expected = max(excess[channel], 0.0) * felt[other] / max(felt[channel], 1e-300)
        least = TAKES_PART[0] if other in described or not described else TAKES_PART[1]
        if max(excess[other], 0.0) < least * expected:
            return channel
    return ""
