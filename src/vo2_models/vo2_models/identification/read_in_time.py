"""Samples that came a little early or late, moved to the regular instants of their acquisition by what a model does meanwhile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import CHANNELS
from vo2_models.device.model import DeviceModel
from vo2_models.identification.grid import held
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    JITTERED,
    RESISTANCE,
    Recording,
    clock_of,
    in_order,
    jitter_of,
    regular,
    regular_instants,
)

__all__ = ["read_in_time"]

Floats = NDArray[np.float64]
EXACT = 0.05
"""Share of a period about an instant within which a stamp does not tell whether it was before."""
AFTER = 3
"""Samples by which an unknown command is judged."""
USUAL = 0.99
"""Quantile of what the model is off elsewhere, beyond which an unknown command is one that no guess stands for."""
FORGOTTEN = 5.0
"""Time constants of the body after which it has forgotten one."""
FINE = 8
"""Steps of a sample at which the model is run; between them its response is taken as straight."""


def read_in_time(recording: Recording, model: DeviceModel) -> Recording:
    """Return a recording as `regular` does, moved by the model's response and not along the recording's own slope.

    A body whose time constant is of a few sample periods bends its response within one, which no slope follows. With s the
    simulated channel, t the instant of a sample and T the regular one, s(t) - s(T) is taken off.

    Of a drive that is logged only, and held from one instant of the clock to the next, the log may say what flowed up to the
    instant that the sample is nearest to, or what flowed when the sample was read, which of a late one is the next value. What
    the model follows better is taken: one of these, or all channels along straight lines, as of a drive that is not held.

    Parameters
    ----------
    recording : with any stamps
    model : of the device, good enough for the difference
    """
    if not model.description.has_body:
        return regular(recording)
    if clock_of(recording) is not None:
        return _moved(*in_order(recording.with_unread()), model)[0]
    clock = None if COMMANDED_CURRENT in recording else regular_instants(recording.time_s)
    if clock is None or jitter_of(recording.time_s) <= JITTERED or HEATER_CURRENT not in recording:
        return regular(recording)
    drive = recording[HEATER_CURRENT]
    placed, late = in_order(replace(recording, channels={**recording.channels, COMMANDED_CURRENT: drive}))
    at = (recording.time_s - clock[0]) / clock[1]
    interval = np.ceil(at - EXACT).astype(int)
    surely = np.abs(at - np.rint(at)) > EXACT
    flowing = np.full(len(placed) + 1, np.nan)
    flowing[interval[~surely]] = drive[~surely]
    flowing[interval[surely]] = drive[surely]
    flowed = replace(placed, channels={**placed.channels, COMMANDED_CURRENT: flowing[:-1]})
    flowed = _completed(flowed, late, model)
    even = regular(recording)
    found = [
        _moved(placed, late, model),
        _moved(flowed, late, model),
        _moved(even, np.zeros(len(even)), model),
    ]
    read, _ = min(found, key=lambda one: float(np.sum(one[1]) / max(int(np.count_nonzero(one[1])), 1)))
    channels = dict(read.channels)
    channels[HEATER_CURRENT] = channels.pop(COMMANDED_CURRENT, channels[HEATER_CURRENT])
    return replace(read, channels=channels)


def _completed(placed: Recording, late: Floats, model: DeviceModel) -> Recording:
    """The recording with a command in each interval: that before, the next or their mean, which the samples after it follow best.

    Samples that follow none of these are left out until the body has forgotten it.
    """
    unknown = np.flatnonzero(~np.isfinite(placed[COMMANDED_CURRENT]))
    if not unknown.size:
        return placed

    def commanded(command: Floats) -> Recording:
        return replace(placed, channels={**placed.channels, COMMANDED_CURRENT: command})

    before = held(placed[COMMANDED_CURRENT])
    after = held(placed[COMMANDED_CURRENT][::-1])[::-1]
    fills = [before, after, 0.5 * (before + after)]
    apart = [_moved(commanded(fill), late, model)[1] for fill in fills]
    chosen = before.copy()
    for k in unknown:
        best = min(range(len(fills)), key=lambda one: np.sum(apart[one][k : k + AFTER]))
        chosen[k] = fills[best][k]
    left = _moved(commanded(chosen), late, model)[1]
    usual = np.quantile(np.delete(left, unknown), USUAL)
    forgotten = AFTER + int(
        np.ceil(FORGOTTEN * model.scalars["thermal.time_constant"] / placed.sample_period_s)
    )
    lost = np.zeros(len(placed), dtype=np.bool_)
    for k in unknown[[bool(np.any(left[k : k + AFTER] > usual)) for k in unknown]]:
        lost[k : k + forgotten] = True
    read = commanded(chosen)
    measured = {
        c: np.where(lost, np.nan, v)
        for c, v in read.channels.items()
        if c not in (HEATER_CURRENT, COMMANDED_CURRENT)
    }
    return replace(read, channels={**read.channels, **measured})


def _moved(placed: Recording, late: Floats, model: DeviceModel) -> tuple[Recording, Floats]:
    """The recording at its instants, samples moved that were read so many periods `late` (n,), and how far off the model is (n,).

    That is the sum over the channels of the absolute difference over the channel's range, 0 for a value that is missing.
    """
    drive = placed[COMMANDED_CURRENT if COMMANDED_CURRENT in placed else HEATER_CURRENT]
    if HEATER_CURRENT in placed:  # before the first command
        drive = np.where(np.isfinite(drive), drive, placed[HEATER_CURRENT])
    out = model.simulation.run(np.repeat(held(drive), FINE), dt=placed.sample_period_s / FINE)
    steps = np.arange(len(placed), dtype=np.float64)
    fine = (np.arange(len(out)) + 1.0) / FINE - 1.0
    channels, apart = dict(placed.channels), np.zeros(len(placed))
    for place, channel in enumerate(CHANNELS):
        if channel == HEATER_CURRENT or channel not in placed:
            continue
        course = np.log(out[:, place]) if channel == RESISTANCE else out[:, place]
        there = np.interp(steps, fine, course)
        moved = there - np.interp(steps + late, fine, course)
        channels[channel] = (
            placed[channel] * np.exp(moved) if channel == RESISTANCE else placed[channel] + moved
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            values = np.log(channels[channel]) if channel == RESISTANCE else channels[channel]
        if np.ptp(there) > 0.0:
            apart += np.nan_to_num(np.abs(values - there) / np.ptp(there), posinf=0.0)
    return replace(placed, channels=channels), apart
