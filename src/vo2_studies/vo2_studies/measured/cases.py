"""A measured recording in the terms of the device simulation: what drives it, what is judged, and when.

None of the rigs logged a heater current or a temperature. The simulation needs neither: its temperature has no
scale of its own. So the current channel holds that current which, on the preset `integrated`, has a steady
temperature rise proportional to what did drive the rig: the electrical power of a VO2 device that is its own heater,
the voltage of a piezo. Times and shares that are found are physical; kelvins are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from vo2_models.device import preset
from vo2_models.identification.grid import GriddedRecording, on_grid
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

from vo2_studies.measured.sources import Trace

__all__ = ["DEVICE", "READING_V", "SPAN_K", "Case", "cases_of", "drive_share", "with_share"]

Floats = NDArray[np.float64]
DEVICE = "integrated"
SPAN_K = 110.0
"""Steady temperature rise [K] that stands for the largest drive of a set: keeps every loop well inside the fit's bounds."""
READING_V = 0.6
"""Voltage [V] below which a pulse recording is being read (at 0.5 V), not pulsed."""
_SWITCHING = 3.0
"""Resistance, in medians over its pulse, above which the film has not switched and the set current does not flow yet."""
PER_DECADE = 45
"""Samples per decade of time that a fit sees of a relaxation."""
LONGEST_S = 4.0
"""Time after a pulse that is looked at [s]."""


@dataclass(frozen=True)
class Case:
    """One recording, ready for fit and diagnosis.

    Attributes
    ----------
    label : as of its trace
    recording : equivalent `heater_current` [A] and the judged channel, NaN where it is not judged
    channel : the judged channel
    since_s : (n,) time since the drive's last fall [s], NaN before it; for the piezo the time
    drive : (n,) what drove the rig, in `unit`
    unit : of the drive
    """

    label: str
    recording: Recording
    channel: str
    since_s: Floats
    drive: Floats
    unit: str

    @property
    def grid(self) -> GriddedRecording:
        """All judged samples."""
        return on_grid(self.recording)

    def thinned(self) -> Case:
        """The same with samples spread evenly over the logarithm of the time since the pulse.

        Sampled evenly in time, nine tenths of a relaxation's samples lie in its last decade.
        """
        values = self.recording[self.channel]
        keep = np.zeros(values.size, dtype=np.bool_)
        good = np.flatnonzero(np.isfinite(values))
        for run in np.split(good, np.flatnonzero(np.diff(good) > 1) + 1):
            count = max(int(PER_DECADE * np.log10(max(run.size, 10))), 10)
            place = np.unique(np.round(np.geomspace(1, run.size, count)).astype(int)) - 1
            keep[run[place]] = True
        channels = {**self.recording.channels, self.channel: np.where(keep, values, np.nan)}
        return replace(self, recording=replace(self.recording, channels=channels))


def with_share(recording: Recording, share: Floats) -> Recording:
    """Replace the drive by another share (n,) of the set's largest."""
    channels = {**recording.channels, HEATER_CURRENT: _current(share)}
    return replace(recording, channels=channels)


def drive_share(current: Floats) -> Floats:
    """Share of the set's largest drive (n,) that an equivalent current (n,) [A] stands for."""
    return preset(DEVICE).square_gain * current**2 / SPAN_K


def _current(share: Floats) -> Floats:
    return np.sqrt(np.maximum(share, 0.0) * SPAN_K / preset(DEVICE).square_gain)


def cases_of(key: str, traces: Sequence[Trace]) -> list[Case]:
    """Return the cases of a set, with a common scale of the drive."""
    build = {"pulses": _pulses, "piezo": _piezo}.get(key, _relaxation)
    raw = [build(trace) for trace in traces]
    largest = max(float(np.max(case.drive)) for case in raw)
    return [replace(case, recording=with_share(case.recording, case.drive / largest)) for case in raw]


def _pulses(trace: Trace) -> Case:
    """Power V I [W]; judged between the pulses, for during them the power contains the resistance itself."""
    recording = trace.recording
    voltage = recording["heater_voltage"]
    last = int(np.flatnonzero(voltage > 0.2)[-1])  # after it the instrument is off
    recording = recording.slice(0, last)
    voltage, resistance = voltage[:last], recording[RESISTANCE]
    reading = voltage < READING_V
    # the sample in which the voltage falls is a mean over both
    settled = reading & np.concatenate([[False], reading[:-1]])
    since = _since_fall(recording.time_s, ~reading)
    judged = np.where(settled & np.isfinite(since), resistance, np.nan)
    # reading heats by less than a hundredth of a pulse, and its power, V^2 / R, would tell the resistance
    power = np.where(reading, 0.0, np.abs(voltage * recording[HEATER_CURRENT]))
    return _case(trace, recording.time_s, {RESISTANCE: judged}, since, power, "W")


def _relaxation(trace: Trace) -> Case:
    """Power I^2 R over the pulse that the sheet's heading names, none afterwards: the reading was not recorded."""
    recording = trace.recording
    time, resistance, dt = recording.time_s, recording[RESISTANCE], recording.sample_period_s
    unit = trace.label.split()[1]
    length = trace.value if unit == "s" else 0.1
    # the current of the set with different lengths is not told: one for all, so its power is relative
    current = 1.0 if unit == "s" else 1e-3 * trace.value
    on = (time > 0.5 * dt) & (time < length + 0.5 * dt)
    usual = float(np.median(resistance[on]))
    power = np.where(on, current**2 * np.minimum(resistance, _SWITCHING * usual), 0.0)
    since = np.where(time > length + 0.5 * dt, time - length, np.nan)
    judged = np.where(time > length + 1.5 * dt, resistance, np.nan)
    case = _case(trace, time, {RESISTANCE: judged}, since, power, "W/A²" if unit == "s" else "W")
    return _shortened(case, length) if time[-1] - length > LONGEST_S else case


def _shortened(case: Case, length: float) -> Case:
    """Every second sample, and only the first seconds after the pulse: what comes later changes no more."""
    stop = int(np.searchsorted(case.recording.time_s, length + LONGEST_S))
    kept = slice(0, stop, 2)  # the first sample is before the pulse: a fit starts at rest
    channels = {name: values[kept] for name, values in case.recording.channels.items()}
    return replace(
        case,
        recording=replace(case.recording, time_s=case.recording.time_s[kept], channels=channels),
        since_s=case.since_s[kept],
        drive=case.drive[kept],
    )


def _piezo(trace: Trace) -> Case:
    recording = trace.recording
    voltage = recording["heater_voltage"]
    channels = {TIP_DEFLECTION: recording[TIP_DEFLECTION]}
    return _case(trace, recording.time_s, channels, recording.time_s - recording.time_s[0], voltage, "V")


def _case(
    trace: Trace, time: Floats, judged: dict[str, Floats], since: Floats, drive: Floats, unit: str
) -> Case:
    channel = next(iter(judged))
    recording = Recording(time, {HEATER_CURRENT: np.zeros(time.size), **judged}, DEVICE)
    return Case(trace.label, recording, channel, since, drive, unit)


def _since_fall(time: Floats, on: NDArray[np.bool_]) -> Floats:
    """Time since the last sample that was on (n,) [s], NaN before the first."""
    last = np.maximum.accumulate(np.where(on, np.arange(time.size), -1))
    return np.where(last >= 0, time - time[np.maximum(last, 0)], np.nan)
