"""Memoryless parts as a fit sees them: linear columns of the normalised input, some with a nonlinear parameter.

The normalised input z runs from -1 to 1 over the input range; `physical` turns coefficients back to the input's unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.memoryless import Memoryless, Polynomial, Sine, Tanh, Zero

__all__ = ["BASES", "Basis", "PolynomialBasis", "SineBasis", "TanhBasis"]

FloatArray = NDArray[np.float64]


class Basis(Protocol):
    """A family D(z) = sum_k c_k phi_k(z; theta)."""

    @property
    def nonnegative(self) -> bool:
        """Whether the coefficients must not be negative (a part that may only rise)."""

    @property
    def starts(self) -> list[list[float]]:
        """Starting values of theta to try."""

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        """Bounds of theta."""

    def columns(self, z: FloatArray, theta: FloatArray) -> FloatArray:
        """phi (n, K)."""

    def derivatives(self, z: FloatArray, theta: FloatArray, coefficients: FloatArray) -> FloatArray:
        """d(phi c)/dtheta (n, len(theta))."""

    def in_units(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """theta and coefficients of the part over the input v = centre + half z, and a constant that goes into the bias."""

    def physical(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[Memoryless, float]:
        """The memoryless part of that input, and that constant."""


@dataclass(frozen=True)
class PolynomialBasis:
    """z, z^2 ... z^degree; degree 0 is no memoryless part."""

    degree: int
    nonnegative: bool = False

    @property
    def starts(self) -> list[list[float]]:
        return [[]]

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        return [], []

    def columns(self, z: FloatArray, theta: FloatArray) -> FloatArray:
        return z[:, None] ** np.arange(1, self.degree + 1)

    def derivatives(self, z: FloatArray, theta: FloatArray, coefficients: FloatArray) -> FloatArray:
        return np.zeros((z.size, 0))

    def in_units(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Coefficients of v, v^2 ..."""
        in_z = np.polynomial.Polynomial([0.0, *coefficients])
        in_v = np.atleast_1d(in_z(np.polynomial.Polynomial([-centre / half, 1 / half])).coef)
        return theta, np.pad(in_v[1:], (0, self.degree + 1 - in_v.size)), float(in_v[0])

    def physical(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[Memoryless, float]:
        if self.degree == 0:
            return Zero(), 0.0
        _, in_v, constant = self.in_units(coefficients, theta, centre, half)
        return Polynomial([0.0, *in_v]), constant


@dataclass(frozen=True)
class TanhBasis:
    """tanh(a z + b), as (6.14); with `nonnegative` the part may only rise."""

    nonnegative: bool = True

    @property
    def starts(self) -> list[list[float]]:
        return [[0.7, 0.0], [2.0, 0.0]]

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        return [0.05, -10.0], [20.0, 10.0]

    def columns(self, z: FloatArray, theta: FloatArray) -> FloatArray:
        return np.tanh(theta[0] * z + theta[1])[:, None]

    def derivatives(self, z: FloatArray, theta: FloatArray, coefficients: FloatArray) -> FloatArray:
        steep = coefficients[0] / np.cosh(theta[0] * z + theta[1]) ** 2
        return np.stack([steep * z, steep], axis=1)

    def in_units(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Gain and offset; amplitude."""
        gain = float(theta[0]) / half
        return np.array([gain, float(theta[1]) - gain * centre]), coefficients, 0.0

    def physical(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[Memoryless, float]:
        (gain, place), (amplitude,), constant = self.in_units(coefficients, theta, centre, half)
        return Tanh(float(amplitude), float(gain), float(place)), constant


@dataclass(frozen=True)
class SineBasis:
    """sin(w z) and cos(w z): a sine of free amplitude, frequency and phase, (6.13)."""

    nonnegative: bool = False

    @property
    def starts(self) -> list[list[float]]:
        return [[1.0], [2.0], [3.5], [5.0]]

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        return [0.3], [12.0]

    def columns(self, z: FloatArray, theta: FloatArray) -> FloatArray:
        return np.stack([np.sin(theta[0] * z), np.cos(theta[0] * z)], axis=1)

    def derivatives(self, z: FloatArray, theta: FloatArray, coefficients: FloatArray) -> FloatArray:
        sine, cosine = np.sin(theta[0] * z), np.cos(theta[0] * z)
        return (z * (coefficients[0] * cosine - coefficients[1] * sine))[:, None]

    def in_units(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Frequency; amplitude and phase."""
        frequency = float(theta[0]) / half
        phase = float(np.arctan2(coefficients[1], coefficients[0])) - frequency * centre
        return np.array([frequency]), np.array([np.hypot(*coefficients), phase]), 0.0

    def physical(
        self, coefficients: FloatArray, theta: FloatArray, centre: float, half: float
    ) -> tuple[Memoryless, float]:
        (frequency,), (amplitude, phase), constant = self.in_units(coefficients, theta, centre, half)
        return Sine(float(amplitude), float(frequency), float(phase)), constant


BASES: dict[str, Basis] = {
    "none": PolynomialBasis(0),
    "linear": PolynomialBasis(1),
    "rising_linear": PolynomialBasis(1, nonnegative=True),
    "quadratic": PolynomialBasis(2),
    "cubic": PolynomialBasis(3),
    "tanh": TanhBasis(nonnegative=False),
    "rising_tanh": TanhBasis(),
    "sine": SineBasis(),
}
"""Names that `fit_play_model` knows; the rising ones keep the model monotone."""
