"""Whether recordings can calibrate a device, and whether a fit to them is one: a model of nonsense must not be written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import PRESETS, DeviceDescription, preset
from vo2_models.diagnosis.nominal import judged
from vo2_models.identification.plausibility import impossible, unusual
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    Recording,
)
from vo2_models.self_sensing.scheme import self_sensing
from vo2_models.units import shown_unit

if TYPE_CHECKING:
    from vo2_models.device.model import DeviceModel
    from vo2_models.identification.device_fit import FitResult

__all__ = ["check_calibration", "judge_fit", "noise_level"]

_SHORTEST = 500
_SHORTEST_QUASI_STATIC = 20
_SETTLED = 20.0
"""Time constants between two samples from which a lag cannot be seen; `diagnose` refuses such a recording."""
_MOST_MISSING = 0.5
_LEAST_EXPLAINED = 0.5
_POOR_SHARE = 0.01
_POOR_NOISE = 5.0
_RETURN = 0.1
_PLAINLY = 3.0
_OVER_DECLARED = 3.0
_TOLD = 100


def check_calibration(
    recordings: Sequence[Recording], device: str, *, names: Sequence[str] = ()
) -> tuple[list[Recording], list[str]]:
    """Return the recordings without the channels that hold nothing, and what is doubtful about them.

    Parameters
    ----------
    recordings : in the units of a recording (A, ohm, m, degC)
    device : as `preset` takes it
    names : of the recordings, for the messages

    Raises
    ------
    ValueError : too few samples, values that the device cannot have, a clock that it cannot have; one line.
    """
    checked, notes = [], []
    nominal = preset(device)
    still = _constant(recordings, nominal.channels[1:])
    if len(devices := list(dict.fromkeys(one.device for one in recordings if one.device))) > 1:
        raise ValueError(
            f"recordings: found recordings of the devices {' and '.join(devices)}, need those of one device"
        )
    for k, recording in enumerate(recordings):
        name = names[k] if k < len(names) else f"recording {k + 1}"
        if recording.device_id not in ("", nominal.id) and nominal.id not in PRESETS:
            notes.append(
                f"{name}: says that it is of device {recording.device}, it is fitted as device {nominal.id}"
            )
        least = _SHORTEST if nominal.has_body else _SHORTEST_QUASI_STATIC
        if len(recording) < least:
            raise ValueError(f"{name}: found {len(recording)} samples, need at least {least}")
        if found := impossible(recording, device):
            raise ValueError(f"{name}: {'; '.join(found)}")
        known = nominal.has_body and nominal.tells("sampling")
        if known and recording.sample_period_s < nominal.shortest_period / 2:
            raise ValueError(
                f"{name}: found a sample every {recording.sample_period_s:.3g} s, need at least "
                f"{nominal.shortest_period / 2:.3g} s for device {nominal.id}; check the time column and its unit"
            )
        if (
            nominal.tells("body", "time_constant")
            and recording.sample_period_s > _SETTLED * nominal.time_constant
        ):
            notes.append(
                f"{name}: the samples are {recording.sample_period_s:.3g} s apart, the time constant of device {nominal.id} is "
                f"{nominal.time_constant:.3g} s: each is taken as settled, and no lag can be found; check the time column and "
                "its unit if that is not so"
            )
        empty = [
            channel
            for channel in nominal.channels[1:]
            if channel in recording and channel not in still and not _usable(recording, channel).any()
        ]
        kept = {channel: values for channel, values in recording.channels.items() if channel not in still}
        recording = replace(recording, channels=kept)
        notes += [f"{name}: {text}" for text in unusual(recording, device)]
        notes += [f"{name}: {nominal.names[c]} has no value at all and is left out" for c in empty]
        notes += [f"{name}: {text}" for text in _missing(recording, empty, nominal)]
        if len(recording) < _SHORTEST:
            notes.append(
                f"{name}: {len(recording)} samples are few: what lies between them is a smooth guess"
            )
        kept = {channel: values for channel, values in recording.channels.items() if channel not in empty}
        checked.append(replace(recording, channels=kept))
    for channel, value in still.items():
        notes.append(
            f"{nominal.names[channel]} is {value:.6g} in every sample and is left out: a broken lead or a stuck converter"
        )
    if nominal.has_body and (
        text := _one_way(checked, hot_is_high=nominal.operating_range[1] > nominal.operating_range[0])
    ):
        notes.append(text)
    return checked, notes


def judge_fit(result: FitResult, recordings: Sequence[Recording]) -> list[str]:
    """Return what is poor about a fit, one sentence each.

    Parameters
    ----------
    result : fit to judge
    recordings : it was fitted to

    Raises
    ------
    ValueError : a channel of which the fit explains less than half of the variance; one line.
    """
    notes = []
    device = result.model.description
    for channel, sensor in result.model.sensors.items():
        name = device.names[channel]
        values = np.concatenate([judged(channel, r[channel]) for r in recordings if channel in r])
        values = values[np.isfinite(values)]
        unit, factor = shown_unit(device.units[channel])
        unit = f"log10 {unit}" if channel == RESISTANCE else unit
        explained = 1.0 - sensor.residual**2 / max(float(np.var(values)), 1e-300)
        size = f"{factor * sensor.residual:.3g} {unit} r.m.s. are left of a span of {factor * np.ptp(values):.3g}"
        if explained < _LEAST_EXPLAINED:
            raise ValueError(
                f"{name} does not follow {device.drive_channel} in a loop: the best one explains "
                f"{100 * max(explained, 0.0):.0f} % of its variance ({size}), need "
                f"{100 * _LEAST_EXPLAINED:.0f} %; check the drive's and the time's unit, that the columns belong together, "
                "that the device was driven through its loop, and that a time constant in the device file is right within a "
                "factor of a few; or leave the channel out"
            )
        noise = noise_level(channel, sensor.noise)
        declared = device.noise.get(channel)
        if device.id not in PRESETS and declared and sensor.noise > _OVER_DECLARED * declared:
            notes.append(
                f"{name}: its noise was found to be {sensor.noise / declared:.2g} times what the device file says: what wanders "
                "slowly on held levels may be the device's, and diagnose takes it for the sensor's"
            )
        if device.has_body and sensor.residual > max(
            _POOR_NOISE * noise, _POOR_SHARE * float(np.ptp(values))
        ):
            notes.append(
                f"{name} is fitted poorly: {size}, at a noise of {factor * noise:.2g}{_where(result, channel)}; look for "
                "gaps, jumps or a wrong clock in the recording before you trust this model, or for physics that it lacks "
                "(diagnose --calibration)"
            )
        elif not device.has_body and sensor.residual > _POOR_NOISE * noise:
            notes.append(
                f"{name}: {size}, at a noise of {factor * noise:.2g}: what the law misses{_where(result, channel)}; diagnose "
                "will not tell changes of less than about twice that from it"
            )
    return notes + _not_unique(result.model)


def _not_unique(model: DeviceModel) -> list[str]:
    """Say that the linear response cannot be estimated from the log10 one; nothing where no scheme can be built of the model."""
    try:
        doubt = self_sensing("composite", model.to_parameters()).doubt
    except ValueError:
        return []
    return [f"self-sensing: {doubt}"] if doubt else []


def _where(result: FitResult, channel: str) -> str:
    """Say on which branch and at which rate a channel is fitted worst, where one is plainly worse than the other."""
    residual, path = result.residuals.get(channel), result.path
    if residual is None or residual.size != path.size or path.size < 3:
        return ""
    rate = np.gradient(path)
    # the cold samples between recordings are no rate
    good = np.isfinite(residual) & (np.abs(rate) < 10.0 * np.quantile(np.abs(rate), 0.99) + 1e-12)
    moving = good & (np.abs(rate) > 0.02 * np.quantile(np.abs(rate[good]), 0.95)) if good.any() else good
    if np.count_nonzero(moving) < _TOLD:
        return ""
    fast = np.abs(rate) > np.median(np.abs(rate[moving]))
    device, ways = result.model.description, ["while heating", "while cooling"]
    if not device.has_body:
        first, last = device.operating_range
        up, down = ("rises", "falls") if first < last else ("falls", "rises")
        ways = [f"while {device.drive_channel} {way}" for way in (up, down)]
    found = []
    for one, other, words in (
        (rate > 0.0, rate < 0.0, ways),
        (fast, ~fast, ["at the higher rates", "at the lower rates"]),
    ):
        sides = [
            float(np.mean(residual[moving & side] ** 2)) for side in (one, other) if np.any(moving & side)
        ]
        if len(sides) == 2 and max(sides) > _PLAINLY * min(sides):
            found.append(words[int(np.argmax(sides))])
    return f", most of it {' and '.join(found)}" if found else ""


def noise_level(channel: str, noise: float) -> float:
    """Return a sensor's noise in the unit in which the channel's residual is given (log10 ohm for the resistance)."""
    return noise / float(np.log(10.0)) if channel == RESISTANCE else noise


def _constant(recordings: Sequence[Recording], channels: Sequence[str]) -> dict[str, float]:
    """The channels that hold one value in all samples of all recordings, and the value."""
    found = {}
    for channel in channels:
        values = np.concatenate([[], *(r[channel] for r in recordings if channel in r)])
        values = values[np.isfinite(values)]
        if values.size and np.ptp(values) == 0.0:
            found[channel] = float(values[0])
    return found


def _usable(recording: Recording, channel: str) -> NDArray[np.bool_]:
    return np.isfinite(judged(channel, recording[channel]))


def _missing(recording: Recording, empty: Sequence[str], device: DeviceDescription) -> list[str]:
    """Say which channels miss much, and that a gap hides what the drive did."""
    found = []
    for channel in device.channels[1:]:
        if channel in recording and channel not in empty:
            share = 1.0 - float(np.mean(_usable(recording, channel)))
            if share > _MOST_MISSING:
                found.append(f"{device.names[channel]} has no value in {100 * share:.0f} % of the samples")
    steps = np.diff(recording.time_s)
    gaps = steps > 1.5 * recording.sample_period_s
    if gaps.any():
        share = float(steps[gaps].sum() / (recording.time_s[-1] - recording.time_s[0]))
        found.append(
            f"{np.count_nonzero(gaps)} gaps are {100 * share:.1f} % of the time: where no command is known, the drive is "
            "taken as held over them, and what the loops went through meanwhile is lost"
        )
    return found


def _one_way(recordings: Sequence[Recording], *, hot_is_high: bool) -> str:
    """Say that only one branch was measured, if the current never came back by a tenth of its span."""
    ways = set()
    for recording in recordings:
        name = COMMANDED_CURRENT if COMMANDED_CURRENT in recording else HEATER_CURRENT
        if name not in recording:
            return ""
        current = recording[name][np.isfinite(recording[name])]
        if not current.size:
            return ""
        least = _RETURN * float(np.ptp(current))
        if least and np.max(current - np.minimum.accumulate(current)) > least:
            ways.add(hot_is_high)
        if least and np.max(np.maximum.accumulate(current) - current) > least:
            ways.add(not hot_is_high)
    if len(ways) != 1:
        return ""
    seen, unseen = ("heating", "cooling") if ways == {True} else ("cooling", "heating")
    return (
        f"the current only goes one way: the {unseen} branch is a guess from the {seen} branch; record both"
    )
