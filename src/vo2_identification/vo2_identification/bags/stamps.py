"""Stamps as they arrive, made strictly increasing: what is dropped, and what is missing."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from vo2_identification.bags.joint_state import Samples
from vo2_identification.bags.problems import Problem, limited

__all__ = ["find_gaps", "increasing_samples"]

_GAP_PERIODS = 1.5
_STRAY_SHARE = 0.02


def increasing_samples(topic: str, samples: Samples) -> tuple[NDArray[np.int64], list[Problem]]:
    """Return the indices of the samples to keep, and what was wrong with the others.

    An exact repeat of the previous sample (a plant in lockstep repeats itself until it is answered) is left out
    silently. A few stray stamps are left out one by one, as few as possible. More than 2 per cent mean that the
    clock was set back: then the longest stretch in order is kept, since hysteresis forbids mixing two runs.

    Parameters
    ----------
    topic : for the messages
    """
    stamp = samples.stamp_ns
    kept = np.flatnonzero(~_repeats(samples))
    steps = np.diff(stamp[kept])
    if np.all(steps > 0):
        return kept, []
    back = np.flatnonzero(steps <= 0) + 1
    longest = _longest_increasing(stamp[kept])
    dropped = np.setdiff1d(np.arange(kept.size), longest)
    if dropped.size <= max(3, _STRAY_SHARE * kept.size):
        found = [
            Problem(
                "non_monotonic",
                topic,
                "the stamp is out of order, the sample is left out",
                time_s=stamp[kept[k]] / 1e9,
                index=int(kept[k]),
            )
            for k in dropped
        ]
        return kept[longest], limited(found)
    bounds = np.concatenate(([0], back, [kept.size]))
    best = int(np.argmax(np.diff(bounds)))
    found = []
    for k in range(bounds.size - 1):
        first, last = kept[bounds[k]], kept[bounds[k + 1] - 1]
        span = (
            f"{bounds[k + 1] - bounds[k]} samples from {stamp[first] / 1e9:.9g} to {stamp[last] / 1e9:.9g} s"
        )
        if k == best:
            continue
        text = f"the stamp jumps back; of the stretches in order this one is shorter and left out: {span}"
        found.append(Problem("restart", topic, text, time_s=stamp[first] / 1e9, index=int(first)))
    return kept[bounds[best] : bounds[best + 1]], limited(found)


def find_gaps(topic: str, stamp_ns: NDArray[np.int64], index: NDArray[np.int64]) -> list[Problem]:
    """Return one problem per distance of neighbouring stamps above 1.5 median periods.

    Parameters
    ----------
    stamp_ns : (n,) increasing stamps [ns]
    index : (n,) their places in the topic
    topic : for the messages
    """
    if stamp_ns.size < 3:
        return []
    steps = np.diff(stamp_ns)
    period = float(np.median(steps))
    found = [
        Problem(
            "gap",
            topic,
            f"{steps[k] / 1e9:.6g} s without a sample, where one comes every {period / 1e9:.6g} s",
            time_s=stamp_ns[k] / 1e9,
            index=int(index[k]),
        )
        for k in np.flatnonzero(steps > _GAP_PERIODS * period)
    ]
    return limited(found)


def _repeats(samples: Samples) -> NDArray[np.bool_]:
    """Return which samples equal the one before in stamp and, bit for bit, in every value."""
    same = np.zeros(samples.stamp_ns.size, np.bool_)
    same[1:] = np.diff(samples.stamp_ns) == 0
    for name, values in samples.values.items():
        bits = values.view(np.int64)
        same[1:] &= (bits[1:] == bits[:-1]) & (samples.present[name][1:] == samples.present[name][:-1])
    return same


def _longest_increasing(stamp: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the indices of a longest strictly increasing subsequence (patience sorting)."""
    tails: list[int] = []
    holders: list[int] = []
    before = np.full(stamp.size, -1, np.int64)
    for k, value in enumerate(stamp.tolist()):
        place = bisect_left(tails, value)
        if place == len(tails):
            tails.append(value)
            holders.append(k)
        else:
            tails[place] = value
            holders[place] = k
        if place:
            before[k] = holders[place - 1]
    chain = [holders[-1]]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1], np.int64)
