"""One recording made ready: on a regular grid, in judged units, with what is missing marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import preset
from vo2_models.diagnosis.current_reading import as_commanded
from vo2_models.diagnosis.nominal import Nominal, drive_of, judged
from vo2_models.effects import effects
from vo2_models.effects.adc_quantization import value_step
from vo2_models.identification.grid import held
from vo2_models.identification.read_in_time import read_in_time
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    JITTERED,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
    clock_of,
    in_order,
    jitter_of,
)

__all__ = ["Part", "prepare"]

Floats = NDArray[np.float64]
FEWEST = 25
"""Samples from which a channel is compared, and a reading is judged."""
BLIND = 3
"""Missing samples in a row after which the memory of the loops may be another."""
FLAT = 0.01
"""From this share of the way from another sample to a flat one on a moment counts as flat."""
WHOLE = 4.0
"""Ratio of squared distances from the command of samples that come early and late, from which one of them reads another one."""
TORN, SETTLED = 0.02, 6.0
"""Share of its range by which a drive steps in a gap, and time constants after which its instant no longer matters."""
BEYOND = 0.05
"""Share of its range by which a drive goes beyond both ends of a gap that leaves the loops another memory."""
AWAY = 0.5
"""Share of its range by which the drive of a device without body must be able to move in a gap for that: where it goes
from one end of the gap to the other without a turn, the loops are as if they had seen it."""


@dataclass(frozen=True)
class Part:
    """One recording, ready.

    Attributes
    ----------
    name : for messages
    time_s : (n,) regular [s]
    dt : sample period [s]
    current : (n,) what drives the simulation [A]
    channels : the channels that are compared
    observed : channel -> (n,) in judged units
    valid : channel -> (n,) whether the sample counts
    settled : whether the device was at rest at the first current before
    comb : channel -> distance of neighbouring values, where its converter is coarser than its noise
    blind : gaps so long that the film may have been anywhere meanwhile, each from its first to behind its last sample
    read_late : whether a current that is read back may stand for any moment of its sample; False once it shows for which
    evident : id of an effect and channel -> its parameters, where the values show them by themselves
    flat : id -> channel -> (n,) samples that say no more than that the true value is beyond; they do not count
    uneven : channel -> (n,) size of the noise over its level, where the law misses steep places by more than flat ones
    """

    name: str
    time_s: Floats
    dt: float
    current: Floats
    channels: tuple[str, ...]
    observed: Mapping[str, Floats]
    valid: Mapping[str, NDArray[np.bool_]]
    settled: bool = False
    comb: Mapping[str, float] = field(default_factory=dict)
    blind: tuple[tuple[int, int], ...] = ()
    read_late: bool = True
    evident: Mapping[tuple[str, str], Mapping[str, float]] = field(default_factory=dict)
    flat: Mapping[str, Mapping[str, NDArray[np.bool_]]] = field(default_factory=dict)
    uneven: Mapping[str, Floats] = field(default_factory=dict)

    def comb_level(self, channel: str) -> Floats | float:
        """Standard deviation that a coarse converter adds, in judged units: step / sqrt(12)."""
        step = self.comb.get(channel, 0.0) / np.sqrt(12.0)
        if not step or channel != RESISTANCE:
            return step
        return step / (np.log(10.0) * 10.0 ** self.observed[channel])

    def rounding(self, channel: str, predicted: Floats) -> Floats | float:
        """Standard deviation that a coarse converter adds to predicted values: `comb_level`, or more where it rounds by more.

        That level is an average over all values. A device that rests does not go through all of them: what it rests at
        stays rounded by up to half a step, which is no excess.

        Parameters
        ----------
        channel : one of `channels`
        predicted : (n,) in judged units, before the converter
        """
        mean = self.comb_level(channel)
        if channel not in self.comb:
            return mean
        step, exponential = self.comb[channel], channel == RESISTANCE
        seen = self.observed[channel][self.valid[channel]]
        angle = 2.0 * np.pi / step
        phase = np.angle(np.mean(np.exp(1j * angle * (10.0**seen if exponential else seen)))) / angle
        value = 10.0**predicted if exponential else predicted
        off = value - phase - step * np.round((value - phase) / step)
        return np.maximum(mean, np.abs(off) / (np.log(10.0) * value if exponential else 1.0))

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.time_s.size)


def prepare(recording: Recording, nominal: Nominal, *, name: str = "recording") -> Part:
    """Return a recording ready for comparison with the nominal simulation.

    Parameters
    ----------
    recording : of the device
    nominal : fitted simulation
    name : of the recording, for messages

    Raises
    ------
    ValueError : no current, or neither resistance nor deflection.
    """
    if HEATER_CURRENT not in recording:
        raise ValueError(
            f"{name}: found channels {', '.join(recording.channels) or 'none'}, need heater_current"
        )
    raw, recording = recording, read_in_time(recording, nominal.model)
    current, own = drive_of(recording)
    drive = recording[HEATER_CURRENT]
    if COMMANDED_CURRENT in recording:
        drive = np.where(np.isfinite(drive), drive, recording[COMMANDED_CURRENT])
    blind = _longest_blind(drive, nominal, recording.sample_period_s)
    laws = {RESISTANCE: nominal.model.resistance.present, TIP_DEFLECTION: nominal.model.deflection.present}
    wanted = [c for c in (RESISTANCE, TIP_DEFLECTION) if laws[c] and c in recording]
    if not wanted:
        raise ValueError(
            f"{name}: found channels {', '.join(recording.channels)}, need film_resistance or tip_deflection"
        )
    if STAGE_TEMPERATURE in recording and preset(nominal.device).measures_temperature:
        wanted.append(STAGE_TEMPERATURE)
    if own and HEATER_CURRENT in nominal.noise and _reads_whole_periods(raw):
        wanted.insert(0, HEATER_CURRENT)
    observed, valid = {}, {}
    for channel in wanted:
        values = judged(channel, recording[channel])
        if channel == HEATER_CURRENT and nominal.digest:
            values = as_commanded(values, nominal.digest.current_reading)
        good = np.isfinite(values)
        if np.count_nonzero(good) < FEWEST:
            continue
        observed[channel] = np.where(good, values, 0.0)
        valid[channel] = good
    if not observed:
        raise ValueError(f"{name}: no channel has {FEWEST} finite samples")
    comb = {}
    for channel in observed:
        values = recording[channel][valid[channel]]
        step = value_step(raw[channel][np.isfinite(raw[channel])])
        size = step / (np.log(10) * float(np.quantile(values, 0.1))) if channel == RESISTANCE else step
        if channel in nominal.noise and size > 2.0 * nominal.noise[channel].level:
            comb[channel] = step
    torn = _after_torn_steps(
        drive, nominal.model.scalars["thermal.time_constant"] / recording.sample_period_s
    )
    valid = {channel: good & (~torn | (channel == HEATER_CURRENT)) for channel, good in valid.items()}
    evident, flat = _evident(raw, recording.time_s, tuple(observed))
    for masks in flat.values():
        valid |= {channel: valid[channel] & ~mask for channel, mask in masks.items()}
    return Part(
        name, recording.time_s, recording.sample_period_s, current, tuple(observed), observed, valid,
        comb=comb, blind=blind, evident=evident, flat=flat,
    )  # fmt: skip


def _reads_whole_periods(recording: Recording) -> bool:
    """Whether the logged current is that of the period, and not of an instant that is before or behind the next command."""
    if clock_of(recording) is None:
        return jitter_of(recording.time_s) <= JITTERED
    placed, late = in_order(recording.with_unread())
    off = (placed[HEATER_CURRENT] - placed[COMMANDED_CURRENT]) ** 2
    early, after = (off[np.isfinite(off) & side] for side in (late < 0.0, late > 0.0))
    if min(early.size, after.size) < FEWEST:
        return False
    return bool(max(early.mean(), after.mean()) < WHOLE * min(early.mean(), after.mean()))


def _evident(
    raw: Recording, time_s: Floats, channels: Sequence[str]
) -> tuple[dict[tuple[str, str], Mapping[str, float]], dict[str, dict[str, NDArray[np.bool_]]]]:
    """What the values of each channel show by themselves, as they were recorded, see `Part.evident` and `Part.flat`.

    At times (n,) [s] between a sample that is flat and another there is no more than at the first.
    """
    found: dict[tuple[str, str], Mapping[str, float]] = {}
    flat: dict[str, dict[str, NDArray[np.bool_]]] = {}
    for record in effects().values():
        for channel in (c for c in channels if c in record.channels and "evident" in record.hooks):
            good = np.isfinite(raw[channel])
            shown = record.hooks["evident"](raw[channel][good])
            if shown is None:
                continue
            found[record.id, channel] = shown[0]
            if np.any(shown[1]):
                mask = np.interp(time_s, raw.time_s[good], shown[1].astype(float)) > FLAT
                flat.setdefault(record.id, {})[channel] = mask
    return found, flat


def _after_torn_steps(drive: Floats, lag: float) -> NDArray[np.bool_]:
    """Samples (n,) that follow a step of the drive whose instant is missing, within `SETTLED` time constants of `lag` samples."""
    torn = np.zeros(drive.size, dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(drive))
    steps = np.abs(np.diff(drive[known])) > TORN * np.ptp(drive[known])
    for before, after in zip(known[:-1][steps], known[1:][steps], strict=True):
        if after > before + 1:
            torn[before + 1 : after + 1 + int(np.ceil(SETTLED * lag))] = True
    return torn


def _longest_blind(drive: Floats, nominal: Nominal, dt: float) -> tuple[tuple[int, int], ...]:
    """First and last sample, beyond which nothing is missing, of gaps in which the film could go anywhere and back."""
    missing = np.concatenate([[False], ~np.isfinite(drive), [False]])
    begin, end = (
        np.flatnonzero(np.diff(missing.astype(int)) == 1),
        np.flatnonzero(np.diff(missing.astype(int)) == -1),
    )
    long = max(BLIND, 0.5 * nominal.model.scalars["thermal.time_constant"] / dt)
    gaps = [(int(b), int(e)) for b, e in zip(begin, end, strict=True) if e - b > long]
    away = _turns if preset(nominal.device).has_body else _wanders
    return tuple((b, e) for b, e in gaps if away(drive, e - b))


def _turns(logged: Floats, samples: int) -> bool:
    """Whether a drive goes beyond both ends of so many missing samples, by `BEYOND` of its range, one time in ten.

    What stays between its ends leaves no memory of its own: a body smooths it, and a loop forgets all but extremes.
    """
    known = held(logged)
    if known.size < samples + 2:
        return True
    windows = np.lib.stride_tricks.sliding_window_view(known, samples + 2)
    first, last = windows[:, 0], windows[:, -1]
    beyond = np.maximum(
        windows.max(axis=1) - np.maximum(first, last), np.minimum(first, last) - windows.min(axis=1)
    )
    often = np.quantile(beyond, 0.9)
    return not often < BEYOND * np.ptp(known)


def _wanders(logged: Floats, samples: int) -> bool:
    """Whether a drive with no body behind it moves by more than `AWAY` of its range in so many samples, one time in ten."""
    moves = np.abs(logged[samples:] - logged[:-samples])
    often = np.nanquantile(moves, 0.9)
    return not often < AWAY * (np.nanmax(logged) - np.nanmin(logged))
