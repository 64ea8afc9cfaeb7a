"""Known changes of a recording: behind the device on the response, before it on the drive that is stated.

Each is the inverse or the direct image of an effect, exact on the recording taken as straight lines between samples; its
strength is set so that the response (or the drive, in shares of its range) moves by a wanted amount.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.filters import after_steps, backlash, boxcar, lag, oscillator

__all__ = ["CHANGES", "Change", "changed", "largest_strength"]

Array = NDArray[np.floating]
FINE = 4
"""Parts of the sample period in which filters run."""
Alter = Callable[[Array, Array, float], Array]
"""(time from 0 [s] (n,), values (n,), strength) -> values."""


@dataclass(frozen=True)
class Change:
    """One change.

    Attributes
    ----------
    id : effect id of the contract
    family : of the contract; "sensor" and "clock" get the channel behind them
    alter : of the drive where `before`, else of the response
    parameter, unit : what the strength is; unit "response" for that of the channel
    most : largest strength: shares, shares of the recording's duration for times, of the range for others
    units : responses it applies to, empty for all
    fixed : sample period [s] -> what else a diagnosis is to find: name -> (value, unit)
    """

    id: str
    family: str
    alter: Alter
    parameter: str
    unit: str
    most: float
    before: bool = False
    units: tuple[str, ...] = ()
    fixed: Callable[[float], Mapping[str, tuple[float, str]]] = lambda period: {}


def _filtered(filter: Callable[[Array, float], Array]) -> Callable[[Array, Array], Array]:
    """Return a filter of values at their own times, run on a uniform fine grid."""

    def run(time: Array, values: Array) -> Array:
        step = float(np.median(np.diff(time))) / FINE
        grid = np.arange(0.0, time[-1] + step, step)
        return np.interp(time, grid, filter(np.interp(grid, time, values), step))

    return run


def _lag(t: Array, y: Array, strength: float) -> Array:
    return _filtered(lambda v, step: lag(v, step, strength))(t, y)


def _average(t: Array, y: Array, strength: float) -> Array:
    return _filtered(lambda v, step: boxcar(v, step, strength))(t, y)


def _late(t: Array, y: Array, strength: float) -> Array:
    return np.interp(t - strength, t, y)


def _early(t: Array, drive: Array, strength: float) -> Array:
    # the device answers to what was stated a dead time ago
    return np.interp(t + strength, t, drive)


def _drift(t: Array, y: Array, strength: float) -> Array:
    return np.asarray(y * (1 + strength * t / t[-1]))


def _wandering(t: Array, y: Array, strength: float) -> Array:
    return np.asarray(y + strength * t / t[-1])


def _undrifted(t: Array, drive: Array, strength: float) -> Array:
    return np.asarray(drive / (1 + strength * t / t[-1]))


def _clip(t: Array, y: Array, strength: float) -> Array:
    return np.minimum(y, y.max() - strength)


def _steps(t: Array, y: Array, strength: float) -> Array:
    return np.round(y / strength) * strength


def _creep(t: Array, y: Array, strength: float) -> Array:
    return y + strength * (_lag(t, y, t[-1] / 15) - y[0])


def _log_creep(t: Array, y: Array, strength: float) -> Array:
    onset = t[-1] / 300
    slow = _filtered(lambda v, step: after_steps(v, np.log1p(np.arange(v.size) * step / onset)))
    return y + strength * slow(t, y)


def _backlash(t: Array, y: Array, strength: float) -> Array:
    return np.asarray(backlash(y, strength))


def _ripple(t: Array, y: Array, strength: float) -> Array:
    return y + strength * np.sin(2 * np.pi * y / (np.ptp(y) / 7.3))


def _of_mode(period: float) -> dict[str, tuple[float, str]]:
    return {"frequency": (0.08 / period, "Hz"), "damping_ratio": (0.02, "1")}


def _mode(t: Array, y: Array, strength: float) -> Array:
    of = _of_mode(float(np.median(np.diff(t))))
    frequency, damping = of["frequency"][0], of["damping_ratio"][0]
    ring = _filtered(lambda v, step: np.asarray(oscillator(v, step, frequency, damping)))
    return y + strength * (ring(t, y) - y)


CHANGES = (
    Change("sensor_lag", "sensor", _lag, "time_constant", "s", 0.02),
    Change("averaging", "sensor", _average, "length", "s", 0.03),
    Change("clock_offset", "clock", _late, "delay", "s", 0.02),
    Change("sensor_gain_drift", "sensor", _drift, "total_change", "1", 0.5),
    Change("sensor_zero_drift", "sensor", _wandering, "total_change", "response", 0.3),
    Change("adc_saturation", "sensor", _clip, "cut", "response", 0.3),
    Change("adc_quantization", "sensor", _steps, "least_bit", "response", 0.12),
    Change("sensor_ripple", "sensor", _ripple, "amplitude", "response", 0.1),
    Change("creep", "structure", _creep, "share", "1", 0.5, units=("m",)),
    Change("log_creep", "structure", _log_creep, "share", "1", 0.2, units=("m",)),
    Change("backlash", "structure", _backlash, "half_width", "m", 0.15, units=("m",)),
    Change("cantilever_resonance", "structure", _mode, "share", "1", 1.0, units=("m",), fixed=_of_mode),
    Change("series_resistance", "film", lambda t, y, r: y + r, "resistance", "ohm", 0.5, units=("ohm",)),
    Change(
        "leakage_resistance", "film", lambda t, y, g: y / (1 + g * y), "conductance", "S", 2.0, units=("ohm",)
    ),
    Change("dead_time", "drive", _early, "delay", "s", 0.02, before=True),
    Change("drive_gain_drift", "drive", _undrifted, "total_change", "1", 0.5, before=True),
)
"""A limit or a slew rate of the drive is left out: where it acts, what was asked for is lost and cannot be stated; a dead
zone too: it is no more than an offset where the drive keeps its sign."""


def largest_strength(change: Change, since: Array, values: Array) -> float:
    """Return the largest strength of a change in its own unit.

    Parameters
    ----------
    change : the change
    since : (n,) time from the start [s]
    values : (n,) of what it acts on
    """
    unit = {"s": float(since[-1]), "1": 1.0, "S": float(1 / np.max(np.abs(values)))}
    return change.most * unit.get(change.unit, float(np.ptp(values)))


def changed(
    change: Change, time: Array, values: Array, wanted: float, measure: Callable[[Array], float]
) -> tuple[Array, float]:
    """Return the altered values and the strength at which `measure` of them comes nearest to `wanted`.

    Strengths up to the change's largest are searched over nine decades, by bisection: every change grows with its own.
    """
    since = time - time[0]
    largest = largest_strength(change, since, values)
    low, high = -9.0, 0.0
    for _ in range(40):
        middle = (low + high) / 2
        if measure(change.alter(since, values, largest * 10**middle)) < wanted:
            low = middle
        else:
            high = middle
    strength = largest * 10**low
    return change.alter(since, values, strength), strength
