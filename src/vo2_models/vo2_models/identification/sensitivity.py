"""Outputs of a bank of plays on a given temperature, with their exact derivatives by the loop's shape.

Each play is described by the slope a, the centre m and the half width h > 0 of its loop, gamma_R(T) =
tanh(a (T - m - h)) and gamma_L(T) = tanh(a (T - m + h)), which cannot cross. Its output is the envelope's value at the
instant that last moved it, and so are its derivatives: they are carried along with it.
"""

from __future__ import annotations

import numpy as np

from vo2_models.hysteresis.kernels import exact, tanh

__all__ = ["play_sensitivities"]


@exact
def play_sensitivities(temperature, slope, centre, half_width, weight, out):
    """Run N weighted plays of radius 0 from their lower saturation along a temperature (n,) [degC].

    slope (N,) [1/K], half_width (N,) [K] half of the envelopes' distance -> out (n, at least 4 N): in columns of N the
    derivatives of weight * output by log slope, centre [1/K] and log half width, and weight * output itself, which is its
    derivative by log weight.
    """
    n = slope.size
    now = np.zeros((4, n))
    now[3] = -weight
    memory = -np.ones(n)
    previous = -np.inf
    for k in range(temperature.size):
        v = temperature[k]
        up = v > previous
        if v != previous:
            for j in range(n):
                h = half_width[j] if up else -half_width[j]
                x = slope[j] * (v - centre[j] - h)
                g = tanh(x)
                if (up and g > memory[j]) or (not up and g < memory[j]):
                    memory[j] = g
                    steep = weight[j] * (1.0 - g) * (1.0 + g)
                    now[0, j] = steep * x
                    now[1, j] = -steep * slope[j]
                    now[2, j] = now[1, j] * h
                    now[3, j] = weight[j] * g
        previous = v
        for part in range(4):
            for j in range(n):
                out[k, part * n + j] = now[part, j]
