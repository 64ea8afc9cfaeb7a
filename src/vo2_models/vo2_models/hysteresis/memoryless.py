"""Memoryless parts D(v) of an extended model, (6.1): what bends the loop without memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis import layout
from vo2_models.validation import finite_array

__all__ = ["Cosine", "Linear", "Memoryless", "MemorylessSum", "Polynomial", "Sine", "Tanh", "Zero"]

FloatArray = NDArray[np.float64]


@runtime_checkable
class Memoryless(Protocol):
    """What a model needs of its memoryless part."""

    def __call__(self, v: ArrayLike) -> FloatArray:
        """D(v) in the output's unit, of the shape of v."""

    def slope(self, v: ArrayLike) -> FloatArray:
        """dD/dv, of the shape of v."""

    def terms(self) -> list[list[float]]:
        """Packed terms [kind, count, parameters...] as `kernels` lays them out."""


def _term(kind: int, *parameters: float) -> list[list[float]]:
    return [[float(kind), float(len(parameters)), *parameters]]


class _Checked:
    """Turns every field into a finite float."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, float(finite_array(value, name, ndim=0)))


@dataclass(frozen=True)
class Zero:
    """D(v) = 0."""

    def __call__(self, v: ArrayLike) -> FloatArray:
        return np.zeros(np.shape(v))

    def slope(self, v: ArrayLike) -> FloatArray:
        return np.zeros(np.shape(v))

    def terms(self) -> list[list[float]]:
        return []


@dataclass(frozen=True)
class Linear(_Checked):
    """D(v) = slope_value * v, as in (7.5)'s c_2 g(T); a constant belongs into the model's `bias`."""

    slope_value: float

    def __call__(self, v: ArrayLike) -> FloatArray:
        return self.slope_value * np.asarray(v, dtype=np.float64)

    def slope(self, v: ArrayLike) -> FloatArray:
        return np.full(np.shape(v), self.slope_value)

    def terms(self) -> list[list[float]]:
        return _term(layout.POLYNOMIAL, 0.0, self.slope_value)


@dataclass(frozen=True)
class Sine(_Checked):
    """D(v) = amplitude * sin(frequency * v + phase), (6.13); frequency in rad per input unit."""

    amplitude: float
    frequency: float
    phase: float = 0.0

    def __call__(self, v: ArrayLike) -> FloatArray:
        return self.amplitude * np.sin(self.frequency * np.asarray(v, dtype=np.float64) + self.phase)

    def slope(self, v: ArrayLike) -> FloatArray:
        angle = self.frequency * np.asarray(v, dtype=np.float64) + self.phase
        return self.amplitude * self.frequency * np.cos(angle)

    def terms(self) -> list[list[float]]:
        return _term(layout.SINE, self.amplitude, self.frequency, self.phase)


@dataclass(frozen=True)
class Cosine(_Checked):
    """D(v) = amplitude * cos(frequency * v + phase), (6.17)."""

    amplitude: float
    frequency: float = 1.0
    phase: float = 0.0

    def __call__(self, v: ArrayLike) -> FloatArray:
        return self.amplitude * np.cos(self.frequency * np.asarray(v, dtype=np.float64) + self.phase)

    def slope(self, v: ArrayLike) -> FloatArray:
        angle = self.frequency * np.asarray(v, dtype=np.float64) + self.phase
        return -self.amplitude * self.frequency * np.sin(angle)

    def terms(self) -> list[list[float]]:
        return _term(layout.SINE, self.amplitude, self.frequency, self.phase + np.pi / 2)


@dataclass(frozen=True)
class Tanh(_Checked):
    """D(v) = amplitude * tanh(gain * v + offset), (6.14)."""

    amplitude: float
    gain: float
    offset: float = 0.0

    def __call__(self, v: ArrayLike) -> FloatArray:
        return self.amplitude * np.tanh(self.gain * np.asarray(v, dtype=np.float64) + self.offset)

    def slope(self, v: ArrayLike) -> FloatArray:
        g = np.tanh(self.gain * np.asarray(v, dtype=np.float64) + self.offset)
        return self.amplitude * self.gain * (1 - g) * (1 + g)

    def terms(self) -> list[list[float]]:
        return _term(layout.SATURATION, self.amplitude, self.gain, self.offset)


@dataclass(frozen=True, eq=False)
class Polynomial:
    """D(v) = c0 + c1 v + c2 v^2 + ...

    Parameters
    ----------
    coefficients : (K,) from the constant upwards, K >= 1
    """

    coefficients: layout.Numbers

    def __post_init__(self) -> None:
        coefficients = finite_array(self.coefficients, "coefficients")
        if coefficients.size == 0:
            raise ValueError("coefficients: found none, need at least the constant")
        object.__setattr__(self, "coefficients", coefficients)

    def __call__(self, v: ArrayLike) -> FloatArray:
        return np.asarray(
            np.polynomial.polynomial.polyval(np.asarray(v, dtype=np.float64), self.coefficients)
        )

    def slope(self, v: ArrayLike) -> FloatArray:
        derivative = np.polynomial.polynomial.polyder(np.asarray(self.coefficients))
        return np.asarray(np.polynomial.polynomial.polyval(np.asarray(v, dtype=np.float64), derivative))

    def terms(self) -> list[list[float]]:
        return _term(layout.POLYNOMIAL, *np.asarray(self.coefficients).tolist())


@dataclass(frozen=True)
class MemorylessSum:
    """Sum of memoryless parts.

    >>> drift = MemorylessSum((Linear(0.5), Tanh(1.0, 2.0)))
    >>> float(drift(0.0)), float(drift.slope(0.0))
    (0.0, 2.5)
    """

    parts: tuple[Memoryless, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        for k, part in enumerate(self.parts):
            if not isinstance(part, Memoryless):
                raise ValueError(f"parts: found {type(part).__name__} at index {k}, need memoryless parts")

    def __call__(self, v: ArrayLike) -> FloatArray:
        return np.asarray(sum((part(v) for part in self.parts), np.zeros(np.shape(v))))

    def slope(self, v: ArrayLike) -> FloatArray:
        return np.asarray(sum((part.slope(v) for part in self.parts), np.zeros(np.shape(v))))

    def terms(self) -> list[list[float]]:
        return [term for part in self.parts for term in part.terms()]
