"""Tip deflection and curvature of a cantilever bent to a circular arc, exactly: (5.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vo2_models.validation import finite_array, positive_number

__all__ = ["curvature_from_deflection", "deflection_from_curvature", "largest_deflection"]

Floats = NDArray[np.float64]

_STEEPEST = 1.1655611852072114
"""Half arc angle of the largest deflection [rad]: tan x = 2 x."""


def largest_deflection(length: float) -> float:
    """Return the deflection [m] beyond which the arc bends back: 0.7246 of the length."""
    return float(positive_number(length, "length") * np.sin(_STEEPEST) ** 2 / _STEEPEST)


def deflection_from_curvature(curvature: ArrayLike, length: float) -> Floats:
    """Return the tip deflection 2 r sin^2(L / (2 r)), r = 1 / curvature, of (5.1).

    Parameters
    ----------
    curvature : any shape [1/m], either sign
    length : of the cantilever [m]

    Raises
    ------
    ValueError : not finite, or `length` not above zero.

    Examples
    --------
    >>> round(float(deflection_from_curvature(1836.0, 300e-6)) * 1e6, 2)  # small angles would say 82.62
    80.55
    """
    kappa = finite_array(curvature, "curvature", ndim=None)
    half = 0.5 * positive_number(length, "length") * kappa
    return np.asarray(0.5 * kappa * length**2 * np.sinc(half / np.pi) ** 2, dtype=np.float64)


def curvature_from_deflection(deflection: ArrayLike, length: float) -> Floats:
    """Return the curvature [1/m] of the flattest arc with tip deflection `deflection` [m], any shape.

    Solves sin^2(x) / x = deflection / length for the half arc angle x by Newton's method, to rounding.

    Raises
    ------
    ValueError : not finite, or a deflection that no arc of this length reaches.
    """
    z = finite_array(deflection, "deflection", ndim=None)
    limit = largest_deflection(length)
    if np.any(np.abs(z) > limit * (1 + 1e-12)):
        worst = float(z.ravel()[np.argmax(np.abs(z))])
        raise ValueError(
            f"deflection: found {worst:g} m, need at most {limit:g} m, the largest of a {length:g} m cantilever"
        )
    share = np.minimum(np.abs(z), limit) / length
    # from the small-angle value upwards: sin^2(x) - share x is convex there up to pi / 4, then safeguarded
    low, high = np.zeros_like(share), np.full_like(share, _STEEPEST)
    x = np.minimum(share, _STEEPEST)
    for _ in range(80):
        value = np.sin(x) ** 2 - share * x
        low, high = np.where(value < 0, x, low), np.where(value >= 0, x, high)
        slope = np.sin(2 * x) - share
        newton = x - np.divide(value, slope, out=np.zeros_like(x), where=slope > 0)
        inside = (newton > low) & (newton < high)
        following = np.where(inside, newton, 0.5 * (low + high))
        following = np.where((value == 0) | (share == 0), x, following)
        if np.all(np.abs(following - x) <= 1e-16 * (1 + x)):
            break
        x = following
    return np.asarray(np.copysign(2 * x / length, z), dtype=np.float64)
