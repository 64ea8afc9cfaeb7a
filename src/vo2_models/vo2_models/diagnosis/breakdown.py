"""Where the excess residual sits: channel, time, branch, temperature, frequency, amplitude and reversal order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from vo2_models.device import surrogate_of_temperature
from vo2_models.device.description import DeviceDescription
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.diagnosis.result import Location
from vo2_models.numerics.kernel import kernel

__all__ = ["Breakdown", "branch_words", "breakdown", "locate", "one_loop", "turning_points"]

Floats = NDArray[np.float64]
DEPTH = 64
"""Turning points that are remembered; beyond, the oldest inner loop is forgotten."""
ROUNDING = 1e-9
"""Relative distance of two edges that are one."""
BLOCKS = 40
"""Pieces of a recording in which the energy over time is told."""
MOVES = 0.02
"""Rate of temperature, of that of the fastest twentieth, below which a sample is at rest: settling is no branch."""


@dataclass(frozen=True)
class Breakdown:
    """Excess energy of one channel (residual energy minus noise floor), along several axes.

    Every axis holds the same total: `energy` sums over bins to `excess` of the channel.

    Attributes
    ----------
    channel : name
    excess : excess energy, in units of the noise power
    floor : energy that noise alone has, the same
    moving : samples that count while heating, and while cooling
    axes : axis -> (edges (b + 1,) or labels, energy (b,)); axes are time, branch, temperature, amplitude,
        reversals, frequency
    """

    channel: str
    excess: float
    floor: float
    moving: tuple[int, int]
    axes: Mapping[str, tuple[Sequence[float] | Sequence[str], Floats]]


def branch_words(device: DeviceDescription) -> dict[str, str]:
    """Return what each branch is called on a device: without a heated body nothing heats, the drive rises and falls."""
    first, last = device.operating_range
    ways = ("rising", "falling") if first < last else ("falling", "rising")
    heating, cooling = ("heating", "cooling") if device.has_body else ways
    return {"heating": heating, "cooling": cooling, "held": "held"}


def breakdown(problem: LinearisedProblem, residual: Floats, *, floor: float = 1.0) -> list[Breakdown]:
    """Split the excess energy of a whitened residual (N,) along every axis, channel by channel.

    Energy is that of the residual itself over the channel's noise power: of the innovations, a channel whose noise is
    slow would seem to have less of a slow excess than it has. A sample counts by its weight. Only the spectrum is that
    of the innovations, above whose flat floor a line stands out.

    Parameters
    ----------
    problem : the problem
    residual : (N,) whitened, what is split
    floor : energy per sample that is noise: 1 for a residual, 0 for what a model says

    Returns
    -------
    one per channel
    """
    found = []
    for channel in dict.fromkeys(row.channel for row in problem.rows):
        pieces: dict[str, list[NDArray]] = {
            k: [] for k in ("energy", "time", "heating", "temperature", "amplitude", "order")
        }
        spectrum: Floats | None = None
        frequencies = np.zeros(0)
        offset = 0.0
        for row, part, response in problem.iterate():
            if row.channel != channel:
                continue
            e, w = residual[row.where], problem.weight[row.where]
            counts, noise = w > 0, problem.nominal.noise[channel]
            plain = noise.color(e / np.where(counts, w, 1.0)) / noise.level
            energy = np.where(counts, (w * plain) ** 2 - floor, 0.0)
            direction, amplitude, order = _history(response.temperature)
            pieces["energy"].append(energy)
            pieces["time"].append(part.time_s - part.time_s[0] + offset)
            pieces["heating"].append(direction)
            pieces["temperature"].append(response.temperature)
            pieces["amplitude"].append(amplitude)
            pieces["order"].append(order)
            offset += part.time_s[-1] - part.time_s[0] + part.dt
            frequency, power = welch(e, fs=1.0 / part.dt, nperseg=min(1024, part.size), detrend=False)
            share = power / max(float(np.sum(power)), 1e-300) * float(np.sum(e**2))
            above = np.maximum(share - floor * np.count_nonzero(w) / power.size, 0.0)
            if spectrum is None:
                spectrum, frequencies = above, frequency
            else:
                spectrum = spectrum + np.interp(frequencies, frequency, above)
        if spectrum is None:
            raise ValueError(f"{channel}: found no samples, need some")
        joined = {k: np.concatenate(v) for k, v in pieces.items()}
        energy, order = joined["energy"], np.minimum(joined["order"], 4)
        total = float(np.sum(energy))
        scale = total / max(float(np.sum(spectrum)), 1e-300)
        axes: dict[str, tuple[Sequence[float] | Sequence[str], Floats]] = {
            "time": _binned(joined["time"], energy, BLOCKS),
            "temperature": _binned(joined["temperature"], energy, 24),
            "amplitude": _binned(joined["amplitude"], energy, 12),
            "branch": (
                tuple(branch_words(problem.nominal.model.description).values()),
                np.array([np.sum(energy[joined["heating"] == s]) for s in (1, -1, 0)]),
            ),
            "reversals": (
                ("major", "1", "2", "3", "4 and more"),
                np.array([np.sum(energy[order == k]) for k in range(5)]),
            ),
            "frequency": (frequencies.tolist(), spectrum * max(scale, 0.0)),
        }
        heating, cooling = (int(np.count_nonzero(energy[joined["heating"] == s])) for s in (1, -1))
        found.append(Breakdown(channel, total, float(np.count_nonzero(energy)), (heating, cooling), axes))
    return found


def _binned(x: Floats, energy: Floats, bins: int) -> tuple[list[float], Floats]:
    edges = np.linspace(float(np.min(x)), float(np.max(x)) + 1e-12, bins + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    return edges.tolist(), np.asarray(np.bincount(place, weights=energy, minlength=bins), dtype=np.float64)


def _history(temperature: Floats) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
    """Direction (+1, -1, 0 at rest), distance from the last turning point [K], and open reversals, per sample."""
    last, _, order = _turns(np.ascontiguousarray(temperature), 1e-3 * max(float(np.ptp(temperature)), 1e-9))
    rate = np.gradient(temperature)
    fastest = np.quantile(np.abs(rate), 0.95)
    moves = np.abs(rate) > MOVES * fastest
    return np.where(moves, np.sign(rate), 0.0).astype(np.int64), np.abs(temperature - last), order


def one_loop(paths: Sequence[Floats], periods: Sequence[float], limits: Limits) -> bool:
    """Return whether these paths of the film are one and the same loop.

    They are where they turn at fewer than `levels` temperatures and no crossing of the range is `rates` times as fast as
    another: there is one history then, and an error in the loop's shape, a lag and a drift can hardly be told apart.

    Parameters
    ----------
    paths : temperatures (n,) of each recording [degC]
    periods : their sample periods [s]
    limits : `crosses`, `turns_apart`, `levels` and `rates`
    """
    low, high = (float(end(np.concatenate(paths))) for end in (np.min, np.max))
    span, middle = max(high - low, 1e-9), 0.5 * (low + high)
    turns: list[float] = []
    rates: list[float] = []
    for path, period in zip(paths, periods, strict=True):
        last = turning_points(path)[0]
        rate = np.abs(np.gradient(path)) / period
        inside = 2.0 * np.abs(path - middle) < limits.crosses * span
        for piece in np.split(np.arange(path.size), np.flatnonzero(np.diff(last)) + 1):
            level = float(last[piece[0]])
            if all(abs(level - other) > limits.turns_apart * span for other in turns):
                turns.append(level)
            if np.ptp(path[piece]) > limits.crosses * span and np.any(inside[piece]):
                rates.append(float(np.median(rate[piece][inside[piece]])))
    return len(turns) < limits.levels and max(rates, default=0.0) <= limits.rates * min(rates, default=0.0)


def turning_points(temperature: Floats) -> tuple[Floats, Floats]:
    """Return the last turning point, and the one still remembered before it, per sample (n,) [degC].

    Parameters
    ----------
    temperature : (n,) of the film [degC]
    """
    last, before, _ = _turns(np.ascontiguousarray(temperature), 1e-3 * max(float(np.ptp(temperature)), 1e-9))
    return last, before


@kernel(nogil=True)
def _turns(temperature, dead):
    n = temperature.size
    last = np.empty(n)
    before = np.empty(n)
    order = np.zeros(n, np.int64)
    turns = np.empty(DEPTH)
    turns[0] = temperature[0]
    depth = 1
    extreme = temperature[0]
    going = 0
    for k in range(n):
        x = temperature[k]
        if going == 0:
            if abs(x - turns[0]) > dead:
                going = 1 if x > turns[0] else -1
                extreme = x
        elif (x - extreme) * going > 0:
            extreme = x
            while depth > 2 and (x - turns[depth - 2]) * going >= 0:
                depth -= 2
        elif (extreme - x) * going > dead:
            if depth == DEPTH:
                turns[1 : DEPTH - 2] = turns[3:DEPTH]
                depth -= 2
            turns[depth] = extreme
            depth += 1
            extreme = x
            going = -going
        last[k] = turns[depth - 1]
        before[k] = turns[max(depth - 2, 0)]
        order[k] = max(depth - 2, 0)
    return last, before, order


def locate(problem: LinearisedProblem, parts: Sequence[Breakdown], limits: Limits) -> list[Location]:
    """Summarise a breakdown per channel, most excess first; return shares that add up to one over the channels with an excess.

    Parameters
    ----------
    problem : of the recordings
    parts : as `breakdown` returns them
    limits : when one branch is the place
    """
    positive = [b for b in parts if b.excess > 0]
    total = sum(b.excess for b in positive)
    found = []
    for b in sorted(positive, key=lambda b: -b.excess):
        time = _spans(*b.axes["time"])  # type: ignore[arg-type]
        low, high = _middle(*b.axes["temperature"])  # type: ignore[arg-type]
        frequency = _middle(b.axes["frequency"][0], b.axes["frequency"][1])  # type: ignore[arg-type]
        surrogate = sorted(surrogate_of_temperature(problem.nominal.device, [low, high]).tolist())
        found.append(
            Location(
                signal=b.channel,
                share=float(b.excess / total),
                time_s=time,
                branch=_branch(
                    limits.one_branch, *np.maximum(b.axes["branch"][1][:2], 0.0) / np.maximum(b.moving, 1)
                ),
                temperature_degC=[low, high],
                temperature_surrogate_a=[float(v) for v in surrogate],
                frequency_hz=list(frequency),
            )
        )
    return found


def _branch(least: float, heating: float, cooling: float) -> Literal["heating", "cooling", "both"]:
    """Which branch is the place, by its energy per sample: how long each of them took says nothing."""
    if heating > least * cooling:
        return "heating"
    return "cooling" if cooling > least * heating else "both"


def _spans(edges: Sequence[float], energy: Floats) -> list[list[float]]:
    """The fewest bins that hold four fifths of the positive energy, neighbours joined."""
    positive = np.maximum(energy, 0.0)
    order = np.argsort(positive)[::-1]
    held = np.cumsum(positive[order])
    needed = int(np.searchsorted(held, 0.8 * held[-1])) + 1
    chosen = np.sort(order[:needed])
    spans: list[list[float]] = []
    for k in chosen:
        if spans and abs(spans[-1][1] - edges[k]) < ROUNDING * max(abs(edges[-1]), 1.0):
            spans[-1][1] = float(edges[k + 1])
        else:
            spans.append([float(edges[k]), float(edges[k + 1])])
    return spans


def _middle(edges: Sequence[float], energy: Floats) -> tuple[float, float]:
    """Range between the 10 % and 90 % points of the positive energy."""
    positive = np.cumsum(np.maximum(energy, 0.0))
    if positive[-1] <= 0:
        return float(edges[0]), float(edges[-1])
    low, high = (int(np.searchsorted(positive, q * positive[-1])) for q in (0.1, 0.9))
    last = len(edges) - 1
    return float(edges[low]), float(edges[min(high + (1 if len(edges) > energy.size else 0), last)])
