"""Inverse of any play model, monotone or not: the solution nearest to the present input, for every reachable output.

For shared envelopes without memoryless part this *is* the analytic inverse (B.13): the pieces of the
inverse classical model are walked, and the envelope is inverted in closed form where it is linear in the unknown.
Unlike the fixed-point iteration of section 6.2 it needs neither condition (6.4) nor a play of radius zero, and takes
per-play envelopes and any memoryless part.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis import excursion_kernels, inverse_kernels, layout
from vo2_models.hysteresis.law import Inversion
from vo2_models.hysteresis.prandtl_ishlinskii import PlayModel
from vo2_models.validation import finite_array

__all__ = ["Inversion", "InversionBatch", "Plan", "RobustInverse", "is_monotone", "output_range"]

FloatArray = NDArray[np.float64]

SOLVER_TOLERANCE = 1e-12
REACHED_TOLERANCE = 1e-9
"""Both relative to the output range; rounding of the weighted sum is about 1e-15 of it."""


class Plan(NamedTuple):
    """Inputs to apply one after the other (one or two), the output they end at, and whether it is the one wanted."""

    inputs: tuple[float, ...]
    output: float
    reached: bool


class InversionBatch(NamedTuple):
    """Inverted samples of the shape asked for, and the memory after the last one."""

    input: FloatArray
    output: FloatArray
    reached: NDArray[np.bool_]
    state: FloatArray


def output_range(model: PlayModel, low: float, high: float) -> float:
    """Width of the outputs on the major loop between two inputs (200 inputs a branch) [output unit].

    Parameters
    ----------
    model : whose outputs
    low, high : inputs

    Returns
    -------
    float : [output unit]
    """
    path = np.concatenate([np.linspace(low, high, 200), np.linspace(high, low, 200)])
    state = model.initial_state("upper", v=low)
    output, _ = type(model).simulate(model, path, state)
    return float(np.ptp(output))


def is_monotone(model: PlayModel, low: float, high: float) -> bool:
    """True if no weight is negative and the memoryless part provably never falls on [low, high].

    Parameters
    ----------
    model : to check
    low, high : ends of the input

    Returns
    -------
    bool : False where it cannot be proven
    """
    if np.any(model.weights < 0):
        return False
    for kind, _, *numbers in model.memoryless.terms():
        if kind == layout.POLYNOMIAL:
            slope = np.polynomial.Polynomial(numbers).deriv()
            turns = slope.roots()
            inside = turns.real[(abs(turns.imag) < 1e-9) & (turns.real > low) & (turns.real < high)]
            places = np.concatenate([[low], np.sort(inside), [high]])
            if np.any(slope((places[1:] + places[:-1]) / 2) < 0):
                return False
        elif kind == layout.SATURATION:
            if numbers[0] * numbers[1] < 0:
                return False
        else:
            return False
    return True


@dataclass(frozen=True, eq=False)
class RobustInverse:
    """Inverse of a play model over an input range. Its memory is that of the model itself.

    `update`, `invert` and `simulate` meet a wish by one monotone move of the input from where it is. Of several
    solutions the nearest to the present input is taken, so small changes of the wish give small moves. A wish that no
    such move meets gives the input whose output is nearest, and `reached` False. `plan` then finds an excursion
    that makes it reachable, if there is one.

    Parameters
    ----------
    model : CPI, GPI or EGPI; any envelopes, any memoryless part
    input_range : (low, high) inputs allowed; None takes the model's

    Raises
    ------
    ValueError : no input range, or a model whose output does not change over it.

    Examples
    --------
    >>> from vo2_models.hysteresis import EGPI, Cosine
    >>> model = EGPI([0, 0.2, 0.4, 0.6, 0.8, 2], [6, 2, 1, 2, 4, 4], memoryless=Cosine(5.0))
    >>> inverse = RobustInverse(model, (-5.0, 5.0))
    >>> state = model.initial_state(v=0.0, memory=[0] * 6)
    >>> found = inverse.invert(12.0, state)
    >>> round(found.output, 9), found.reached
    (12.0, True)
    >>> inverse.invert(1e6, state).reached
    False
    """

    model: PlayModel
    input_range: tuple[float, float] | None = None
    output_range: float = field(init=False)
    monotone: bool = field(init=False)
    _packed: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        limits = self.input_range if self.input_range is not None else self.model.input_range
        if limits is None:
            raise ValueError("input_range: found none, need (low, high) here or in the model")
        low, high = (float(x) for x in finite_array(limits, "input_range", size=2))
        if not low < high:
            raise ValueError(f"input_range: found ({low:g}, {high:g}), need lower < upper")
        width = output_range(self.model, low, high)
        if not width > 0:
            raise ValueError(
                f"model: found an output that does not change over inputs {low:g} to {high:g}, "
                "need one that does; widen input_range or check the weights"
            )
        monotone = is_monotone(self.model, low, high)
        settings = [low, high, SOLVER_TOLERANCE * width, float(monotone)]
        object.__setattr__(self, "input_range", (low, high))
        object.__setattr__(self, "output_range", width)
        object.__setattr__(self, "monotone", monotone)
        object.__setattr__(self, "_packed", np.concatenate([settings, self.model.packed]))

    @property
    def packed(self) -> FloatArray:
        """The vector `inverse_kernels.invert_step` takes."""
        return self._packed

    def update(self, output: float, state: FloatArray) -> float:
        """Return the input for the wanted output; `state` (1 + N,) moves there in place."""
        v = inverse_kernels.invert_update(float(output), self._packed, state)
        if v == v:
            return v
        return self._refuse(output, state)

    def invert(self, output: float, state: FloatArray) -> Inversion:
        """Like `update`, with the output that results and whether it is the one wanted."""
        v, found = inverse_kernels.invert_step(float(output), self._packed, state)
        if v != v:
            self._refuse(output, state)
        return Inversion(v, found, abs(found - output) <= REACHED_TOLERANCE * self.output_range)

    def plan(self, output: float, state: FloatArray) -> Plan:
        """Like `invert`, but with an excursion first where one monotone move cannot give the output.

        In a non-monotone model an output may need another branch. The excursion is the shortest that makes it
        reachable. With weights >= 0 two inputs reach whatever any sequence of inputs within the range can: at any
        final input the plays are highest after a visit to the upper end and lowest after one to the lower end, and the
        outputs between follow by continuity.

        Examples
        --------
        >>> from vo2_models.hysteresis import EGPI, Linear, TanhEnvelopes
        >>> model = EGPI([0.0, 0.4], [1.0, 1.0], TanhEnvelopes(3.0, -1.5, 3.0, 1.5), Linear(-0.3))
        >>> inverse = RobustInverse(model, (-2.0, 2.0))
        >>> state = model.initial_state(v=-1.0)
        >>> inverse.invert(1.5, state.copy()).reached, inverse.plan(1.5, state).reached
        (False, True)
        """
        first, second, found = excursion_kernels.plan_step(float(output), self._packed, state)
        if second != second:
            self._refuse(output, state)
        inputs = (second,) if first != first else (first, second)
        return Plan(inputs, found, abs(found - output) <= REACHED_TOLERANCE * self.output_range)

    def simulate(self, output: ArrayLike, state: FloatArray | None = None) -> InversionBatch:
        """Invert a sequence of wanted outputs, (n,) or (m, n) for independent devices.

        `state` is the model's memory before the first, None for lower saturation; it is not changed.
        """
        wishes = finite_array(output, "output", ndim=(1, 2))
        rows = np.atleast_2d(wishes)
        if state is None:
            final = self.model.initial_state(devices=rows.shape[0])
        else:
            final = self.model._checked_state(state, rows.shape[0] if wishes.ndim == 2 else None)
        inputs, outputs = np.empty_like(rows), np.empty_like(rows)
        inverse_kernels.invert_many(rows, self._packed, final, inputs, outputs)
        reached = np.abs(outputs - rows) <= REACHED_TOLERANCE * self.output_range
        if wishes.ndim == 2:
            return InversionBatch(inputs, outputs, reached, final)
        return InversionBatch(inputs[0], outputs[0], reached[0], final[0])

    def _refuse(self, output: float, state: FloatArray) -> float:
        finite_array(output, "output", ndim=0)
        self.model._checked_state(state, None)
        raise ValueError(f"state: found values that give no output, need a memory of this model ({state!r})")
