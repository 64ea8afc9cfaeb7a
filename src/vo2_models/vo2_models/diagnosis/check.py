"""Look at the data before believing in physics: what makes a recording unusable, and what limits an answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import PRESETS, preset
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.noise import level_from_differences
from vo2_models.diagnosis.nominal import Nominal, judged
from vo2_models.effects.adc_quantization import value_step
from vo2_models.identification.plausibility import impossible, undriven, unexcited, unusual
from vo2_models.recording import (
    HEATER_CURRENT,
    JITTERED,
    RESISTANCE,
    TIP_DEFLECTION,
    Recording,
    clock_of,
    jitter_of,
    regular_instants,
)
from vo2_models.units import stamp_in_words

__all__ = ["ClockFaults", "Finding", "Unusable", "check_recording", "clock_faults"]

Floats = NDArray[np.float64]


class Unusable(ValueError):
    """A recording or model with which no diagnosis is possible; the message is one line with the reason."""


@dataclass(frozen=True)
class Finding:
    """Something about the data that limits the answer.

    Attributes
    ----------
    kind : what it is
    text : one sentence
    leaves_out : channel that is not compared for it, empty for none
    """

    kind: str
    text: str
    leaves_out: str = ""


def check_recording(
    recording: Recording, nominal: Nominal, limits: Limits, *, name: str = "recording"
) -> list[Finding]:
    """Return what limits a diagnosis with this recording.

    Parameters
    ----------
    recording : as it was read
    nominal : simulation of the device that it should be of
    limits : of what can be judged
    name : of the recording, for messages

    Raises
    ------
    Unusable : another device, no usable channel, too short, constant drive, nothing but noise, a wrong clock.
    """
    # a rig may call itself what it likes; a preset's name is a claim
    if recording.device in PRESETS and recording.device != preset(nominal.device).id:
        raise Unusable(
            f"{name}: was recorded on device {recording.device!r}, the model is of {preset(nominal.device).id!r}; "
            "give the model of this device"
        )
    if len(recording) < limits.shortest:
        raise Unusable(f"{name}: found {len(recording)} samples, need at least {limits.shortest}")
    if told := undriven(recording, nominal.device):
        raise Unusable(f"{name}: {told}")
    if wrong := impossible(recording, nominal.device, limits=limits):
        raise Unusable(f"{name}: {'; '.join(wrong)}")
    dead = [
        c
        for c in (RESISTANCE, TIP_DEFLECTION)
        if c in recording and _stands_still(recording[c], c, nominal, limits)
    ]
    moving = {c: values for c, values in recording.channels.items() if c not in dead}
    odd = unusual(replace(recording, channels=moving), nominal.device)
    if units := [text for text in odd if "check the unit" in text]:
        raise Unusable(f"{name}: {'; '.join(units)}")
    findings = [Finding("odd", text) for text in odd]
    own = preset(nominal.device).id
    if recording.device_id not in ("", own) and own not in PRESETS:
        findings.append(
            Finding("device", f"{name}: says that it is of device {recording.device}, the model is of {own}")
        )
    if len(recording) < limits.few:
        findings.append(
            Finding(
                "few",
                f"{name}: {len(recording)} samples: a change must be {np.sqrt(limits.few / len(recording)):.1f} times as large "
                f"to be seen as in {limits.few}, and effects that differ in their time course look alike",
            )
        )
    findings += _clock(recording, nominal, name, limits)
    findings += _drive(recording, nominal, name, limits)
    usable = []
    for channel in (response.role for response in nominal.model.description.responses):
        if channel not in recording:
            findings.append(
                Finding("absent", f"{channel} is absent: effects that only it shows cannot be told")
            )
            continue
        found, good = _channel(recording, channel, nominal, limits)
        findings += found
        if good:
            usable.append(channel)
    if not usable:
        reasons = "; ".join(
            f.text for f in findings if f.kind in ("absent", "noise", "constant", "missing", "clipped")
        )
        raise Unusable(f"{name}: neither film_resistance nor tip_deflection can be used: {reasons}")
    return findings


class ClockFaults(NamedTuple):
    """What is wrong with the stamps of a recording of n samples.

    Attributes
    ----------
    gaps : (n - 1,) whether samples are missing between two
    share : of the time that gaps are
    irregular : why the clock is none, in words; empty where it is one
    """

    gaps: NDArray[np.bool_]
    share: float
    irregular: str


def clock_faults(recording: Recording, *, has_body: bool, limits: Limits) -> ClockFaults:
    """Return the gaps of a recording and whether its clock is that of a regular acquisition.

    Parameters
    ----------
    recording : with its stamps
    has_body : whether its device has a body: a current is held from one instant of a clock to the next, whatever was read of
        it in between
    limits : of gaps and of an unsteady clock
    """
    steps, dt = np.diff(recording.time_s), recording.sample_period_s
    clock = regular_instants(recording.time_s) if has_body else clock_of(recording)
    gaps = np.diff(clock[2]) > 1 if clock else steps > limits.gap * dt
    share = float(np.sum(steps[gaps]) / (recording.time_s[-1] - recording.time_s[0]))
    jitter, irregular = jitter_of(recording.time_s), ""
    if jitter > limits.unsteady and clock is None:
        irregular = (
            f"{100 * jitter:.0f} % of the sample periods differ from the median {dt:.4g} s by over a fifth: "
            "the clock is not that of a regular acquisition; check the stamps"
        )
    return ClockFaults(np.asarray(gaps), share, irregular)


def _clock(recording: Recording, nominal: Nominal, name: str, limits: Limits) -> list[Finding]:
    dt = recording.sample_period_s
    gaps, missing, irregular = clock_faults(
        recording, has_body=nominal.model.description.has_body, limits=limits
    )
    if irregular:
        raise Unusable(f"{name}: {irregular}")
    device = preset(nominal.device)
    shortest, longest = device.shortest_period / 2, 20 * device.time_constant
    if not device.has_body:  # nothing in it has a time of its own: only a wrong unit of the time is told
        shortest, longest = device.sample_period / limits.far_off, device.sample_period * limits.far_off
    if not shortest <= dt <= longest:
        raise Unusable(
            f"{name}: found a sample period of {dt:.4g} s, need {shortest:.4g} to {longest:.4g} s for this device; "
            "check the stamps"
        )
    if missing > limits.gaps:
        raise Unusable(
            f"{name}: gaps make up {100 * missing:.0f} % of the recording, need less than {100 * limits.gaps:.0f} %"
        )
    found, jitter = [], jitter_of(recording.time_s)
    if jitter > JITTERED:
        found.append(
            Finding(
                "jitter",
                f"{name}: {100 * jitter:.0f} % of the sample periods differ from the median {dt:.4g} s by over a fifth: "
                f"values are moved onto a regular grid, and lags, delays and modes below {2 * dt:.2g} s cannot be told",
            )
        )
    if np.any(gaps):
        first = float(recording.time_s[np.argmax(gaps)])
        found.append(
            Finding(
                "gap",
                f"{np.count_nonzero(gaps)} gaps, the first at {stamp_in_words(first)}, {100 * missing:.1f} % of the time: where "
                "no command is known, the current is taken as held over them",
            )
        )
    return found


def _drive(recording: Recording, nominal: Nominal, name: str, limits: Limits) -> list[Finding]:
    current = recording[HEATER_CURRENT]
    good = np.isfinite(current)
    if np.count_nonzero(good) < limits.drive_known * current.size:
        raise Unusable(f"{name}: heater_current is missing from more than half of the samples")
    device = nominal.model.description
    low, high = device.operating_range
    extent = float(np.ptp(current[good]))
    if told := unexcited(current, nominal.device, limits=limits):
        raise Unusable(f"{name}: {told}")
    if extent < limits.narrow * abs(high - low):
        return [
            Finding(
                "narrow",
                f"the current covers {100 * extent / abs(high - low):.0f} % of the operating range: what happens "
                "outside was not excited",
            )
        ]
    return []


def _channel(
    recording: Recording, channel: str, nominal: Nominal, limits: Limits
) -> tuple[list[Finding], bool]:
    values = judged(channel, recording[channel])
    good = np.isfinite(values)
    share = float(np.mean(good))
    if np.count_nonzero(good) < limits.shortest:
        return [
            Finding("missing", f"{channel} is missing from {100 * (1 - share):.0f} % of the samples", channel)
        ], False
    x = values[good]
    found = []
    if share < limits.complete:
        found.append(
            Finding("missing", f"{channel} is missing from {100 * (1 - share):.1f} % of the samples")
        )
    span = float(np.ptp(x))
    if span == 0.0 or span < limits.constant * nominal.span[channel]:
        return [
            *found,
            Finding(
                "constant",
                f"{channel} is constant: a broken lead or a stuck converter, which is not compared",
                channel,
            ),
        ], False
    noise = level_from_differences(x)
    # of few samples the differences are the signal's own, and of a coarse converter's values they are its steps
    white = noise > limits.noisy * float(np.std(x))
    if x.size >= limits.few and white and not _of_steps(recording[channel][good], limits):
        if _stands_still(recording[channel], channel, nominal, limits):
            text = f"{channel} is nothing but noise about one value: a broken lead, which is not compared"
            return [*found, Finding("noise", text, channel)], False
        return [
            *found,
            Finding("noise", f"{channel} is mostly noise (level {noise / np.std(x):.0%} of its spread)"),
        ], False
    ends = max(float(np.mean(x == np.max(x))), float(np.mean(x == np.min(x))))
    if (1.0 - ends) * x.size < limits.shortest:
        return [
            *found,
            Finding(
                "clipped",
                f"{channel} sits at its end value in {100 * ends:.0f} % of the samples, too many to compare it",
                channel,
            ),
        ], False
    if ends > limits.clipped:
        found.append(
            Finding("clipped", f"{channel} sits at its end value in {100 * ends:.1f} % of the samples")
        )
    return found, True


def _stands_still(values: Floats, channel: str, nominal: Nominal, limits: Limits) -> bool:
    """Whether values (n,) stay at one, noise apart: a small part of the range, with differences as large as white noise has."""
    x = values[np.isfinite(values)]
    if x.size < limits.few or np.ptp(x) == 0.0:
        return x.size > 0 and bool(np.ptp(x) == 0.0)
    y = judged(channel, x)
    small = float(np.ptp(y)) < limits.small_part * nominal.span[channel]
    white = level_from_differences(y) > limits.still * float(np.std(y))
    return small and white and not _of_steps(x, limits)


def _of_steps(values: Floats, limits: Limits) -> bool:
    """Whether values (n,) bend no more than by one step of the converter whose comb they lie on."""
    step = value_step(values)
    return step > 0.0 and float(np.median(np.abs(np.diff(values, 2)))) < limits.bends_by * step


def limits_in_words(findings: Sequence[Finding]) -> list[str]:
    """One sentence each."""
    return [f.text for f in findings]
