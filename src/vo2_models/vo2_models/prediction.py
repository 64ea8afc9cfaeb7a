"""What a fitted model expects of a drive, with bounds, and how far a measurement is from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.model import DeviceModel
from vo2_models.identification.calibration_check import noise_level
from vo2_models.identification.grid import GriddedRecording, on_grid
from vo2_models.identification.loops_fit import SECTIONS, film_path
from vo2_models.identification.rig_start import unknown_until
from vo2_models.recording import (
    HEATER_CURRENT,
    JITTERED,
    RESISTANCE,
    Recording,
    aligned,
    clock_of,
    counted,
    jitter_of,
)

__all__ = ["ChannelPrediction", "Prediction", "predict"]

Floats = NDArray[np.float64]
_NORMAL_95 = 1.959964
"""Standard deviations that hold 95 % of a normal distribution."""
_RESTAMPED = 0.25
"""Share of the squared error that a drive which acts a period earlier or later must leave to be taken as stamped so."""
_BEGINNING = 0.1
_PLACES, _SMOOTHED = 401, 13
"""Places over the operating range at which a loop's slope is taken, and how many of them it is averaged over: 3 per cent."""


@dataclass(frozen=True)
class ChannelPrediction:
    """One response.

    Attributes
    ----------
    value, lower, upper : (n,) prediction and its bounds: 1.96 times the noise and what the law missed of held-out parts of
        its calibration, more of it where the loop is steep
    measured : (n,) or None
    error : root mean square of measured minus predicted, in judged units (log10 for the film response); NaN without
    span : of what was measured, in judged units; NaN without
    inside : share of the measured samples between the bounds; NaN without
    unknown : samples at the begin that error and share leave out: the drive does not show what state they begin at
    """

    value: Floats
    lower: Floats
    upper: Floats
    measured: Floats | None
    error: float
    span: float
    inside: float
    unknown: int = 0


@dataclass(frozen=True)
class Prediction:
    """Predicted responses along a drive.

    Attributes
    ----------
    time_s : (n,) stamps [s]: those of the recording, where one is missing between its neighbours; the instants of a clock that
        it follows
    drive : (n,) what drove the model, in the drive's unit
    channels : role -> prediction
    settled : whether the model was started settled at the first drive instead of from a cold rest
    late : time after where it stands in the recording at which the drive was taken to act [s]: a sample period, or one before
        (negative), where only that makes the measured responses follow
    """

    time_s: Floats
    drive: Floats
    channels: Mapping[str, ChannelPrediction]
    settled: bool
    late: float = 0.0


def predict(model: DeviceModel, recording: Recording) -> Prediction:
    """Run a model on the drive of a recording and compare with the responses that it has.

    Parameters
    ----------
    model : fitted
    recording : in roles; at least a drive. Its command delay is the model's

    Returns
    -------
    Predicted responses with their bounds, on the regular grid of the recording.

    Raises
    ------
    ValueError : no drive, fewer than 16 samples, or gaps that are too long.
    """
    grid = on_grid(aligned(recording, model.command_delay))
    roles = [role for role in model.description.channels if role != HEATER_CURRENT and _has(model, role)]

    def drive(periods: int) -> Floats:
        return grid.current[np.clip(np.arange(grid.current.size) - periods, 0, grid.current.size - 1)]

    def simulated(settled: bool, periods: int = 0) -> dict[str, Floats]:
        run = model.simulate(drive(periods), dt=grid.dt, noise=False, settled=settled)
        return {role: _judged(role, run[role]) for role in roles}

    def apart(outputs: Mapping[str, Floats], share: float) -> float:
        """Squared error over the beginning of the recording, summed over its responses, each over its variance."""
        count = max(int(share * grid.current.size), 8)
        return sum(
            float(np.nanmean((grid.measured[role][:count] - outputs[role][:count]) ** 2))
            / float(np.nanvar(grid.measured[role]) or 1.0)
            for role in roles
            if role in grid.measured and np.isfinite(grid.measured[role][:count]).any()
        )

    settled = not model.heats
    outputs = simulated(settled)
    if model.heats and any(role in grid.measured for role in roles):
        other = simulated(True)
        settled = apart(other, _BEGINNING) < apart(outputs, _BEGINNING)
        outputs = other if settled else outputs
    periods = 0
    if model.description.has_body and any(role in grid.measured for role in roles):
        # a rig may stamp its drive at the other end of the interval
        shifted = {k: simulated(settled, k) for k in (-1, 1)}
        best = min(shifted, key=lambda k: apart(shifted[k], 1.0))
        if apart(shifted[best], 1.0) < _RESTAMPED * apart(outputs, 1.0):
            periods, outputs = best, shifted[best]
    path = film_path(model, [replace(grid, current=drive(periods))], settled)[1:]
    return Prediction(
        _stamps(recording, grid),
        drive(periods),
        {
            role: _compared(
                model,
                role,
                outputs[role],
                grid.measured.get(role),
                drive(periods),
                _NORMAL_95 * _size(model, role, path),
            )
            for role in roles
        },
        settled,
        periods * grid.dt,
    )


def _stamps(recording: Recording, grid: GriddedRecording) -> Floats:
    """Stamps (n,) of a grid's instants [s]: who begins to count anew behind a late sample drifts away from regular ones."""
    known = recording.with_unread()
    instants = np.arange(grid.current.size, dtype=np.float64)
    place = counted(known.time_s)[2]
    if clock_of(known) or jitter_of(known.time_s) > JITTERED or place[-1] != instants[-1]:
        return grid.start + grid.dt * instants
    return np.interp(instants, place, known.time_s)


def _size(model: DeviceModel, role: str, path: Floats) -> Floats:
    """One standard deviation (n,) of a sample about its prediction, in judged units.

    The held-out misfit (the fit's own residual where that was not tried) is that of a whole calibration. A loop that is a
    little out of place misses by its slope, so that a drive which stays where the loop is steep misses by more than that;
    where it is flat, what the calibration missed is kept.
    """
    sensor = model.sensors.get(role)
    if sensor is None:
        return np.zeros(path.size)
    noise = noise_level(role, sensor.noise)
    wrong = float(np.sqrt(max((sensor.misfit or sensor.residual) ** 2 - noise**2, 0.0)))
    return np.hypot(noise, wrong * np.hypot(1.0, _steepness(model, role, path)))


def _steepness(model: DeviceModel, role: str, path: Floats) -> Floats:
    """Slope (n,) of a response's major loop along a path, mean of both branches, over its r.m.s. over the operating range."""
    device = model.description
    low, high = sorted(device.steady_temperature(drive) for drive in device.operating_range)
    # heat that a fit has found has a scale of its own
    if role not in SECTIONS or (model.heats and not device.has_body):
        return np.zeros(path.size)
    there = np.linspace(low, high, _PLACES)
    rising, falling = np.split(getattr(model, SECTIONS[role]).run(np.concatenate([there, there[::-1]])), 2)
    slope = 0.5 * (np.abs(np.gradient(rising)) + np.abs(np.gradient(falling[::-1])))
    beside = np.pad(slope, _SMOOTHED // 2, mode="edge")
    slope = np.convolve(beside, np.full(_SMOOTHED, 1.0 / _SMOOTHED), "valid")
    mean = float(np.sqrt(np.mean(slope**2)))
    return np.interp(path, there, slope / mean) if mean else np.zeros(path.size)


def _compared(
    model: DeviceModel, role: str, value: Floats, measured: Floats | None, drive: Floats, bound: Floats
) -> ChannelPrediction:
    error = span = inside = float("nan")
    unknown = 0
    if measured is not None:
        unknown = 0 if model.heats else unknown_until(measured - value, value, drive)
        good = np.isfinite(measured) & (np.arange(measured.size) >= unknown)
        gap = np.abs(measured[good] - value[good])
        error, span, inside = (
            float(np.sqrt(np.mean(gap**2))),
            float(np.ptp(measured[good])),
            float(np.mean(gap <= bound[good])),
        )
    ends = [_natural(role, value + sign * bound) for sign in (-1.0, 1.0)]
    return ChannelPrediction(
        value=_natural(role, value),
        lower=np.minimum(*ends),
        upper=np.maximum(*ends),
        measured=None if measured is None else _natural(role, measured),
        error=error,
        span=span,
        inside=inside,
        unknown=unknown,
    )


def _has(model: DeviceModel, role: str) -> bool:
    """Whether the model says anything about a role."""
    banks = {RESISTANCE: model.resistance, "tip_deflection": model.deflection}
    return role not in banks or bool(np.ptp(banks[role].span))


def _judged(role: str, values: Floats) -> Floats:
    return -np.log10(np.maximum(values, 1e-300)) if role == RESISTANCE else values


def _natural(role: str, values: Floats) -> Floats:
    return np.asarray(10.0**-values) if role == RESISTANCE else values
