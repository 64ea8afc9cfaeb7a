"""A recording on a regular time grid, as a simulation can follow it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
    clock_of,
    in_order,
    regular,
)

__all__ = ["GriddedRecording", "held", "on_grid"]

Floats = NDArray[np.float64]
LONGEST_GAP = 1_000_000
"""Most samples that a recording may have once its gaps are filled."""


@dataclass(frozen=True)
class GriddedRecording:
    """Regular samples.

    Attributes
    ----------
    dt : sample period [s]
    start : stamp of the first sample [s]
    current : (n,) what drives the simulation [A]: the commanded current, or the logged one where there are no commands
    commanded : whether `current` is the commanded one, so that the driver's own effects can be seen
    measured : channel -> (n,) values, NaN where missing; `film_resistance` as y = -log10(R / ohm)
    """

    dt: float
    start: float
    current: Floats = field(repr=False)
    commanded: bool
    measured: dict[str, Floats] = field(repr=False)


def on_grid(recording: Recording) -> GriddedRecording:
    """Place the samples on a regular grid; where samples are missing the current is held and the rest is NaN.

    Parameters
    ----------
    recording : with any stamps

    Returns
    -------
    GriddedRecording : with one period

    Raises
    ------
    ValueError : fewer than 16 samples, no current, or gaps that would need too long a grid.
    """
    if len(recording) < 16:
        raise ValueError(f"recording: found {len(recording)} samples, need at least 16")
    if HEATER_CURRENT not in recording and COMMANDED_CURRENT not in recording:
        raise ValueError(
            f"recording: found channels {', '.join(recording.channels) or 'none'} of this device, need {HEATER_CURRENT}"
        )
    dt = recording.sample_period_s
    count = int((recording.time_s[-1] - recording.time_s[0]) / dt) + 1
    if count > max(LONGEST_GAP, 4 * len(recording)):
        raise ValueError(
            f"recording: found {count} sample periods of {dt:g} s for {len(recording)} samples, need fewer gaps; "
            "give the parts as recordings of their own"
        )
    known = recording.with_unread()
    recording = regular(known) if clock_of(known) else in_order(known)[0]
    commanded = COMMANDED_CURRENT in recording and bool(np.any(np.isfinite(recording[COMMANDED_CURRENT])))
    drive = recording[COMMANDED_CURRENT if commanded else HEATER_CURRENT]
    if commanded and HEATER_CURRENT in recording:
        # before the first command (NaN) only the log says what flowed
        drive = np.where(np.isfinite(drive), drive, recording[HEATER_CURRENT])
    measured = {}
    for name in (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE):
        if name in recording and np.any(np.isfinite(recording[name])):
            values = recording[name]
            if name == RESISTANCE:
                positive = np.where(values > 0.0, values, np.nan)
                values = -np.log10(positive)
            measured[name] = values
    return GriddedRecording(
        dt=recording.sample_period_s,
        start=float(recording.time_s[0]),
        current=held(drive),
        commanded=commanded,
        measured=measured,
    )


def held(values: Floats) -> Floats:
    """Return values (n,) with missing ones filled by the last one before, at the start by the next one.

    Raises
    ------
    ValueError : no value is there.
    """
    known = np.flatnonzero(np.isfinite(values))
    if known.size == 0:
        raise ValueError("heater_current: found no finite sample, need the current that drives the device")
    last = np.searchsorted(known, np.arange(values.size), side="right") - 1
    return values[known[np.maximum(last, 0)]]
