"""Small recursive filters on the fine grid, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, lfilter
from scipy.special import erfcx
from vo2_models.numerics.kernel import kernel

__all__ = [
    "after_steps",
    "backlash",
    "boxcar",
    "half_order",
    "lag",
    "log_relaxation",
    "oscillator",
    "rate_limit",
]

Array = NDArray[np.floating]


def lag(values: Array, step: float, time_constant: float) -> Array:
    """Return `values` (n,) behind a first-order lag [s], exact for steps, starting in equilibrium."""
    if time_constant <= 0:
        return values
    keep = np.exp(-step / time_constant)
    out, _ = lfilter([1 - keep], [1, -keep], values, zi=np.array([keep * values[0]]))
    return np.asarray(out)


def after_steps(values: Array, response: Array) -> Array:
    """Return the sum of `response` (n,) to each change of `values` (n,), which begin in equilibrium (Duhamel)."""
    return np.asarray(fftconvolve(np.diff(values, prepend=values[0]), response)[: values.size])


def half_order(values: Array, step: float, time: float) -> Array:
    """Return `values` (n,) behind 1 / (1 + sqrt(s time)), the input impedance of a deep substrate.

    Its step response is 1 - exp(t / time) erfc(sqrt(t / time)); Carslaw and Jaeger, Conduction of Heat in Solids, 2.7.
    """
    return after_steps(values, 1 - erfcx(np.sqrt(np.arange(values.size) * step / time)))


def boxcar(values: Array, step: float, length: float) -> Array:
    """Return the mean of `values` (n,) over the last `length` [s], exact for straight lines between elements."""
    time = np.arange(values.size) * step
    total = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2 * step)])
    start = np.maximum(time - length, 0.0)
    k = np.minimum((start / step).astype(np.int64), values.size - 2)
    part = start - k * step
    up_to_start = total[k] + values[k] * part + (values[k + 1] - values[k]) / step * part**2 / 2
    before = np.where(time < length, values[0] * (length - time), 0.0)  # at rest before the first element
    return np.asarray((total - up_to_start + before) / length)


@kernel
def rate_limit(values: Array, most: float) -> Array:
    """Return `values` (n,) followed with at most `most` change per element, starting from 0."""
    out = np.empty_like(values)
    last = 0.0
    for k in range(values.size):
        last += min(max(values[k] - last, -most), most)
        out[k] = last
    return out


@kernel
def backlash(values: Array, half_width: float) -> Array:
    """Return `values` (n,) behind a play of `half_width` that sticks until overcome."""
    out = np.empty_like(values)
    last = values[0]
    for k in range(values.size):
        last = max(values[k] - half_width, min(values[k] + half_width, last))
        out[k] = last
    return out


@kernel
def oscillator(values: Array, step: float, frequency: float, damping: float) -> Array:
    """Return x (n,) of x'' + 2 z w x' + w^2 x = w^2 v(t), exact for v linear between elements.

    Parameters: `step` [s], `frequency` natural frequency [Hz], `damping` z below 1; starts in equilibrium.
    """
    w = 2 * np.pi * frequency
    z = damping
    wd = w * np.sqrt(1 - z * z)
    fade, c, s = np.exp(-z * w * step), np.cos(wd * step), np.sin(wd * step)
    out = np.empty_like(values)
    x, v = values[0], 0.0
    out[0] = x
    for k in range(values.size - 1):
        slope = (values[k + 1] - values[k]) / step
        # particular solution for a ramp: lags it by 2 z / w
        x0 = x - (values[k] - 2 * z / w * slope)
        v0 = v - slope
        a = (v0 + z * w * x0) / wd
        y = fade * (x0 * c + a * s)
        dy = fade * (wd * (a * c - x0 * s) - z * w * (x0 * c + a * s))
        x = y + values[k + 1] - 2 * z / w * slope
        v = dy + slope
        out[k + 1] = x
    return out


@kernel
def log_relaxation(temperature: Array, step: float, strength: float, onset: float, erase: float) -> Array:
    """Return the drift x (n,) that grows as strength ln(1 + t / onset) while the temperature rests.

    dx/dt = d strength / onset exp(-d x / strength) - x |dT/dt| / erase, with d the direction of the last movement:
    logarithmic after-effect (Street and Woolley, Proc. Phys. Soc. A 62, 562, 1949), forgotten as T moves on.
    """
    out = np.zeros_like(temperature)
    x, direction = 0.0, 1.0
    for k in range(temperature.size - 1):
        move = temperature[k + 1] - temperature[k]
        if abs(move) > 1e-3 * erase:
            direction = 1.0 if move > 0 else -1.0
        x *= np.exp(-abs(move) / erase)
        y = direction * x
        y = strength * np.log(np.exp(y / strength) + step / onset) if y > 0 else y + strength * step / onset
        x = direction * y
        out[k + 1] = x
    return out
