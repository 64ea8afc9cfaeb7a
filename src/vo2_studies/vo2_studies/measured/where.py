"""Where a model misses: the energy of a gap over the time since the pulse, its lines in the spectrum, its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from vo2_studies.measured.cases import Case
from vo2_studies.measured.fitting import CandidateFit

__all__ = ["Line", "decades", "line_of", "rms_over_time"]

Floats = NDArray[np.float64]
LEAST_CYCLES = 5.0
"""Periods that a recording must hold of a line; what is slower is a course, not a line."""
STANDS_OUT = 30.0
"""Power of a line over the median power of the spectrum."""


@dataclass(frozen=True)
class Line:
    """Periodic part of what a model leaves over.

    Attributes
    ----------
    frequency_hz : where it is
    amplitude : of the sinusoid [judged unit]
    recordings : number of recordings that show it
    """

    frequency_hz: float
    amplitude: float
    recordings: int


def rms_over_time(
    pairs: Sequence[tuple[CandidateFit, Sequence[Case]]], edges: Floats
) -> tuple[Floats, Floats]:
    """Root mean square of the gap (b,) and number of samples (b,) between edges (b + 1,) of the time since the pulse."""
    total, count = np.zeros(edges.size - 1), np.zeros(edges.size - 1)
    for fit, cases in pairs:
        for case in cases:
            gap = fit.gap(case)
            good = np.isfinite(gap) & np.isfinite(case.since_s)
            place = np.searchsorted(edges, case.since_s[good], side="right") - 1
            inside = (place >= 0) & (place < total.size)
            total += np.bincount(place[inside], gap[good][inside] ** 2, minlength=total.size)
            count += np.bincount(place[inside], minlength=total.size)
    return np.sqrt(total / np.maximum(count, 1.0)), count


def decades(cases: Sequence[Case], *, per_decade: int = 2) -> Floats:
    """Edges [s] of equal parts of the logarithm of the time since the pulse, over all judged samples."""
    times = np.concatenate(
        [case.since_s[np.isfinite(case.recording[case.channel]) & (case.since_s > 0.0)] for case in cases]
    )
    low, high = np.floor(per_decade * np.log10(times.min())), np.ceil(per_decade * np.log10(times.max()))
    return np.asarray(10.0 ** (np.arange(low, high + 1.0) / per_decade))


def line_of(fit: CandidateFit, cases: Sequence[Case]) -> Line | None:
    """The strongest line in the second half of the recordings, if it stands out in at least half of them.

    Parameters
    ----------
    fit : whose gap is looked at
    cases : with all samples judged there
    """
    found: list[tuple[float, float]] = []
    for case in cases:
        gap = fit.gap(case)
        tail = gap[gap.size // 2 :]
        if not np.all(np.isfinite(tail)):
            continue
        dt = case.recording.sample_period_s
        # a slow course is taken out first: the difference of neighbours weighs it down
        frequency, power = welch(tail, fs=1.0 / dt, nperseg=tail.size, detrend="linear")
        usable = frequency > LEAST_CYCLES / (tail.size * dt)
        if np.count_nonzero(usable) < 8:
            continue
        k = int(np.argmax(np.where(usable, power, 0.0)))
        if power[k] > STANDS_OUT * float(np.median(power[usable])):
            found.append((float(frequency[k]), float(np.sqrt(2.0 * 1.5 * power[k] * frequency[1]))))
    if 2 * len(found) < len(cases) or not found:
        return None
    middle = float(np.median([f for f, _ in found]))
    alike = [(f, a) for f, a in found if abs(f - middle) < 0.05 * middle]
    if 2 * len(alike) < len(cases):
        return None
    return Line(middle, float(np.median([a for _, a in alike])), len(alike))
