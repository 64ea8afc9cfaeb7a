"""Laws over the drive itself, for a quasi-static recording of a device that no preset describes.

Where neither temperature scale nor thermal dynamics are known, each measured channel is a play model over
the drive: -log10 of the resistance, and the deflection. They are kept in the sections of the model file that
otherwise hold the laws over the temperature; `model.device` stays empty, so that no simulation takes them
for a device.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording

__all__ = ["HOLD_OUT", "HoldOut", "fit_drive", "held_out"]

HoldOut = Literal["none", "end", "blocks"]
HOLD_OUT: tuple[HoldOut, ...] = ("none", "end", "blocks")
_BLOCK = 10


def held_out(drive: NDArray[np.float64], how: HoldOut) -> NDArray[np.bool_]:
    """Return which samples (n,) a fit must not see.

    `end`: the second half. `blocks`: every third block of ten samples, for a recording of a single loop, but
    no turning point: leaving samples out between reversals does not change what a rate-independent
    model remembers.

    Parameters
    ----------
    drive : (n,) [unit of the drive]
    how : which part of it
    """
    index = np.arange(drive.size)
    if how == "end":
        return np.asarray(index >= drive.size // 2)
    if how == "none":
        return np.zeros(drive.size, dtype=np.bool_)
    mask = index // _BLOCK % 3 == 1
    steps = np.sign(np.diff(drive))
    turns = np.flatnonzero(steps[1:] * steps[:-1] < 0) + 1
    mask[turns] = False
    return np.asarray(mask)


def fit_drive(
    recording: Recording, drive: str, *, hold_out: HoldOut = "none", plays: int = 6, per_play: bool = False
) -> dict[str, Value]:
    """Fit resistance and deflection, those that are there, over the channel `drive`; return flat `model.*` parameters.

    Parameters
    ----------
    recording : quasi-static, with at least one reversal of the drive
    drive : channel that drives the device, such as `heater_voltage` [V]
    hold_out : samples left out, see `held_out`
    plays : number of plays of each law
    per_play : whether each play has envelopes of its own

    Raises
    ------
    ValueError : the drive is absent or not finite, neither output is there, or the fit's own reasons.
    """
    from vo2_models.hysteresis.fitting_gpi import fit_play_model  # loads slowly, and a node starts without it

    if drive not in recording:
        raise ValueError(f"recording: found {', '.join(recording.channels)}, need the channel {drive}")
    v = recording[drive]
    if not np.all(np.isfinite(v)):
        k = int(np.flatnonzero(~np.isfinite(v))[0])
        raise ValueError(
            f"{drive}: found no number at {recording.time_s[k]:g} s, need the drive at every sample"
        )
    seen = ~held_out(v, hold_out)
    found: dict[str, Value] = {}
    for channel, section in ((RESISTANCE, "model.resistance"), (TIP_DEFLECTION, "model.deflection")):
        if channel not in recording:
            continue
        y = recording[channel]
        if channel == RESISTANCE:
            y = -np.log10(np.where(y > 0, y, np.nan))
        usable = seen & np.isfinite(y)
        fit = fit_play_model(v[usable], y[usable], plays=plays, memoryless="quadratic", per_play=per_play)
        found |= fit.model.to_parameters(section)
    if not found:
        raise ValueError(f"recording: found neither {RESISTANCE} nor {TIP_DEFLECTION}, need one of them")
    return found
