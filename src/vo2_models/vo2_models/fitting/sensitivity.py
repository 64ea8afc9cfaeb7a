"""Outputs of a bank of plays on a given temperature, with their exact derivatives, in one pass.

A play holds its output until an envelope moves it, so its derivative with respect to an envelope's parameter is
the envelope's derivative at the moment of the last move, held since. Each play is described by the slope a, the
centre m and the half width h > 0 of its loop: gamma_R(T) = tanh(a (T - m - h)), gamma_L(T) = tanh(a (T - m + h)),
which cannot cross.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["play_sensitivities"]


@njit(cache=True, error_model="numpy", nogil=True)
def _kernel(temperature, slope, centre, half_width, radius, values, by_slope, by_centre, by_width):
    for j in range(slope.size):
        a, m, h, r = slope[j], centre[j], half_width[j], radius[j]
        w = r - 1.0
        d_slope = 0.0
        d_centre = 0.0
        d_width = 0.0
        previous = -math.inf
        for k in range(temperature.size):
            v = temperature[k]
            if v > previous:
                distance = v - m - h
                g = math.tanh(a * distance)
                if g - r > w:
                    w = g - r
                    slack = (1.0 - g) * (1.0 + g) * a
                    d_slope = slack * distance
                    d_centre = -slack
                    d_width = -slack * h
            elif v < previous:
                distance = v - m + h
                g = math.tanh(a * distance)
                if g + r < w:
                    w = g + r
                    slack = (1.0 - g) * (1.0 + g) * a
                    d_slope = slack * distance
                    d_centre = -slack
                    d_width = slack * h
            previous = v
            values[j, k] = w
            by_slope[j, k] = d_slope
            by_centre[j, k] = d_centre
            by_width[j, k] = d_width


def play_sensitivities(
    temperature: NDArray[np.float64],
    slope: NDArray[np.float64],
    centre: NDArray[np.float64],
    half_width: NDArray[np.float64],
    radius: NDArray[np.float64],
) -> tuple[NDArray[np.float64], ...]:
    """Run N plays from their lower saturation along a temperature (n,) [degC].

    Returns
    -------
    values, by_log_slope, by_centre, by_log_half_width : (N, n) outputs and derivatives [1], [1/K] by the centre
    """
    out = tuple(np.empty((slope.size, temperature.size)) for _ in range(4))
    _kernel(temperature, slope, centre, half_width, radius, *out)
    return out
