"""Envelope functions of the generalised play: gamma_R bounds the rising, gamma_L the falling branch (B.5).

Both are strictly increasing. One pair may serve every play (chapters 3 and 6), or each play may have its own
(Table 7.2): pass numbers for a shared pair, arrays of N numbers for one pair per play.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis import layout
from vo2_models.validation import finite_array, increasing

__all__ = ["Envelopes", "LinearEnvelopes", "TabulatedEnvelopes", "TanhEnvelopes"]

FloatArray = NDArray[np.float64]


@runtime_checkable
class Envelopes(Protocol):
    """What a Prandtl-Ishlinskii model needs of its envelopes."""

    @property
    def plays(self) -> int | None:
        """Number of plays that have an envelope pair of their own; None where all share one pair."""

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Lower limit of gamma_L and upper limit of gamma_R over all inputs, shape () or (N,)."""

    def rising(self, v: ArrayLike) -> FloatArray:
        """gamma_R(v); with one pair per play a trailing axis of length N is added."""

    def falling(self, v: ArrayLike) -> FloatArray:
        """gamma_L(v); with one pair per play a trailing axis of length N is added."""

    def packed(self) -> tuple[int, int, FloatArray]:
        """Kind, stride and numbers as `kernels` lays them out."""


def _pairs(**named: ArrayLike) -> dict[str, FloatArray]:
    """Check that the numbers are all scalars or all (N,)."""
    arrays = {name: finite_array(value, name, ndim=(0, 1)) for name, value in named.items()}
    first = next(iter(arrays))
    for name, array in arrays.items():
        if array.shape != arrays[first].shape:
            raise ValueError(f"{name}: found shape {array.shape}, need {arrays[first].shape} as {first} has")
    if arrays[first].size == 0:
        raise ValueError(f"{first}: found no value, need one number or one per play")
    return arrays


def _positive_slope(slope: FloatArray, name: str) -> None:
    if np.any(slope <= 0):
        k = int(np.flatnonzero(slope.ravel() <= 0)[0])
        raise ValueError(
            f"{name}: found {slope.ravel()[k]:g} at index {k}, "
            "need slopes above 0 so that the envelope is strictly increasing"
        )


@dataclass(frozen=True, eq=False)
class _AffinePair:
    """Slopes and offsets of the affine argument a v + b, rising and falling; scalars or (N,)."""

    rising_slope: layout.Numbers = 1.0
    rising_offset: layout.Numbers = 0.0
    falling_slope: layout.Numbers = 1.0
    falling_offset: layout.Numbers = 0.0

    def __post_init__(self) -> None:
        arrays = _pairs(
            rising_slope=self.rising_slope,
            rising_offset=self.rising_offset,
            falling_slope=self.falling_slope,
            falling_offset=self.falling_offset,
        )
        for name, array in arrays.items():
            if name.endswith("slope"):
                _positive_slope(array, name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def plays(self) -> int | None:
        shape = np.shape(self.rising_slope)
        return shape[0] if shape else None

    def _argument(self, v: ArrayLike, slope: FloatArray, offset: FloatArray) -> FloatArray:
        values = np.asarray(v, dtype=np.float64)
        if self.plays is not None:
            values = values[..., None]
        return np.asarray(slope * values + offset)

    def _numbers(self) -> FloatArray:
        parts = (self.rising_slope, self.rising_offset, self.falling_slope, self.falling_offset)
        return np.concatenate([np.atleast_1d(np.asarray(part)) for part in parts])


@dataclass(frozen=True, eq=False)
class TanhEnvelopes(_AffinePair):
    """gamma(v) = tanh(a v + b), (3.12)-(3.13): saturated hysteresis.

    Parameters
    ----------
    rising_slope, rising_offset : a_R [1/input unit] and b_R; a number (shared) or (N,) (one per play)
    falling_slope, falling_offset : a_L and b_L

    Raises
    ------
    ValueError : a slope not above 0, values not finite, or shapes that differ.

    Examples
    --------
    >>> envelopes = TanhEnvelopes(0.5, -30.0, 0.5, -27.0)
    >>> float(envelopes.rising(60.0)), envelopes.plays
    (0.0, None)
    """

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        one = np.ones(np.shape(self.rising_slope))
        return -one, one

    def rising(self, v: ArrayLike) -> FloatArray:
        return np.tanh(self._argument(v, self.rising_slope, self.rising_offset))

    def falling(self, v: ArrayLike) -> FloatArray:
        return np.tanh(self._argument(v, self.falling_slope, self.falling_offset))

    def packed(self) -> tuple[int, int, FloatArray]:
        return layout.TANH, 2, self._numbers()


@dataclass(frozen=True, eq=False)
class LinearEnvelopes(_AffinePair):
    """gamma(v) = a v + b; the defaults are the identity of the classical play.

    Parameters
    ----------
    rising_slope, rising_offset : a_R and b_R; a number (shared) or (N,) (one per play)
    falling_slope, falling_offset : a_L and b_L

    Raises
    ------
    ValueError : a slope not above 0, values not finite, or shapes that differ.
    """

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        shape = np.shape(self.rising_slope)
        return np.full(shape, -np.inf), np.full(shape, np.inf)

    def rising(self, v: ArrayLike) -> FloatArray:
        return self._argument(v, self.rising_slope, self.rising_offset)

    def falling(self, v: ArrayLike) -> FloatArray:
        return self._argument(v, self.falling_slope, self.falling_offset)

    def packed(self) -> tuple[int, int, FloatArray]:
        return layout.LINEAR, 2, self._numbers()


@dataclass(frozen=True, eq=False)
class TabulatedEnvelopes:
    """Any strictly increasing pair as piecewise-linear functions, going on with their end slopes outside.

    Parameters
    ----------
    inputs : (K,) knots, strictly increasing, K >= 2
    rising_values, falling_values : (K,) values at the knots, strictly increasing; or (N, K), one row per play

    Raises
    ------
    ValueError : fewer than two knots, shapes that do not fit, or values that do not strictly increase.

    Examples
    --------
    >>> import numpy as np
    >>> v = np.linspace(-5, 5, 201)
    >>> envelopes = TabulatedEnvelopes(v, np.arctan(v), np.arctan(v + 1))
    >>> bool(abs(envelopes.rising(0.33) - np.arctan(0.33)) < 3e-4)
    True
    """

    inputs: layout.Numbers
    rising_values: layout.Numbers
    falling_values: layout.Numbers

    def __post_init__(self) -> None:
        inputs = increasing(finite_array(self.inputs, "inputs"), "inputs")
        if inputs.size < 2:
            raise ValueError(f"inputs: found {inputs.size} knot(s), need at least 2")
        shape = np.shape(self.rising_values)
        object.__setattr__(self, "inputs", inputs)
        for name in ("rising_values", "falling_values"):
            values = finite_array(getattr(self, name), name, ndim=(1, 2))
            if values.shape != shape or values.shape[-1] != inputs.size or values.size == 0:
                raise ValueError(
                    f"{name}: found shape {values.shape}, need ({inputs.size},) or (N, {inputs.size}), "
                    "the same for rising and falling"
                )
            for row in np.atleast_2d(values):
                increasing(row, name)
            object.__setattr__(self, name, values)

    @property
    def plays(self) -> int | None:
        shape = np.shape(self.rising_values)
        return shape[0] if len(shape) == 2 else None

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        shape = np.shape(self.rising_values)[:-1]
        return np.full(shape, -np.inf), np.full(shape, np.inf)

    def _interpolate(self, v: ArrayLike, table: FloatArray) -> FloatArray:
        x, points = np.asarray(self.inputs), np.asarray(v, dtype=np.float64)
        k = np.clip(np.searchsorted(x, points) - 1, 0, x.size - 2)
        rows = table.T
        fraction = (points - x[k]) / (x[k + 1] - x[k])
        if self.plays is not None:
            fraction = fraction[..., None]
        return np.asarray(rows[k] + fraction * (rows[k + 1] - rows[k]))

    def rising(self, v: ArrayLike) -> FloatArray:
        return self._interpolate(v, np.asarray(self.rising_values))

    def falling(self, v: ArrayLike) -> FloatArray:
        return self._interpolate(v, np.asarray(self.falling_values))

    def packed(self) -> tuple[int, int, FloatArray]:
        inputs = np.asarray(self.inputs)
        numbers = []
        for values in (self.rising_values, self.falling_values):
            for row in np.atleast_2d(np.asarray(values)):
                numbers += [inputs, row]
        return layout.TABLE, 2 * inputs.size, np.concatenate(numbers)
