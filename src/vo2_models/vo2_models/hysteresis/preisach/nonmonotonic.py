"""Non-monotonic hysteresis: a Preisach operator minus thermal expansion that depends on the phase, chapter 5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Inverse, Law, LawInverse, Saturation
from vo2_models.hysteresis.preisach.grid import cell_count, checked_walls
from vo2_models.hysteresis.preisach.kernels import move_preisach, sweep_preisach
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.validation import finite_array

__all__ = ["NonMonotonicPreisach", "fit_nonmonotonic", "phase_fraction"]

Floats = NDArray[np.float64]


def phase_fraction(temperature: Floats, low: float, high: float) -> Floats:
    """Return theta of (5.6): the share of the high-temperature phase, linear between `low` and `high`."""
    return np.clip((temperature - low) / (high - low), 0.0, 1.0)


EXPANSION = 5
"""Elements of a packed model before its operator: k0, k1, reference, low, high."""


@kernel
def expansion(t, packed):
    """kappa_E of (5.7) at the temperature t [degC]."""
    theta = min(max((t - packed[3]) / (packed[4] - packed[3]), 0.0), 1.0)
    return -(packed[0] * (1.0 - theta) + packed[1] * theta) * (t - packed[2])


@kernel
def move_nonmonotonic(t, packed, memory, make):
    """Compiled step of the law: `packed` as `NonMonotonicPreisach.packed`, the memory of its operator."""
    return move_preisach(t, packed[EXPANSION:], memory, make) + expansion(t, packed)


@kernel
def sweep_nonmonotonic(t, packed, memory, out):
    """`move_nonmonotonic` along the temperatures t (n,)."""
    sweep_preisach(t, packed[EXPANSION:], memory, out)
    for k in range(t.size):
        out[k] += expansion(t[k], packed)


@dataclass(frozen=True, eq=False)
class NonMonotonicPreisach(Law):
    """kappa = Gamma[T] - (k0 (1 - theta(T)) + k1 theta(T)) (T - T0): (5.8), with the sign of (5.7).

    The bias c_0 is the operator's. The printed (5.8) has a plus before k1; (5.7) and (5.12) have the minus that
    the physics needs. theta runs from 0 to 1 over the operator's grid [T_min, T_max].

    Parameters
    ----------
    operator : Gamma; the memory is its memory
    k0, k1 : expansion of the low- and high-temperature phase [output unit / K]
    reference : T0, where the expansion is zero [degC]

    Examples
    --------
    >>> operator = PreisachOperator([30.0, 50.0, 70.0], np.full(3, 0.5))
    >>> model = NonMonotonicPreisach(operator, k0=2.0, k1=4.0)
    >>> memory = model.initial_memory()
    >>> [model.step(t, memory) for t in (25.0, 70.0, 90.0, 50.0)]
    [-410.0, 200.0, 120.0, 110.0]
    """

    name = "nonmonotonic"
    move = staticmethod(move_nonmonotonic)
    sweep = staticmethod(sweep_nonmonotonic)
    described: ClassVar = {
        **PreisachOperator.described,
        "k0": ("{y}/{u}", "expansion of the low-temperature phase"),
        "k1": ("{y}/{u}", "expansion of the high-temperature phase"),
        "reference": ("{u}", "temperature of no expansion"),
    }

    operator: PreisachOperator
    k0: float
    k1: float
    reference: float = 20.0
    parabola: tuple[float, float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("k0", "k1", "reference"):
            object.__setattr__(self, name, float(finite_array(getattr(self, name), name, ndim=0)))
        low, high = self.operator.walls[[0, -1]]
        rate = (self.k1 - self.k0) / (high - low)
        # -(k0 + rate (T - low)) (T - T0), expanded: Q of (5.15)
        constant = (self.k0 - rate * low) * self.reference
        linear = -(self.k0 - rate * low) + rate * self.reference
        object.__setattr__(self, "parabola", (float(constant), float(linear), float(-rate)))

    def expansion(self, temperature: ArrayLike) -> Floats:
        """Return the memoryless part kappa_E (5.7) at `temperature` [degC], any shape."""
        t = np.asarray(temperature, dtype=np.float64)
        theta = phase_fraction(t, *self.operator.walls[[0, -1]])
        return -(self.k0 * (1 - theta) + self.k1 * theta) * (t - self.reference)

    @cached_property
    def packed(self) -> Floats:
        """[k0, k1, reference, low, high] and the packed operator."""
        low, high = self.operator.walls[[0, -1]]
        return np.concatenate([[self.k0, self.k1, self.reference, low, high], self.operator.packed])

    @property
    def memory_size(self) -> int:
        """Length of the memory, that of the operator."""
        return self.operator.memory_size

    @property
    def span(self) -> tuple[float, float]:
        """Output in both saturations, at the ends of the grid."""
        low, high = self.operator.output_range
        ends = self.expansion(self.operator.walls[[0, -1]])
        return low + float(ends[0]), high + float(ends[1])

    def initial_memory(self, saturation: Saturation = "lower", *, devices: int | None = None) -> Floats:
        """Return the operator's memory in saturation."""
        return self.operator.initial_memory(saturation, devices=devices)

    def present_input(self, memory: Floats) -> float:
        """Temperature that the memory was last moved to, within the grid [degC]."""
        return self.operator.present_input(memory)

    def inverse(self, input_range: tuple[float, float] | None = None) -> Inverse:
        """Return the inverse of section 5.4.1 over the grid, the one by bisection over inputs (low, high) that do not cover it.

        That of section 5.4.1 may need two temperatures, and visits the ends of the grid.

        Raises
        ------
        ValueError : an input range that is not in order.
        """
        from vo2_models.hysteresis.preisach.nonmonotonic_inverse import NonMonotonicInverse

        first, last = self.operator.walls[[0, -1]]
        if input_range is None or (input_range[0] <= first and last <= input_range[1]):
            return NonMonotonicInverse(self)
        return LawInverse(self, input_range)

    def step_devices(self, temperature: ArrayLike, memory: Floats) -> Floats:
        """Apply one temperature [degC] to each device and return the outputs (devices,); `memory` changes in place."""
        return self.operator.step_devices(temperature, memory) + self.expansion(temperature)

    def run(self, u: ArrayLike, memory: Floats | None = None) -> Floats:
        """Apply temperatures (n,) or (devices, n) [degC]; return the outputs; `memory` changes in place."""
        return self.operator.run(u, memory) + self.expansion(u)

    def __call__(self, temperature: ArrayLike, memory: Floats | None = None) -> Floats:
        """Return the output under `temperature`, from `memory` (not changed) or negative saturation."""
        return self.run(temperature, None if memory is None else memory.copy())

    def to_parameters(self, section: str) -> dict[str, Value]:
        """Return the flat parameters of the operator and of the expansion."""
        expansion = {f"{section}.{name}": float(getattr(self, name)) for name in ("k0", "k1", "reference")}
        return self.operator.to_parameters(section) | {f"{section}.law": self.name} | expansion

    @classmethod
    def from_parameters(cls, section: str, values: Mapping[str, Value]) -> NonMonotonicPreisach:
        """Return the model that `to_parameters` wrote."""
        numbers = [float(values[f"{section}.{name}"]) for name in ("k0", "k1", "reference")]  # type: ignore[arg-type]
        return cls(PreisachOperator.from_parameters(section, values), *numbers)


def fit_nonmonotonic(
    temperature: ArrayLike,
    output: ArrayLike,
    walls: ArrayLike,
    *,
    reference: float = 20.0,
    history: ArrayLike | None = None,
) -> NonMonotonicPreisach:
    """Least squares for densities, k0, k1 >= 0 and a free bias: section 5.3.1.

    Parameters
    ----------
    temperature, output : (n,) quasi-static recording, from negative saturation or after `history`. It must
        go below and above the transition region, where only the expansion acts.
    walls : (L + 1,) grid over the transition region [T_min, T_max]
    reference : T0 of (5.7)
    history : inputs before the first sample, from negative saturation

    Returns
    -------
    NonMonotonicPreisach : fitted

    Raises
    ------
    ValueError : not finite, shapes differ, or an input that cannot tell the unknowns apart.
    """
    # scipy's linear algebra, without which a node starts an eighth of a second earlier
    from vo2_models.hysteresis.preisach.nnls import RankDeficientError, nonnegative_least_squares

    grid = checked_walls(walls)
    t = finite_array(temperature, "temperature")
    u = finite_array(output, "output", size=t.size)
    cells = cell_count(grid.size - 1)
    theta = phase_fraction(t, grid[0], grid[-1])
    slopes = np.stack([(1 - theta) * (reference - t), theta * (reference - t)], axis=1)
    matrix = np.hstack([signed_area_matrix(t, grid, history=history), slopes])
    free = np.arange(matrix.shape[1]) == cells
    try:
        w = nonnegative_least_squares(matrix, u, free)
    except RankDeficientError as error:
        raise ValueError(
            f"temperature: found too little excitation ({error}), need damped oscillations over the walls and samples "
            "on either side of them"
        ) from error
    operator = PreisachOperator(grid, w[:cells], float(w[cells]))
    return NonMonotonicPreisach(operator, float(w[cells + 1]), float(w[cells + 2]), reference)
