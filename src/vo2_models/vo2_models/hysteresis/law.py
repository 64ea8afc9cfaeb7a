"""The protocol of a hysteresis law: frozen parameters, a memory vector that the caller owns, one compiled step.

Rate-independent laws only: the output depends on the turning points of the input, not on time. Every law has

    move(u, packed, memory, make) -> hysteretic output

as a numba function with this one signature, so that any compiled loop takes any law: `u` the input, `packed` the
law's parameters as one float64 vector, `memory` its float64 vector, `make` whether the memory is changed. What has no
memory is a polynomial of the input beside it, so that a law's output is

    y = move(u, packed, memory, True) + polynomial(u).

A device may feed the two with different inputs (an effect that shifts the transition does not shift the expansion).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import wraps
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.parameters import Value
from vo2_models.validation import finite_array

__all__ = ["Inverse", "Inversion", "Law", "LawInverse", "Saturation", "check_memory", "side_of"]

Floats = NDArray[np.float64]
Saturation = Literal["lower", "upper"]

REACHED = 1e-9
"""An output counts as reached if it is met within this share of the law's output range."""


class Inversion(NamedTuple):
    """One inverted sample: input, the output it gives, and whether that is the output asked for."""

    input: float
    output: float
    reached: bool


class Inverse(Protocol):
    """An inverse of a law. Its memory is that of the law itself."""

    def invert(self, output: float, memory: Floats, /) -> Inversion:
        """Return the input for the wanted output; `memory` moves there in place."""


class Law(ABC):
    """A rate-independent law from an input u to an output y; subclasses are frozen dataclasses.

    Class attributes
    ----------------
    name : under which `vo2_models.hysteresis.LAWS` and a model file know the law
    move : compiled, `move(u, packed, memory, make) -> y` without the polynomial
    sweep : compiled, `sweep(u, packed, memory, out)`: `move` along the inputs u (n,), all made
    described : field -> (unit, description), `{y}` standing for the output's unit and `{u}` for the input's
    """

    name: ClassVar[str]
    move: ClassVar[Any]
    sweep: ClassVar[Any]
    described: ClassVar[Mapping[str, tuple[str, str]]]

    def __init_subclass__(cls, **options: Any) -> None:
        """Check the word that `initial_memory` is given, so that no law takes a misspelt one for the other end."""
        super().__init_subclass__(**options)
        own = cls.__dict__.get("initial_memory")
        if own is None:
            return

        @wraps(own)
        def checked(self: Law, saturation: Saturation = "lower", **more: Any) -> Floats:
            side_of(saturation)
            return own(self, saturation, **more)

        cls.initial_memory = checked  # type: ignore[method-assign]

    @property
    @abstractmethod
    def packed(self) -> Floats:
        """The parameters of the hysteretic part as `move` takes them."""

    @property
    @abstractmethod
    def memory_size(self) -> int:
        """Length of the memory."""

    @abstractmethod
    def initial_memory(self, saturation: Saturation = "lower") -> Floats:
        """Return the memory (memory_size,) far in saturation, from where any input comes next.

        Raises
        ------
        ValueError : another word than lower or upper.
        """

    @property
    @abstractmethod
    def span(self) -> tuple[float, float]:
        """Hysteretic output in lower and in upper saturation, without the polynomial [output unit]."""

    @property
    def present(self) -> bool:
        """Whether there is a law at all; only an empty bank of plays stands for none."""
        return True

    def present_input(self, memory: Floats) -> float:
        """Input that the memory was last moved to; -inf or inf straight after `initial_memory`."""
        return float(memory[0])

    def polynomial_part(self, u: float | Floats) -> Any:
        """Memoryless part that `move` leaves out, at the inputs u and of their shape [output unit]."""
        value: Any = 0.0
        for coefficient in reversed(getattr(self, "polynomial", ())):
            value = value * u + coefficient
        return value

    def settle(self, u: float, saturation: Saturation = "lower") -> Floats:
        """Return the memory (memory_size,) after saturation and a monotone move to the input u.

        Raises
        ------
        ValueError : u is not finite.
        """
        memory = self.initial_memory(saturation)
        self.step(u, memory)
        return memory

    def step(self, u: float, memory: Floats) -> float:
        """Move to the input u and return the output; `memory` (memory_size,) changes in place.

        Raises
        ------
        ValueError : u is not finite, or a memory of the wrong length.
        """
        v = float(u)
        if not -math.inf < v < math.inf:
            finite_array(u, "u", ndim=0)
        self._fits(memory)
        return float(self.move(v, self.packed, memory, True) + self.polynomial_part(v))

    def peek(self, u: float, memory: Floats) -> float:
        """Return the output that `step` would give; `memory` stays as it is."""
        self._fits(memory)
        return float(self.move(float(u), self.packed, memory, False) + self.polynomial_part(float(u)))

    def run(self, u: ArrayLike, memory: Floats | None = None) -> Floats:
        """Return the outputs (n,) along the inputs u (n,); `memory` changes in place, None starts in lower saturation.

        Raises
        ------
        ValueError : u is not finite or not one-dimensional, or a memory of the wrong length.
        """
        inputs = finite_array(u, "u")
        state = self.initial_memory() if memory is None else memory
        self._fits(state)
        out = np.empty_like(inputs)
        self.sweep(inputs, self.packed, state, out)
        return out + self.polynomial_part(inputs)

    def inverse(self, input_range: tuple[float, float] | None = None) -> Inverse:
        """Return the inverse over inputs (low, high); laws that know their own inputs take None for all of them.

        Raises
        ------
        ValueError : no input range, or one that is not in order.
        """
        if input_range is None:
            raise ValueError(f"input_range: found none, need (low, high) for the law {self.name!r}")
        return LawInverse(self, input_range)

    def to_parameters(self, section: str) -> dict[str, Value]:
        """Return the flat parameters `section.law` and `section.FIELD`, each a list, as a model file holds them."""
        flat: dict[str, Value] = {f"{section}.law": self.name}
        for name in self.described:
            flat[f"{section}.{name}"] = np.atleast_1d(np.asarray(getattr(self, name), float)).tolist()
        return flat

    @classmethod
    def from_parameters(cls, section: str, values: Mapping[str, Value]) -> Self:
        """Return the law that `to_parameters` wrote.

        Raises
        ------
        ValueError : a parameter is missing or not allowed; the message names it.
        """
        given: dict[str, Any] = {}
        for part in fields(cls):  # type: ignore[arg-type]
            value = values.get(f"{section}.{part.name}", []) if part.name in cls.described else []
            if np.size(value):
                given[part.name] = np.asarray(value, dtype=np.float64)
                if part.type == "float":
                    one = finite_array(given[part.name], f"{section}.{part.name}", ndim=(0, 1), size=1)
                    given[part.name] = float(one.flat[0])
            elif part.init and part.default is MISSING and part.default_factory is MISSING:
                raise ValueError(f"{section}.{part.name}: found none, need it for the law {cls.name!r}")
        try:
            return cls(**given)
        except ValueError as error:
            raise ValueError(f"{section}.{error}") from error

    def _fits(self, memory: Floats) -> None:
        check_memory(memory)
        if memory.shape != (self.memory_size,):
            raise ValueError(
                f"memory: found shape {memory.shape}, need ({self.memory_size},) from initial_memory or settle"
            )


def side_of(saturation: Saturation) -> float:
    """Return -1 for lower saturation, 1 for upper.

    Raises
    ------
    ValueError : another word.
    """
    if saturation not in ("lower", "upper"):
        raise ValueError(f"saturation: found {saturation!r}, need 'lower' or 'upper'")
    return -1.0 if saturation == "lower" else 1.0


def check_memory(memory: Floats) -> None:
    """Refuse a memory that a compiled step would not change in place, or not to the last digit.

    Parameters
    ----------
    memory : of one or many devices

    Raises
    ------
    ValueError : no array of float64 in the order of this machine, one that cannot be written to, or that holds a NaN.
    """
    if type(memory) is not np.ndarray or memory.dtype != np.float64:
        found = f"{memory.dtype} array" if isinstance(memory, np.ndarray) else type(memory).__name__
        raise ValueError(f"memory: found {found}, need an array of float64 from initial_memory or settle")
    if not memory.flags.writeable:
        raise ValueError("memory: found a read-only array, need one that a step may change: a copy")
    if np.isnan(memory).any():
        raise ValueError("memory: found a NaN, need numbers from initial_memory or settle")


class LawInverse:
    """Inverse of any law over an input range by bisection: the input of a monotone move that meets the output.

    Where the law is monotone, every output between the ends of the two moves is met. Otherwise the nearest end is given
    and flagged.

    Parameters
    ----------
    law : with an output that rises with the input
    input_range : (low, high) inputs allowed

    Raises
    ------
    ValueError : limits that are not finite or not in order.
    """

    def __init__(self, law: Law, input_range: tuple[float, float]) -> None:
        low, high = (float(v) for v in finite_array(input_range, "input_range", size=2))
        if not low < high:
            raise ValueError(f"input_range: found ({low:g}, {high:g}), need lower < upper")
        self.law = law
        self.input_range = low, high
        ends = [law.peek(v, law.settle(v)) for v in (low, high)]
        # from below both ends may lie in one saturation
        span = [end for end in (*ends, *law.span) if np.isfinite(end)]
        self._tolerance = REACHED * max(float(np.ptp(span)), np.finfo(float).tiny)

    def invert(self, output: float, memory: Floats) -> Inversion:
        """Return the input that a monotone move from the present one needs for the output; `memory` moves there.

        Raises
        ------
        ValueError : an output that is not finite.
        """
        from scipy.optimize import brentq  # loads slowly, and a node starts without it

        wanted = float(finite_array(output, "output", ndim=0))

        def error(u: float) -> float:
            return self.law.peek(u, memory) - wanted

        present = min(max(self.law.present_input(memory), self.input_range[0]), self.input_range[1])
        here = error(present)
        end = self.input_range[1] if here < 0 else self.input_range[0]
        if here == 0:
            u = present
        elif here * error(end) > 0:
            u = end
        else:
            u = float(
                brentq(error, present, end, xtol=1e-14 * max(abs(end), abs(present), 1e-300), rtol=1e-14)
            )
        reached = self.law.step(u, memory)
        return Inversion(u, reached, abs(reached - wanted) <= self._tolerance)
