"""A bank of generalized plays with tanh envelopes and a polynomial: the rate-independent law of one channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.layout import TANH
from vo2_models.parameters import Parameter, Value
from vo2_models.validation import finite_array

if TYPE_CHECKING:
    from vo2_models.hysteresis import EGPI

__all__ = ["PlayBank", "bank_parameters"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlayBank:
    """output(T) = sum_j weight_j F_j[T] + polynomial(T), F_j a play of envelopes tanh(slope T + offset): (7.3)-(7.7).

    Attributes (all float arrays; N plays)
    ----------
    weights, radii : (N,) in the output's unit; 1
    rising_slopes, rising_offsets, falling_slopes, falling_offsets : (N,) envelopes [1/K], [1]
    polynomial : (m,) coefficients of 1, T, T^2 ... in degC, in the output's unit
    """

    weights: ArrayLike = field(default_factory=lambda: np.zeros(0))
    radii: ArrayLike = field(default_factory=lambda: np.zeros(0))
    rising_slopes: ArrayLike = field(default_factory=lambda: np.zeros(0))
    rising_offsets: ArrayLike = field(default_factory=lambda: np.zeros(0))
    falling_slopes: ArrayLike = field(default_factory=lambda: np.zeros(0))
    falling_offsets: ArrayLike = field(default_factory=lambda: np.zeros(0))
    polynomial: ArrayLike = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        count = np.size(self.weights)
        for part in fields(self):
            size = None if part.name == "polynomial" else count
            object.__setattr__(self, part.name, finite_array(getattr(self, part.name), part.name, size=size))

    @property
    def present(self) -> bool:
        """Whether there is a law at all (a recording may lack the channel)."""
        return np.size(self.polynomial) > 0

    @property
    def packed(self) -> Floats:
        """The plays as `hysteresis.kernels` packs them, without bias and polynomial."""
        count = np.size(self.weights)
        header = np.array([count, TANH, 0.0, 2.0, 0.0, 0.0])
        parts = [getattr(self, part.name) for part in fields(self)[:-1]]
        return np.concatenate([header, *parts])

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest weighted sum of the plays: both saturations."""
        reach = 1.0 - np.asarray(self.radii)
        high = float(np.dot(self.weights, reach))
        return -high, high

    def egpi(self) -> EGPI:
        """Return the law as a model of `vo2_models.hysteresis`."""
        from vo2_models.hysteresis import EGPI, Polynomial, TanhEnvelopes

        c = np.asarray(self.polynomial)
        return EGPI(
            radii=self.radii,
            weights=self.weights,
            envelopes=TanhEnvelopes(
                self.rising_slopes, self.rising_offsets, self.falling_slopes, self.falling_offsets
            ),
            bias=float(c[0]),
            memoryless=Polynomial([0.0, *c[1:]]),
        )

    def to_parameters(self, section: str) -> dict[str, Value]:
        """Return `{section.name: list}`."""
        return {f"{section}.{part.name}": getattr(self, part.name).tolist() for part in fields(self)}

    @classmethod
    def from_parameters(cls, section: str, values: Mapping[str, Value]) -> PlayBank:
        """Return the bank that `to_parameters` wrote; absent names mean an empty bank."""
        given = {part.name: values.get(f"{section}.{part.name}", []) for part in fields(cls)}
        try:
            return cls(**{name: np.atleast_1d(np.asarray(v, dtype=float)) for name, v in given.items()})
        except ValueError as error:
            raise ValueError(f"{section}.{error}") from error


def bank_parameters(section: str, what: str, unit: str) -> tuple[Parameter, ...]:
    """Return the `Parameter` records of a bank."""
    described = {
        "weights": (unit, f"weights of the plays of {what}"),
        "radii": ("1", f"play radii of {what}"),
        "rising_slopes": ("1/K", f"slopes of the rising tanh envelopes of {what}"),
        "rising_offsets": ("1", f"offsets of the rising tanh envelopes of {what}"),
        "falling_slopes": ("1/K", f"slopes of the falling tanh envelopes of {what}"),
        "falling_offsets": ("1", f"offsets of the falling tanh envelopes of {what}"),
        "polynomial": (
            unit,
            f"coefficients of the powers of the temperature in degC, lowest first, of {what}",
        ),
    }
    return tuple(
        Parameter(f"{section}.{name}", [], kind_unit, f"{text}; empty without model", kind="float_array")
        for name, (kind_unit, text) in described.items()
    )
