"""Whether recordings can calibrate a device, and whether a fit to them is one: a model of nonsense must not be written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import PRESETS, DeviceDescription, preset
from vo2_models.diagnosis.check import clock_faults
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nominal import judged
from vo2_models.diagnosis.nuisance import coverage_of
from vo2_models.identification.plausibility import impossible, unexcited, unusual
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

__all__ = ["bare_stretches", "check_calibration", "judge_fit", "noise_level"]

_MANY, _FEWEST, _SHORTEST = 500, 150, 20
"""Samples of a calibration below which it is told to be few, and of a heated body refused; and the least of each recording."""
_BARE = 0.1
"""Share of the operating range without samples from which a stretch of it is told."""
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
    recordings: Sequence[Recording],
    device: str,
    *,
    names: Sequence[str] = (),
    gap_limit: float | None = None,
) -> tuple[list[Recording], list[str]]:
    """Return the recordings without the channels that hold nothing, and what is doubtful about them.

    Parameters
    ----------
    recordings : in the units of a recording (A, ohm, m, degC)
    device : as `preset` takes it
    names : of the recordings, for the messages
    gap_limit : share of a recording that may be gaps, of stamps on any clock; by default that of a diagnosis, on a regular one

    Raises
    ------
    ValueError : too few samples, too many gaps, values that the device cannot have, a clock that it cannot have; one line.
    """
    checked, notes = [], []
    nominal = preset(device)
    total = sum(len(recording) for recording in recordings)
    all_of_them = _name(names, 0) if len(recordings) == 1 else "recordings"
    if nominal.has_body and total < _FEWEST:
        raise ValueError(f"{all_of_them}: found {total} samples, need at least {_FEWEST}")
    still = _constant(recordings, nominal.channels[1:])
    if len(devices := list(dict.fromkeys(one.device for one in recordings if one.device))) > 1:
        raise ValueError(
            f"recordings: found recordings of the devices {' and '.join(devices)}, need those of one device"
        )
    for k, recording in enumerate(recordings):
        name = _name(names, k)
        if recording.device_id not in ("", nominal.id) and nominal.id not in PRESETS:
            notes.append(
                f"{name}: says that it is of device {recording.device}, it is fitted as device {nominal.id}"
            )
        if len(recording) < _SHORTEST:
            raise ValueError(f"{name}: found {len(recording)} samples, need at least {_SHORTEST}")
        gaps = _gaps(recording, nominal, name, gap_limit)
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
        notes += [f"{name}: {text}" for text in (*_missing(recording, empty, nominal), *gaps)]
        kept = {channel: values for channel, values in recording.channels.items() if channel not in empty}
        checked.append(replace(recording, channels=kept))
    drives = [r[c] for r in recordings for c in (COMMANDED_CURRENT, HEATER_CURRENT) if c in r]
    if drives and (told := unexcited(np.concatenate(drives), device)):
        raise ValueError(f"{all_of_them}: {told}")
    if total < _MANY:
        notes.append(f"{all_of_them}: {total} samples are few: what lies between them is a smooth guess")
    for channel, value in still.items():
        notes.append(
            f"{nominal.names[channel]} is {value:.6g} in every sample and is left out: a broken lead or a stuck converter"
        )
    if nominal.has_body and (
        text := _one_way(checked, hot_is_high=nominal.operating_range[1] > nominal.operating_range[0])
    ):
        if total < _MANY:
            raise ValueError(
                f"{all_of_them}: found {total} samples and {text}; of one branch, need at least {_MANY}"
            )
        notes.append(text)
    return checked, notes


def _name(names: Sequence[str], k: int) -> str:
    return names[k] if k < len(names) else f"recording {k + 1}"


def _gaps(recording: Recording, device: DeviceDescription, name: str, limit: float | None) -> list[str]:
    """Say that a gap hides what the drive did; refuse a recording that is gaps to more than a share, as a diagnosis does."""
    limits = Limits()
    gaps, share, irregular = clock_faults(recording, has_body=device.has_body, limits=limits)
    most = limits.gaps if limit is None else limit
    if share > most:
        raise ValueError(
            f"{name}: gaps make up {100 * share:.0f} % of the recording, need at most {100 * most:.0f} % (fit: --gap-limit)"
        )
    if limit is None and irregular:
        raise ValueError(f"{name}: {irregular} (fit: --gap-limit takes it)")
    if not gaps.any():
        return []
    return [
        f"{np.count_nonzero(gaps)} gaps are {100 * share:.1f} % of the time: where no command is known, the drive is taken as "
        "held over them, and what the loops went through meanwhile is lost"
    ]


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
        if declared and sensor.noise > _OVER_DECLARED * declared:
            says = f"device {device.id} has" if device.id in PRESETS else "the device file says"
            notes.append(
                f"{name}: its noise was found to be {sensor.noise / declared:.2g} times what {says}: what the law misses, or "
                "what wanders slowly on held levels, may be in it, and diagnose takes it for the sensor's"
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


def bare_stretches(result: FitResult) -> list[str]:
    """Return which stretches of the operating range the calibration of a heated body hardly covers, in one sentence or none.

    Parameters
    ----------
    result : fit to the calibration
    """
    device = result.model.description
    if not device.has_body or device.power_gain:
        return []  # of the latter the temperatures at the ends of the range go by its resistance there
    starts = [0, *result.ends[:-1]]
    covered = coverage_of([result.path[a + 1 : b] for a, b in zip(starts, result.ends, strict=True)])
    low, high = sorted(device.steady_temperature(drive) for drive in device.operating_range)
    places = np.linspace(low, high, 401)
    bare = np.concatenate([[False], ~covered.holds(places), [False]])
    edges = np.flatnonzero(np.diff(bare.astype(int))).reshape(-1, 2)
    told = [
        f"{places[a]:.0f} to {places[b - 1]:.0f}"
        for a, b in edges
        if places[b - 1] - places[a] > _BARE * (high - low)
    ]
    if not told:
        return []
    return [
        f"hardly a sample at {' and '.join(told)} degC, of the operating range {low:.0f} to {high:.0f} degC: what the loops do "
        "there is a guess, and diagnose leaves it out; record there too"
    ]


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
    """Say which channels miss much."""
    found = []
    for channel in device.channels[1:]:
        if channel in recording and channel not in empty:
            share = 1.0 - float(np.mean(_usable(recording, channel)))
            if share > _MOST_MISSING:
                found.append(f"{device.names[channel]} has no value in {100 * share:.0f} % of the samples")
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
