"""Samples that came a little early or late, moved to the regular instants of their acquisition by what a model does meanwhile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import CHANNELS
from vo2_models.device.model import DeviceModel
from vo2_models.identification.grid import held
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    Recording,
    clock_of,
    in_order,
    regular,
)

__all__ = ["read_in_time"]

Floats = NDArray[np.float64]
FINE = 8
"""Steps of a sample at which the model is run; between them its response is taken as straight."""


def read_in_time(recording: Recording, model: DeviceModel) -> Recording:
    """Return a recording as `regular` does, moved by the model's response and not along the recording's own slope.

    A body whose time constant is of a few sample periods bends its response within one, which no slope follows. With s the
    simulated channel, t the instant of a sample and T the regular one, s(t) - s(T) is taken off.

    Parameters
    ----------
    recording : with any stamps
    model : of the device, good enough for the difference
    """
    if clock_of(recording) is None or not model.description.has_body:
        return regular(recording)
    placed, late = in_order(recording.with_unread())
    drive = placed[COMMANDED_CURRENT]
    if HEATER_CURRENT in placed:  # before the first command
        drive = np.where(np.isfinite(drive), drive, placed[HEATER_CURRENT])
    out = model.simulation.run(np.repeat(held(drive), FINE), dt=placed.sample_period_s / FINE)
    steps = np.arange(len(placed), dtype=np.float64)
    fine = (np.arange(len(out)) + 1.0) / FINE - 1.0
    channels = dict(placed.channels)
    for place, channel in enumerate(CHANNELS):
        if channel == HEATER_CURRENT or channel not in placed:
            continue
        course = np.log(out[:, place]) if channel == RESISTANCE else out[:, place]
        moved = np.interp(steps, fine, course) - np.interp(steps + late, fine, course)
        channels[channel] = (
            placed[channel] * np.exp(moved) if channel == RESISTANCE else placed[channel] + moved
        )
    return Recording(placed.time_s, channels, placed.device)
