"""A bank of generalized plays with tanh envelopes and a polynomial, and its compiled step.

The step is `hysteresis.kernels.egpi_step` for this one kind of model, on the same packed vector and the same memory.
It exists because a device calls it several times per sample: it takes no slices (each costs two atomic reference
counts in a compiled loop), tries a move without copying the memory, and its tanh has no branch and no call, so
that the compiler takes several plays at a time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Inverse, Law, Saturation, side_of
from vo2_models.hysteresis.layout import HEADER, TANH
from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.validation import finite_array, nonnegative

if TYPE_CHECKING:
    from vo2_models.hysteresis.prandtl_ishlinskii import EGPI

__all__ = ["PlayBank", "middle_plays", "move_plays", "of_reversible", "reversible_plays", "tanh"]

Floats = NDArray[np.float64]

_FARTHEST = 40.0
"""Where tanh is 1 to the last bit: exp(-40) < 2^-54."""
_LOOP_POINTS = 801
"""Points of a branch of the major loop."""
_NARROW = 0.15
"""Width of a play's own loop, as a share of the mean, below which it is reversible: each play fitted to six devices of
the own simulator had at most 0.11 of it or at least 0.2."""


@kernel(inline="always")
def tanh(a):
    """tanh a from p = exp(-2 |a|) - 1, which is within 1e-15 of the value, relatively too.

    p of a 1024th of the exponent is a short series, and p(2y) = p(y) (2 + p(y)) doubles it ten times.
    """
    y = max(-2.0 * abs(a), -_FARTHEST) * (1.0 / 1024.0)
    p = y * (1.0 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * (1 / 720 + y * (1 / 5040)))))))
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    return math.copysign(-p / (2.0 + p), a)


# the sum may be taken in another order: that is what lets several plays be taken at a time
@kernel(fastmath={"reassoc", "contract", "nsz"})
def move_plays(v, packed, memory, make):
    """Weighted sum of the plays at the input v [degC]; the memory (1 + N,) moves there where `make` is true."""
    n = int(packed[0])
    previous = memory[0]
    total = 0.0
    if v == previous:
        for j in range(n):
            total += packed[HEADER + j] * memory[1 + j]
        return total
    if v > previous:
        for j in range(n):
            place = HEADER + j
            gamma = tanh(packed[place + 2 * n] * v + packed[place + 3 * n])
            level = max(gamma - packed[place + n], memory[1 + j])
            if make:
                memory[1 + j] = level
            total += packed[place] * level
    else:
        for j in range(n):
            place = HEADER + j
            gamma = tanh(packed[place + 4 * n] * v + packed[place + 5 * n])
            level = min(gamma + packed[place + n], memory[1 + j])
            if make:
                memory[1 + j] = level
            total += packed[place] * level
    if make:
        memory[0] = v
    return total


@kernel(fastmath={"reassoc", "contract", "nsz"})
def middle_plays(v, packed):
    """Weighted sum of the plays half way between the two major branches at the input v [degC]."""
    n = int(packed[0])
    total = 0.0
    for j in range(n):
        place = HEADER + j
        radius = packed[place + n]
        heating = max(tanh(packed[place + 2 * n] * v + packed[place + 3 * n]) - radius, radius - 1.0)
        cooling = min(tanh(packed[place + 4 * n] * v + packed[place + 5 * n]) + radius, 1.0 - radius)
        total += packed[place] * 0.5 * (heating + cooling)
    return total


@kernel(inline="always")
def of_reversible(n):
    """Place in a packed bank of n plays of the number of those that have no loop of their own; which they are comes next."""
    return HEADER + 6 * n


@kernel(forceinline=True)
def reversible_plays(v, packed):
    """Weighted sum at the input v [degC] of the plays that have no loop of their own, see `PlayBank.reversible`."""
    n = int(packed[0])
    count = of_reversible(n)
    total = 0.0
    for j in range(int(packed[count])):
        place = HEADER + int(packed[count + 1 + j])
        slope = 0.5 * (packed[place + 2 * n] + packed[place + 4 * n])
        total += packed[place] * math.tanh(slope * v + 0.5 * (packed[place + 3 * n] + packed[place + 5 * n]))
    return total


@kernel
def sweep_plays(u, packed, memory, out):
    """`move_plays` along the inputs u (n,)."""
    for k in range(u.size):
        out[k] = move_plays(u[k], packed, memory, True)


@dataclass(frozen=True)
class PlayBank(Law):
    """output(T) = sum_j weight_j F_j[T] + polynomial(T), F_j a play of envelopes tanh(slope T + offset): (7.3)-(7.7).

    Attributes (all float arrays; N plays)
    ----------
    weights, radii : (N,) in the output's unit; 1
    rising_slopes, rising_offsets, falling_slopes, falling_offsets : (N,) envelopes [1/K], [1]
    polynomial : (m,) coefficients of 1, T, T^2 ... in degC, in the output's unit
    """

    name = "plays"
    move = staticmethod(move_plays)
    sweep = staticmethod(sweep_plays)
    described: ClassVar = {
        "weights": ("{y}", "weights of the plays"),
        "radii": ("1", "play radii"),
        "rising_slopes": ("1/{u}", "slopes of the rising tanh envelopes"),
        "rising_offsets": ("1", "offsets of the rising tanh envelopes"),
        "falling_slopes": ("1/{u}", "slopes of the falling tanh envelopes"),
        "falling_offsets": ("1", "offsets of the falling tanh envelopes"),
        "polynomial": ("{y}", "coefficients of the powers of the input, lowest first,"),
    }

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

    @classmethod
    def from_parameters(cls, section: str, values: Mapping[str, Value]) -> Self:
        """Return the bank of a section; as `Law.from_parameters`.

        Raises
        ------
        ValueError : another law, envelopes that do not rise, or radii that are negative or out of order; names the parameter.
        """
        written = values.get(f"{section}.law") or cls.name
        if written != cls.name:
            raise ValueError(f"{section}.law: found {written!r}, need {cls.name!r} here (fit --law plays)")
        bank = super().from_parameters(section, values)
        for name in ("rising_slopes", "falling_slopes"):
            slopes = np.asarray(getattr(bank, name))
            if np.any(slopes <= 0):
                k = int(np.flatnonzero(slopes <= 0)[0])
                raise ValueError(
                    f"{section}.{name}: found {slopes[k]:g} at index {k}, need slopes above 0: an envelope rises with its input"
                )
        radii = nonnegative(np.asarray(bank.radii), f"{section}.radii")
        if np.any(np.diff(radii) < 0):
            k = int(np.flatnonzero(np.diff(radii) < 0)[0]) + 1
            raise ValueError(
                f"{section}.radii: found {radii[k]:g} after {radii[k - 1]:g} at index {k}, need ascending radii"
            )
        return bank

    @property
    def present(self) -> bool:
        """Whether there is a law at all (a recording may lack the channel)."""
        return np.size(self.polynomial) > 0

    @cached_property
    def packed(self) -> Floats:
        """The plays as `hysteresis.kernels` packs them, without bias and polynomial; how many are `reversible`, and which."""
        count = np.size(self.weights)
        header = np.array([count, TANH, 0.0, 2.0, 0.0, 0.0])
        parts = [getattr(self, part.name) for part in fields(self)[:-1]]
        return np.concatenate([header, *parts, [self.reversible.size], self.reversible])

    @cached_property
    def reversible(self) -> NDArray[np.intp]:
        """Which plays have next to no loop of their own: (m,) indices.

        A device's expansion, or how its resistance falls outside the transition, is part of what a bank is fitted to. Where the
        polynomial does not describe it a play does, nearly without a loop. On a heated body it follows the temperature and not
        the phase.
        """
        widths, share = self._widths, np.abs(self.weights)
        return np.flatnonzero(widths * np.sum(share) < _NARROW * np.dot(share, widths))

    @property
    def loop_width(self) -> float:
        """Width of the loops, by the weights of the plays that have one, in the input's unit; 0 without any."""
        share = np.delete(np.abs(self.weights), self.reversible)
        return float(np.dot(share, np.delete(self._widths, self.reversible)) / max(np.sum(share), 1e-300))

    def half_way(self, low: float, high: float) -> tuple[float, float, float]:
        """Return where both branches of the major loop between two inputs are half way, and its span.

        Parameters
        ----------
        low, high : ends of the loop [input unit]

        Returns
        -------
        input at half way with rising and with falling input, NaN for a branch that does not get there, and the span [output unit]
        """
        up = np.linspace(low, high, _LOOP_POINTS)
        memory = self.settle(low)
        branches = (self.run(up, memory), self.run(up[::-1], memory)[::-1])
        ends = [end(branch) for branch in branches for end in (np.min, np.max)]
        crossed = [np.flatnonzero(np.diff(branch >= 0.5 * (min(ends) + max(ends)))) for branch in branches]
        rising, falling = (float(np.mean(up[at])) if at.size else math.nan for at in crossed)
        return rising, falling, float(max(ends) - min(ends))

    @cached_property
    def _widths(self) -> Floats:
        """Width (N,) of each play's own loop, where its output passes zero, in the input's unit."""
        radii = np.minimum(np.asarray(self.radii), 1.0 - 1e-12)
        up = (np.arctanh(radii) - np.asarray(self.rising_offsets)) / np.asarray(self.rising_slopes)
        down = (-np.arctanh(radii) - np.asarray(self.falling_offsets)) / np.asarray(self.falling_slopes)
        return np.asarray(np.maximum(up - down, 0.0))

    @property
    def memory_size(self) -> int:
        """Length of the memory: present input and the outputs of the plays."""
        return 1 + np.size(self.weights)

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest weighted sum of the plays: both saturations."""
        reach = 1.0 - np.asarray(self.radii)
        high = float(np.dot(self.weights, reach))
        return -high, high

    def initial_memory(self, saturation: Saturation = "lower") -> Floats:
        """Return the memory (memory_size,) far in saturation."""
        side = side_of(saturation)
        return np.concatenate([[side * np.inf], side * (1.0 - np.asarray(self.radii))])

    def egpi(self) -> EGPI:
        """Return the law as a model with an exact inverse, see `EGPI`."""
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

    def inverse(self, input_range: tuple[float, float] | None = None) -> Inverse:
        """Return the inverse of `egpi` over inputs (low, high)."""
        return self.egpi().inverse(input_range)

    def to_parameters(self, section: str) -> dict[str, Value]:
        """Return `{section.name: list}`; the law of a section without a name is this one."""
        return {f"{section}.{part.name}": getattr(self, part.name).tolist() for part in fields(self)}
