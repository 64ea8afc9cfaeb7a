"""Compiled output laws: what resistance and deflection a temperature and a phase mixture have.

Ground truth. Resistance: an activated insulator ln R ~ E_a / (k_B T) and a metal whose resistance still falls
slightly (a few 1e-3 decades per kelvin, as real films), mixed by Bruggeman's effective medium with percolation
threshold p_c; with A = (1 - p_c) / p_c the effective conductivity solves

    (1 - s) (g_i - g) / (g_i + A g) + s (g_m - g) / (g_m + A g) = 0 .

Deflection: curvature k = k_0 + k_P s - ((1 - s) k_c + s k_h)(T - T_0) (5.7), (5.8) with the true hysteretic
fraction in place of the linear one (5.6), and the tip of a circular arc dz = 2 sin^2(k L / 2) / k (5.1).

Fitted simulation. y = -log10 R and deflection are play sums plus a polynomial of the temperature (7.3), (7.5).
"""

from __future__ import annotations

import math

from vo2_models.device.coefficients import Coefficient as C
from vo2_models.numerics.kernel import kernel

__all__ = ["arc_tip", "mixture_conductance", "polynomial", "truth_deflection", "truth_resistance"]

ZERO_CELSIUS = 273.15


@kernel
def mixture_conductance(insulator, metal, fraction, threshold):
    """Effective conductance (same unit as the two given) of a mixture with metallic fraction 0..1."""
    a = (1.0 - threshold) / threshold
    b = (1.0 - fraction) * (a * insulator - metal) + fraction * (a * metal - insulator)
    root = math.sqrt(b * b + 4.0 * a * insulator * metal)
    # the two forms of the root are equal; each is free of cancellation on its side
    if b >= 0.0:
        return (b + root) / (2.0 * a)
    return 2.0 * insulator * metal / (root - b)


@kernel
def truth_resistance(c, temperature, fraction):
    """Film resistance [ohm] at the temperature [degC] and metallic fraction."""
    inverse = 1.0 / (temperature + ZERO_CELSIUS) - 1.0 / (c[C.REFERENCE_LOW] + ZERO_CELSIUS)
    insulator = c[C.INSULATOR] * math.exp(c[C.ACTIVATION] * inverse)
    metal = c[C.METAL] * 10.0 ** (-c[C.METAL_SLOPE] * (temperature - c[C.REFERENCE_HIGH]))
    return 1.0 / mixture_conductance(1.0 / insulator, 1.0 / metal, fraction, c[C.THRESHOLD])


@kernel
def arc_tip(curvature, length):
    """Tip deflection [m] of a circular arc of the curvature [1/m] and length [m]: (5.1)."""
    x = 0.5 * curvature * length
    if abs(x) < 1e-6:
        return length * x
    sine = math.sin(x)
    return length * sine * sine / x


@kernel
def truth_deflection(c, temperature, fraction):
    """Tip deflection [m] at the temperature [degC] and structural fraction."""
    expansion = (1.0 - fraction) * c[C.EXPANSION_COLD] + fraction * c[C.EXPANSION_HOT]
    curvature = c[C.CURVATURE] + c[C.BENDING] * fraction - expansion * (temperature - c[C.AMBIENT])
    return arc_tip(curvature, c[C.LENGTH]) - c[C.DEFLECTION_ZERO]


@kernel
def polynomial(coefficients, v):
    """c_0 + c_1 v + c_2 v^2 + ..."""
    value = 0.0
    for k in range(coefficients.size - 1, -1, -1):
        value = value * v + coefficients[k]
    return value
