"""A recording in memory: synchronous samples of named channels, as one bag or one run holds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.validation import finite_array, increasing

__all__ = [
    "COMMANDED_CURRENT",
    "HEATER_CURRENT",
    "JITTERED",
    "RESISTANCE",
    "STAGE_TEMPERATURE",
    "TIP_DEFLECTION",
    "Recording",
    "aligned",
    "as_recordings",
    "clock_of",
    "counted",
    "in_order",
    "jitter_of",
    "regular",
    "regular_instants",
]

HEATER_CURRENT = "heater_current"
"""Current through the heater as the rig logs it [A]."""
COMMANDED_CURRENT = "commanded_current"
"""What the controller asked for over the interval that ends at the sample [A]; from the command topic."""
RESISTANCE = "film_resistance"
"""Film resistance [ohm]."""
TIP_DEFLECTION = "tip_deflection"
"""Tip deflection by an external sensor [m]."""
STAGE_TEMPERATURE = "stage_temperature"
"""Temperature of the Peltier stage [degC]."""
JITTERED = 0.1
"""Share of the sample periods that are off by over a fifth, from which a recording is laid on a regular grid."""
ON_GRID = 0.45
"""Distance of a stamp from its regular instant, in periods, that 99 of 100 keep where there is a grid behind the stamps."""
_EXACT = 1e-3
"""Distance of a stamp from its regular instant, in periods, below which it is exact: stamps are rounded."""
_FEWEST = 16
"""Stamps that show a clock."""
_FIRST = 64
"""Stamps over which the period of a clock is looked for."""


@dataclass(frozen=True)
class Recording:
    """Samples of one device.

    The current convention is that of a zero-order hold seen by a data logger: element k of a current
    channel flowed during the interval that *ends* at `time_s[k]`; the other channels are what was
    sampled at `time_s[k]`.

    Attributes
    ----------
    time_s : (n,) stamps [s], strictly increasing
    channels : name -> (n,) values in SI units (degree Celsius for temperatures); NaN where a sample of
        a channel is missing
    device : preset id, as in `header.frame_id`; empty where unknown
    unread : instants (m,) [s] at which no sample was read, and the command (m,) [A] that governed the interval which ends
        there: what is lost on its way to a log is lost to the log only

    Examples
    --------
    >>> Recording(np.array([0.0, 0.5]), {"stroke": np.zeros(2)}, "stack")
    Recording(2 samples, 0 to 0.5 s: stroke; device stack)
    """

    time_s: NDArray[np.float64]
    channels: Mapping[str, NDArray[np.float64]]
    device: str = ""
    unread: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def __post_init__(self) -> None:
        time = increasing(finite_array(self.time_s, "time_s"), "time_s")
        object.__setattr__(self, "time_s", time)
        checked = {}
        for name, values in self.channels.items():
            array = np.ascontiguousarray(values, dtype=np.float64)
            if array.shape != time.shape:
                raise ValueError(
                    f"channel {name}: found shape {array.shape}, need {time.shape} as time_s has"
                )
            checked[name] = array
        object.__setattr__(self, "channels", checked)

    def __repr__(self) -> str:
        span = (
            f"{len(self)} samples, {self.time_s[0]:.6g} to {self.time_s[-1]:.6g} s" if len(self) else "empty"
        )
        return f"Recording({span}: {', '.join(self.channels) or 'no channels'}; device {self.device or 'unknown'})"

    def __len__(self) -> int:
        return self.time_s.size

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return the channel `name` (n,); raise `KeyError` naming what there is instead."""
        if name not in self.channels:
            raise KeyError(
                f"channel {name} is not in this recording, which has {', '.join(self.channels) or 'none'}"
            )
        return self.channels[name]

    @property
    def device_id(self) -> str:
        """Id of the device that it says it is of; "" where a node was given the path of a file: what that held is not known."""
        return "" if self.device.endswith((".yaml", ".yml")) else self.device

    @property
    def sample_period_s(self) -> float:
        """Median distance of neighbouring stamps [s]; robust against gaps."""
        return float(np.median(np.diff(self.time_s)))

    def slice(self, start: int, stop: int) -> Recording:
        """Return samples start..stop-1 as a recording of their own."""
        time = self.time_s[start:stop]
        unread = self.unread
        if unread is not None:
            inside = (unread[0] > time[0]) & (unread[0] < time[-1]) if time.size else slice(0)
            unread = unread[0][inside], unread[1][inside]
        return replace(
            self,
            time_s=time,
            channels={name: values[start:stop] for name, values in self.channels.items()},
            unread=unread,
        )

    def with_unread(self) -> Recording:
        """Return the recording with a sample, NaN but for its command, at every instant of `unread`."""
        if self.unread is None or not self.unread[0].size:
            return self
        time = np.concatenate([self.time_s, self.unread[0]])
        order = np.argsort(time, kind="stable")
        nothing = np.full(self.unread[0].size, np.nan)
        channels = {
            name: np.concatenate([values, self.unread[1] if name == COMMANDED_CURRENT else nothing])[order]
            for name, values in self.channels.items()
        }
        return Recording(time[order], channels, self.device)


def aligned(recording: Recording, delay: float) -> Recording:
    """Return the recording with each command moved to the interval that it governed.

    A rig may stamp a command at the end of the interval it governs (delay: minus one sample period) or apply it late by a
    constant. Element k of `commanded_current` becomes the mean of the held command over the interval that ends at
    `time_s[k]`, moved back by the delay. Before the first command it stays NaN, and where none governs any more.

    Parameters
    ----------
    delay : time from where a command stands in the recording to where it acts [s], `model.recording.command_delay`
    """
    if delay == 0.0 or COMMANDED_CURRENT not in recording or len(recording) < 2:
        return recording
    whole = recording.with_unread()
    command, time = whole[COMMANDED_CURRENT], whole.time_s
    known = np.flatnonzero(np.isfinite(command))
    if not known.size:
        return recording
    first = int(known[0])
    last = np.maximum(np.searchsorted(known, np.arange(command.size), side="right") - 1, 0)
    held = command[known[last]]
    ends = np.concatenate([[2.0 * time[0] - time[1]], time])
    charge = np.concatenate([[0.0], np.cumsum(held * np.diff(ends))])

    def integral(at: NDArray[np.float64]) -> NDArray[np.float64]:
        beyond = held[0] * np.minimum(at - ends[0], 0.0) + held[-1] * np.maximum(at - ends[-1], 0.0)
        return np.interp(at, ends, charge) + beyond

    moved = (integral(ends[1:] - delay) - integral(ends[:-1] - delay)) / np.diff(ends)
    if first:
        moved[time - delay < time[first]] = np.nan
    # where no command governs any more only the log says what flowed, before and after the move
    alone = ~np.isfinite(command)
    alone[:first] = False
    moved[alone[np.clip(np.searchsorted(time, time - delay), 0, time.size - 1)]] = np.nan
    read = np.isin(time, recording.time_s)
    unread = None if recording.unread is None else (time[~read], moved[~read])
    channels = {**recording.channels, COMMANDED_CURRENT: moved[read]}
    return replace(recording, channels=channels, unread=unread)


def jitter_of(time_s: NDArray[np.float64]) -> float:
    """Return the share of the sample periods, gaps apart, that differ from the median by over a fifth of it.

    Parameters
    ----------
    time_s : (n,) stamps [s]
    """
    steps = np.diff(time_s)
    steps = steps / np.median(steps)
    steps = steps[steps <= 1.5]
    return float(np.mean(np.abs(steps - 1.0) > 0.2)) if steps.size else 1.0


def regular_instants(time_s: NDArray[np.float64]) -> tuple[float, float, NDArray[np.intp]] | None:
    """Return the clock that an acquisition follows whose samples come a little early or late.

    The period is the one near the median at which the first stamps are most in phase; period and phase are then fitted by
    least squares to more and more stamps, along which the period found so far counts right.

    Parameters
    ----------
    time_s : (n,) stamps [s]

    Returns
    -------
    first instant [s], period [s], and the number of each stamp's instant (n,); None where stamps do not jitter, or follow
    no such clock: a loop that waits for a period after its work has none
    """
    if time_s.size < _FEWEST or np.ptp(np.diff(time_s)) <= _EXACT * np.median(np.diff(time_s)):
        return None
    some, start, count = time_s - time_s[0], 0.0, _FIRST
    tried = float(np.median(np.diff(time_s))) * np.linspace(0.94, 1.06, 481)
    together = np.abs(np.mean(np.exp(2j * np.pi * some[:count] / tried[:, None]), axis=1))
    period = float(tried[np.argmax(together)])
    while count < 2 * time_s.size:
        near = some[:count]
        phase = np.angle(np.mean(np.exp(2j * np.pi * near / period))) / (2.0 * np.pi)
        period, start = map(float, np.polyfit(np.rint(near / period - phase), near, 1))
        count *= 2
    place = np.rint((some - start) / period)
    late = (some - start) / period - place
    exact = np.std(late) < _EXACT
    if exact or np.quantile(np.abs(late), 0.99) > ON_GRID or np.any(np.diff(place) < 1.0):
        return None
    return time_s[0] + start + place[0] * period, period, (place - place[0]).astype(np.intp)


def clock_of(recording: Recording) -> tuple[float, float, NDArray[np.intp]] | None:
    """Return the clock of the commands behind stamps that jitter, see `regular_instants`; None where there are no commands.

    A drive that is only logged was read with the other channels: neither is early or late of the other.

    Parameters
    ----------
    recording : with any stamps
    """
    return regular_instants(recording.time_s) if COMMANDED_CURRENT in recording else None


def counted(time_s: NDArray[np.float64]) -> tuple[float, float, NDArray[np.intp]]:
    """Return what `regular_instants` does, of stamps without a clock: first stamp, median period, and periods from the first.

    Each step counts by itself where they are nearly equal, so that a period that wanders a little misses no sample.

    Parameters
    ----------
    time_s : (n,) stamps [s]
    """
    steps = np.diff(time_s)
    period = float(np.median(steps))
    place = np.rint((time_s - time_s[0]) / period)
    if jitter_of(time_s) <= JITTERED:
        place = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / period), 1.0))])
    return float(time_s[0]), period, place.astype(np.intp)


def regular(recording: Recording) -> Recording:
    """Return the recording at the regular instants of its acquisition, NaN where a sample is missing.

    Samples that come a little early or late are moved to their instant along the local slope, the median of the four
    differences about them (of the logarithm of a resistance), which leaves their noise as it was to a few percent and
    spreads no outlier; currents, which are held over a period, keep their values. Where stamps jitter and follow no clock,
    it is interpolated in straight lines.

    Parameters
    ----------
    recording : with any stamps
    """
    recording = recording.with_unread()
    time = recording.time_s
    clock = clock_of(recording)
    if clock is None and jitter_of(time) > JITTERED:
        return _interpolated(recording, recording.sample_period_s)
    placed, late = in_order(recording)
    if clock is None:
        return placed
    return replace(
        placed,
        channels={
            name: values if name in (COMMANDED_CURRENT, HEATER_CURRENT) else _in_time(name, values, late)
            for name, values in placed.channels.items()
        },
    )


def in_order(recording: Recording) -> tuple[Recording, NDArray[np.float64]]:
    """Return the samples at regular instants, NaN where one is missing, and how late each was read (m,) [periods].

    Without a clock behind the stamps a sample stands for its instant.

    Parameters
    ----------
    recording : with stamps about a period apart, or several
    """
    time = recording.time_s
    clock = clock_of(recording)
    start, period, place = clock or counted(time)
    late = (time - start) / period - place if clock else np.zeros(time.size)
    if clock is None and place[-1] == place.size - 1:
        return recording, late
    kept, first = np.unique(place, return_index=True)
    size = int(kept[-1]) + 1

    def spread(values: NDArray[np.float64], missing: float) -> NDArray[np.float64]:
        all_of_them = np.full(size, missing)
        all_of_them[kept] = values[first]
        return all_of_them

    channels = {name: spread(values, np.nan) for name, values in recording.channels.items()}
    instants = np.asarray(start + np.arange(size) * period)
    return Recording(instants, channels, recording.device), spread(late, 0.0)


def as_recordings(given: Recording | Sequence[Recording], name: str = "recordings") -> list[Recording]:
    """Return recordings as a list, a single one too.

    Parameters
    ----------
    given : one or several
    name : of the argument, for messages

    Raises
    ------
    ValueError : anything else; the message says what was found.
    """
    listed = [given] if isinstance(given, Recording) else given
    wrong = (
        [one for one in listed if not isinstance(one, Recording)]
        if isinstance(listed, list | tuple)
        else [given]
    )
    if wrong:
        raise ValueError(
            f"{name}: found {type(wrong[0]).__name__}, need a Recording or a list of them: "
            "Recording(time_s, {channel: values}, device)"
        )
    return list(listed)


def _in_time(name: str, values: NDArray[np.float64], late: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (n,) at their instants that were read so many periods `late` (n,)."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 3:
        return values
    logarithmic = name == RESISTANCE and bool(np.min(values[known]) > 0.0)
    course = np.log(values[known]) if logarithmic else values[known]
    slopes = np.pad(np.diff(course) / np.diff(known + late[known]), 2, constant_values=np.nan)
    slope = np.nanmedian(np.lib.stride_tricks.sliding_window_view(slopes, 4), axis=1)
    course = course - late[known] * slope
    moved = values.copy()
    moved[known] = np.exp(course) if logarithmic else course
    return moved


def _interpolated(recording: Recording, dt: float) -> Recording:
    """The recording in straight lines between its samples, at regular times; NaN between those two periods apart."""
    stamps = recording.time_s
    time = np.arange(stamps[0], stamps[-1] + 0.5 * dt, dt)
    after = np.searchsorted(stamps, time).clip(1, stamps.size - 1)
    lonely = stamps[after] - stamps[after - 1] > 2.0 * dt
    channels = {}
    for name, values in recording.channels.items():
        good = np.isfinite(values)
        missing = lonely | (np.interp(time, stamps, good.astype(float)) < 1.0 - 1e-9)
        filled = np.interp(time, stamps[good], values[good]) if good.any() else np.full(time.size, np.nan)
        channels[name] = np.where(missing, np.nan, filled)
    return Recording(time, channels, recording.device)
