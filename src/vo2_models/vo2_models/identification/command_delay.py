"""When a rig's commands act: at the sample whose stamp they carry, one interval off, or late by a constant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, Recording, aligned

__all__ = ["command_delay"]

_EARLIEST, _LATEST = -3, 20
"""Delays that are looked for, in sample periods."""
_BETTER = 0.5
"""A delay is believed where it leaves at most this share of the squared difference that none leaves."""
_STEADY = 1e-6
"""Share of its mean square that a command must vary by, to tell when it acts."""


def command_delay(recordings: Sequence[Recording]) -> float:
    """Return the delay [s] that makes the commands what the rig's own log of its drive shows; 0 without commands or log.

    It minimises the squared difference between logged drive and `aligned` command: on whole sample periods first, then
    between them. What the driver itself does (a slew limit, a lag) is smaller than the square of a whole interval's shift
    and does not pass for a delay.

    Parameters
    ----------
    recordings : in roles, of one rig
    """
    usable = [r for r in recordings if COMMANDED_CURRENT in r and HEATER_CURRENT in r and len(r) > 1]
    if not usable:
        return 0.0
    period = float(np.median([recording.sample_period_s for recording in usable]))
    commands = np.concatenate([recording[COMMANDED_CURRENT] for recording in usable])
    commands = commands[np.isfinite(commands)]
    if not commands.size or np.var(commands) <= _STEADY * np.mean(commands**2):
        return 0.0

    def difference(delay: float) -> float:
        total, count = 0.0, 0
        for recording in usable:
            gap = recording[HEATER_CURRENT] - aligned(recording, delay)[COMMANDED_CURRENT]
            gap = gap[np.isfinite(gap)]
            total, count = total + float(gap @ gap), count + gap.size
        return total / max(count, 1)

    whole = {k: difference(k * period) for k in range(_EARLIEST, _LATEST + 1)}
    best = min(whole, key=lambda k: whole[k])
    found = minimize_scalar(
        lambda k: difference(k * period),
        bounds=(best - 1, best + 1),
        method="bounded",
        options={"xatol": 1e-3},
    )
    place, least = (
        (float(found.x), float(found.fun)) if found.fun < whole[best] else (float(best), whole[best])
    )
    return round(place, 3) * period if least < _BETTER * whole[0] else 0.0
