"""Inputs that make a hysteretic device show what it is: sequences of levels, and their expansion in time.

The sequences (`damped_oscillation`, `first_order_reversal_fan`, `random_levels`, ...) are plain arrays of
levels, in whatever unit the input has; a rate-independent model needs no more. An `Excitation` adds how
long each level is approached and held, so that it can be played to a device, and writes itself to and
from plain dictionaries.

>>> fan = first_order_reversal_fan(np.linspace(0.0, 1.0, 4))
>>> Excitation.at_rate(fan, rate_per_s=2.0, hold_s=0.1).sample(0.05).size
72
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.validation import finite_array, increasing, nonnegative, positive_number

__all__ = [
    "Excitation",
    "chirp",
    "composite_recording",
    "damped_oscillation",
    "first_order_reversal_fan",
    "random_levels",
]

Floats = NDArray[np.float64]
_CHIRP = 0.04
"""Amplitude of a chirp of `composite_recording`, as a share of the range."""


def _walls(walls: ArrayLike) -> Floats:
    array = increasing(finite_array(walls, "walls"), "walls")
    if array.size < 2:
        raise ValueError(f"walls: found {array.size} value(s), need at least 2 (one cell)")
    return array


def damped_oscillation(walls: ArrayLike, *, reversals_only: bool = False) -> Floats:
    """Return nested loops that stop at every cell wall: section 4.1, Fig. 4.2.

    The input starts at the lowest wall (negative saturation), rises wall by wall to the highest, falls to
    the second lowest, and so on: 1 + L + (L - 1) + ... + 1 = L (L + 1) / 2 + 1 levels, as many as a Preisach
    operator of level L has densities and bias, and the matrix of signed areas is square and regular. With a linear
    term, (4.19), append one level outside the walls: on the walls it cannot be told from the diagonal cells.

    Parameters
    ----------
    walls : (L + 1,) increasing input levels, the walls of the cells
    reversals_only : keep only the L + 1 turning points

    Raises
    ------
    ValueError : `walls` not finite, not increasing, or fewer than two.
    """
    array = _walls(walls)
    low, high = 0, array.size - 1
    index = [np.array([0])]
    while low < high:
        index.append(np.arange(low + 1, high + 1))
        low += 1
        if low < high:
            index.append(np.arange(high - 1, low - 1, -1))
            high -= 1
    if reversals_only:
        index = [leg[-1:] for leg in index]
    return array[np.concatenate(index)]


def first_order_reversal_fan(walls: ArrayLike, *, reversals_only: bool = False) -> Floats:
    """Return first-order reversal curves: from the top down to each wall in turn, and back up wall by wall.

    Starts at the lowest wall, so that the memory before it does not matter. Exciting every cell, like
    `damped_oscillation`, but with only one reversal per curve: an error of one curve does not spread.

    Parameters
    ----------
    walls : (L + 1,) increasing input levels; reversals happen at all but the highest
    reversals_only : keep only the turning points

    Raises
    ------
    ValueError : `walls` not finite, not increasing, or fewer than two.
    """
    array = _walls(walls)
    top = array.size - 1
    index = [np.array([0, top])]
    for turn in range(top - 1, -1, -1):
        up = np.array([top]) if reversals_only else np.arange(turn + 1, top + 1)
        index += [np.array([turn]), up]
    return array[np.concatenate(index)]


def random_levels(low: float, high: float, count: int, *, seed: int | np.random.Generator) -> Floats:
    """Return `count` independent levels, uniform between `low` and `high` (either may be the larger).

    Parameters
    ----------
    low, high : ends of the range [unit of the input]
    count : number of levels
    seed : seed, or generator to draw from
    """
    if count < 1:
        raise ValueError(f"count: found {count}, need at least 1")
    return low + (high - low) * np.random.default_rng(seed).random(count)


def chirp(
    centre: float,
    amplitude: float,
    frequency_hz: tuple[float, float],
    duration_s: float,
    sample_period_s: float,
) -> Floats:
    """Return a sine of exponentially rising frequency, one level per sample period.

    Parameters
    ----------
    centre, amplitude : [unit of the input]
    frequency_hz : first and last frequency
    duration_s : length [s]
    sample_period_s : [s]

    Raises
    ------
    ValueError : a frequency not above zero or above half the sampling rate.
    """
    first, last = (positive_number(f, "frequency_hz") for f in frequency_hz)
    nyquist = 0.5 / positive_number(sample_period_s, "sample_period_s")
    if max(first, last) > nyquist:
        raise ValueError(
            f"frequency_hz: found {max(first, last):g}, need at most half the sampling rate, {nyquist:g} Hz"
        )
    time = np.arange(round(positive_number(duration_s, "duration_s") / sample_period_s)) * sample_period_s
    growth = np.log(last / first) / duration_s
    phase = first * time if abs(growth) * duration_s < 1e-9 else first * np.expm1(growth * time) / growth
    return np.asarray(centre + amplitude * np.sin(2 * np.pi * phase), dtype=np.float64)


@dataclass(frozen=True)
class Excitation:
    """Levels with their timing: each is approached along a straight line, then held.

    Attributes
    ----------
    levels : (n,) input levels, in the unit of the input
    ramp_s : (n,) time to go from the level before to this one [s], 0 for a step
    hold_s : (n,) time to stay [s]
    segments : (name, first, last + 1) of the levels that belong together, for reports and for splitting
        a recording into blocks

    Raises
    ------
    ValueError : shapes differ, a value is not finite, a time is negative, or the whole lasts no time.
    """

    levels: Floats
    ramp_s: Floats
    hold_s: Floats
    segments: tuple[tuple[str, int, int], ...] = ()

    def __post_init__(self) -> None:
        levels = finite_array(self.levels, "levels")
        if levels.size == 0:
            raise ValueError("levels: found none, need at least 1")
        object.__setattr__(self, "levels", levels)
        for name in ("ramp_s", "hold_s"):
            times = np.broadcast_to(finite_array(getattr(self, name), name, ndim=(0, 1)), levels.shape)
            object.__setattr__(self, name, nonnegative(np.ascontiguousarray(times), name))
        positive_number(self.duration_s, "ramp_s + hold_s, summed")
        object.__setattr__(self, "segments", tuple((str(n), int(a), int(b)) for n, a, b in self.segments))

    @classmethod
    def at_rate(
        cls, levels: ArrayLike, *, rate_per_s: float, hold_s: float = 0.0, name: str = ""
    ) -> Excitation:
        """Approach each level at the same rate [input unit per s]; the first is there at once."""
        array = finite_array(levels, "levels")
        ramp = np.abs(np.diff(array, prepend=array[:1])) / positive_number(rate_per_s, "rate_per_s")
        return cls(array, ramp, np.full(array.size, float(hold_s)), ((name, 0, array.size),))

    @classmethod
    def joined(cls, parts: Iterable[Excitation]) -> Excitation:
        """Play several one after the other."""
        every = list(parts)
        segments, first = [], 0
        for part in every:
            segments += [(name, first + a, first + b) for name, a, b in part.segments]
            first += part.levels.size
        return cls(
            np.concatenate([part.levels for part in every]),
            np.concatenate([part.ramp_s for part in every]),
            np.concatenate([part.hold_s for part in every]),
            tuple(segments),
        )

    @property
    def duration_s(self) -> float:
        """Length of the whole [s]."""
        return float(np.sum(self.ramp_s) + np.sum(self.hold_s))

    def _index(self, time: Floats, sample_period_s: float) -> tuple[NDArray[np.intp], Floats]:
        ends = np.cumsum(self.ramp_s + self.hold_s)
        # a level that starts at a sample instant counts from that sample on, whatever the rounding of sums
        index = np.searchsorted(ends, time + 1e-6 * sample_period_s, side="right")
        index = np.minimum(index, ends.size - 1)
        return index, time - (ends - self.ramp_s - self.hold_s)[index]

    def _time(self, sample_period_s: float) -> Floats:
        period = positive_number(sample_period_s, "sample_period_s")
        count = max(1, int(np.ceil(self.duration_s / period - 1e-6)))
        return np.asarray(np.arange(count) * period, dtype=np.float64)

    def sample(self, sample_period_s: float) -> Floats:
        """Return the level commanded at 0, 1, 2, ... sample periods, up to the end (n,)."""
        time = self._time(sample_period_s)
        index, since = self._index(time, sample_period_s)
        ramp = self.ramp_s[index]
        share = np.divide(since, ramp, out=np.ones_like(since), where=ramp > 0)
        before = np.concatenate([self.levels[:1], self.levels])[index]
        share = np.clip(share, 0.0, 1.0)
        return np.asarray(before * (1 - share) + self.levels[index] * share, dtype=np.float64)


def composite_recording(
    cold: float,
    hot: float,
    *,
    transition: tuple[float, float],
    duration_s: float,
    sample_period_s: float,
    seed: int | np.random.Generator = 0,
) -> Excitation:
    """Return the shortest kind of recording on which every known effect leaves a mark of its own.

    Two major loops (at the start and at the end, so that drift shows), steps of several sizes up and down,
    a first-order reversal fan, small chirps below, inside and above the transition, random levels, and two
    holds (one below, one inside the transition, so that creep and relaxation part).

    Parameters
    ----------
    cold, hot : the ends of the operating range, in the unit of the input; `hot` may be the smaller one
    transition : where the transition starts and ends, in the same unit, between `cold` and `hot`
    duration_s : length of the whole [s]; the segments share it in fixed proportions
    sample_period_s : sampling of the device [s], which limits the chirps
    seed : for the random levels

    Raises
    ------
    ValueError : `transition` outside the range or in the wrong order, or a recording of fewer than 500 samples.
    """
    span = float(hot) - float(cold)
    begin, end = ((float(level) - cold) / span if span else 0.0 for level in transition)
    if not (span and 0.0 <= begin < end <= 1.0):
        raise ValueError(
            f"transition: found {tuple(transition)}, need two levels in the order from cold {cold:g} to hot {hot:g}"
        )
    if duration_s < 500 * sample_period_s:
        raise ValueError(
            f"duration_s: found {duration_s:g} s at a sample period of {sample_period_s:g} s, need 500 samples"
        )
    middle = 0.5 * (begin + end)

    def paced(levels: ArrayLike, share: float, name: str) -> Excitation:
        array = cold + span * np.asarray(levels, dtype=np.float64)
        travel = float(np.sum(np.abs(np.diff(array))))
        return Excitation.at_rate(array, rate_per_s=travel / (share * duration_s), name=name)

    def stepped(levels: ArrayLike, share: float, name: str) -> Excitation:
        array = cold + span * np.asarray(levels, dtype=np.float64)
        hold = np.full(array.size, share * duration_s / array.size)
        return Excitation(array, np.zeros(array.size), hold, ((name, 0, array.size),))

    def shaken(centre: float, name: str) -> Excitation:
        length = 0.05 * duration_s
        # from three cycles per chirp to 0.4 of the sampling rate
        band = 3.0 / length, 0.4 / sample_period_s
        wave = chirp(cold + span * centre, _CHIRP * span, band, length, sample_period_s)
        return Excitation(
            wave, np.zeros(wave.size), np.full(wave.size, sample_period_s), ((name, 0, wave.size),)
        )

    steps = [
        level
        for share in (1.0, 0.5, 0.25, 0.1)
        for level in np.clip((middle - share / 2, middle + share / 2, middle - share / 2), 0.0, 1.0)
    ]
    fan = first_order_reversal_fan(np.r_[np.linspace(begin / 2, end, 8), 1.0], reversals_only=True)[1:]
    random = random_levels(0.0, 1.0, 60, seed=seed)
    margin = 1.5 * _CHIRP
    return Excitation.joined(
        [
            paced([0, 1, 0], 0.14, "major loop, start"),
            stepped(steps, 0.16, "steps"),
            paced(np.r_[0.0, fan], 0.2, "reversal fan"),
            shaken(max(margin, 0.5 * begin), "chirp, cold side"),
            shaken(middle, "chirp, inside the transition"),
            shaken(min(1 - margin, 0.5 * (1 + end)), "chirp, hot side"),
            stepped(random, 0.13, "random levels"),
            stepped([max(margin, 0.5 * begin)], 0.04, "hold, cold side"),
            stepped([middle], 0.04, "hold, inside the transition"),
            paced([0, 1, 0], 0.14, "major loop, end"),
        ]
    )
