"""Outputs of a bank of plays on a given temperature, with their exact derivatives by the loop's shape.

Each play is described by the slope a, the centre m and the half width h > 0 of its loop, gamma_R(T) =
tanh(a (T - m - h)) and gamma_L(T) = tanh(a (T - m + h)), which cannot cross. The derivatives by the envelopes'
own parameters come from `hysteresis.fitting_kernels`; here is the chain rule.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.fitting_kernels import derivatives, regressors

__all__ = ["play_sensitivities"]

Floats = NDArray[np.float64]


def play_sensitivities(
    temperature: Floats, slope: Floats, centre: Floats, half_width: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Run N plays of radius 0 from their lower saturation along a temperature (n,) [degC].

    Parameters
    ----------
    slope : (N,) of the envelopes [1/K]
    half_width : (N,) half of their distance

    Returns
    -------
    values, by_log_slope, by_centre, by_log_half_width : (n, N) outputs and derivatives [1], [1/K] by the centre
    """
    a, m, h = slope, centre, half_width
    plays, radii = a.size, np.zeros(a.size)
    # coordinates around a middle temperature: v - m is taken where it is small
    middle = float(np.mean(m))
    v = temperature - middle
    rise, fall = m - middle + h, m - middle - h
    envelopes = np.array([a, -a * rise, a, -a * fall])
    values = np.empty((v.size, plays))
    regressors(v, envelopes, radii, True, values)
    columns = np.full((5, plays), -1, dtype=np.int64)
    columns[:4] = np.arange(4 * plays).reshape(4, plays)
    raw = np.zeros((v.size, 4 * plays))
    derivatives(v, envelopes, radii, True, np.ones(plays), columns, raw)
    by_rising_slope, by_rising, by_falling_slope, by_falling = (
        raw[:, k * plays : (k + 1) * plays] for k in range(4)
    )
    by_log_slope = a * (by_rising_slope + by_falling_slope - rise * by_rising - fall * by_falling)
    return values, by_log_slope, -a * (by_rising + by_falling), a * h * (by_falling - by_rising)
