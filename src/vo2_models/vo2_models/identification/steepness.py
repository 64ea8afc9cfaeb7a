"""Where a law misses a device: by more where the response is steep, as an error of the place of a loop shows there.

A law that places a turn or a branch wrongly by a little is wrong in the response by that much times its slope, and hardly at
all on flat stretches. Its residual is then no series of one variance but

    s_k^2 = a^2 + (b M_k)^2,

with M_k the total variation of the response while the loop coordinate travels `TRAVEL` of its range about sample k. Both are
those of highest likelihood over the held-out parts of the calibration; a is no less than the noise of the sensor.
Regression with a variance function: M. Davidian, course ST 762, chapter 7, Detection and modeling of nonconstant variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from vo2_models.device.description import DeviceDescription
from vo2_models.device.model import SensorModel

__all__ = ["TRAVEL", "steep_misfit", "travel_of", "unevenness", "variation"]

Floats = NDArray[np.float64]
TRAVEL = 0.03
"""Window of the loop coordinate over which the response's variation is taken, as a share of its range. Of 0.3, 1 and 3 per
cent it had the highest likelihood on most of seven measured calibrations and three simulated ones that were looked at."""
UNEVEN = 0.7
"""Share of the misfit up to which that of flat stretches is told apart from it; the same calibrations lay at 0.14 to 0.53."""


def travel_of(device: DeviceDescription) -> float:
    """Return the window's length of a device without body, in the unit of its loop coordinate.

    Parameters
    ----------
    device : with its operating range
    """
    low, high = (device.steady_temperature(i) for i in device.operating_range)
    return TRAVEL * abs(high - low)


def variation(path: Floats, response: Floats, travel: float) -> Floats:
    """Return how far a response goes, up and down, while its loop coordinate travels a window about each sample.

    Parameters
    ----------
    path : (n,) loop coordinate [degC]
    response : (n,) in the channel's unit
    travel : length of the window, in the unit of the path

    Returns
    -------
    (n,) in the channel's unit, at least 0
    """
    way = np.cumsum(np.abs(np.diff(path, prepend=path[:1])))
    # samples at which the path stands still follow each other all the same
    way += np.arange(way.size) * 1e-9 * travel
    gone = np.cumsum(np.abs(np.diff(response, prepend=response[:1])))
    return np.asarray(np.interp(way + 0.5 * travel, way, gone) - np.interp(way - 0.5 * travel, way, gone))


def steep_misfit(residual: Floats, varies: Floats, noise: float) -> tuple[float, float]:
    """Return what a fit leaves where the response is flat [channel unit], and more per variation of the response [1].

    Parameters
    ----------
    residual : (n,) measured minus fitted where the fit was not given it, NaN where there is none
    varies : (n,) as `variation`
    noise : standard deviation of the sensor's noise, in the unit of the residual

    Returns
    -------
    a and b above; 0 and 0 where one variance will do
    """
    there = np.isfinite(residual) & np.isfinite(varies)
    square, way = residual[there] ** 2, varies[there] ** 2
    whole, scale = float(np.mean(square)), float(np.mean(way))
    least = min(noise**2, whole)
    if not (whole > least and scale > 0.0):
        return 0.0, 0.0

    def cost(logs: Floats) -> float:
        variance = least + np.exp(logs[0]) * whole + np.exp(logs[1]) * whole * way / scale
        return 0.5 * float(np.sum(np.log(variance) + square / variance))

    starts = [(-0.1, -3.0), (-3.0, -0.1), (-5.0, 1.0)]
    best = min(
        (minimize(cost, start, method="L-BFGS-B", bounds=[(-16.0, 2.0)] * 2) for start in starts),
        key=lambda one: float(one.fun),
    )
    flat = float(np.sqrt(least + np.exp(best.x[0]) * whole))
    steep = float(np.sqrt(np.exp(best.x[1]) * whole / scale))
    return (flat, steep) if flat < UNEVEN * np.sqrt(whole) else (0.0, 0.0)


def unevenness(device: DeviceDescription, sensor: SensorModel, path: Floats, response: Floats) -> Floats:
    """Return the size of what a law misses along a path, over that of its calibration's held-out parts: 1 where it is even.

    Parameters
    ----------
    device : without body
    sensor : as it was fitted
    path, response : (n,) as `variation` takes them

    Returns
    -------
    (n,) above 0
    """
    if sensor.misfit_flat <= 0.0:
        return np.ones(path.size)
    steep = sensor.misfit_steep * variation(path, response, travel_of(device))
    return np.asarray(np.hypot(sensor.misfit_flat, steep) / sensor.misfit)
