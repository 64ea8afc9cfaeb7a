"""Temperature surrogate: the current that holds a temperature at steady state, (7.2), and its inverse."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.device.description import preset

__all__ = ["surrogate_of_temperature", "temperature_of_surrogate"]


def temperature_of_surrogate(device: str, current: ArrayLike) -> NDArray[np.float64]:
    """Return the temperature [degC] (same shape) that the current [A] holds at steady state: T = T0 + k1 i + k2 i^2.

    Parameters
    ----------
    device : see `preset`
    current : [A], any shape

    Examples
    --------
    >>> round(float(temperature_of_surrogate("integrated", 8.49e-3)), 2)
    94.8
    """
    nominal = preset(device)
    i = np.asarray(current, dtype=np.float64)
    return nominal.ambient + nominal.linear_gain * i + nominal.square_gain * i * i


def surrogate_of_temperature(device: str, temperature: ArrayLike) -> NDArray[np.float64]:
    """Return the current [A] (same shape) that holds the temperature [degC]: g(T) of (7.2).

    Where the heater can only heat, a temperature below ambient gives 0 A. Of both gains the root is taken on the side
    of the operating range.

    Parameters
    ----------
    device : see `preset`
    temperature : [degC], any shape

    Examples
    --------
    >>> round(1e3 * float(surrogate_of_temperature("integrated", 94.8)), 2)
    8.49
    """
    nominal = preset(device)
    rise = np.asarray(temperature, dtype=np.float64) - nominal.ambient
    k1, k2 = nominal.linear_gain, nominal.square_gain
    if not k2:
        return rise / k1
    vertex = -0.5 * k1 / k2
    side = np.copysign(1.0, 0.5 * sum(nominal.operating_range) - vertex)
    return vertex + side * np.sqrt(np.maximum(rise / k2 + vertex * vertex, 0.0))
