"""Inverse of the extended model by the fixed-point iteration of section 6.2, with its convergence condition.

Kept for comparison: `RobustInverse` needs no condition and fewer evaluations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis import inverse_kernels
from vo2_models.hysteresis.inverse_robust import RobustInverse
from vo2_models.hysteresis.kernels import egpi_step
from vo2_models.hysteresis.prandtl_ishlinskii import GPI, PlayModel
from vo2_models.validation import finite_array, positive_number

__all__ = ["ConvergenceCondition", "FixedPointBatch", "FixedPointInverse", "convergence_condition"]

FloatArray = NDArray[np.float64]
_GRID = 4001


class ConvergenceCondition(NamedTuple):
    """Condition (6.4) over an input range: min slope of the envelopes times p(r_0) above max |dD/dv|.

    It is sufficient, not necessary, and fails outside the transition, where tanh flattens (errata).
    """

    hysteresis_slope: float
    """min over v of {gamma_R', gamma_L'} times the weight of radius zero [output unit per input unit]."""
    memoryless_slope: float
    """max over v of |D'| [output unit per input unit]."""
    holds: bool


def convergence_condition(model: PlayModel, input_range: tuple[float, float]) -> ConvergenceCondition:
    """Evaluate (6.4), in its corrected form with |dD/dv|, on 4001 inputs of the range.

    Parameters
    ----------
    model : to be inverted
    input_range : lowest and highest input

    Returns
    -------
    ConvergenceCondition : both sides of (6.4), and whether it holds

    Examples
    --------
    >>> from vo2_models.hysteresis import EGPI, Cosine
    >>> model = EGPI([0, 0.2, 0.4, 0.6, 0.8, 2], [6, 2, 1, 2, 4, 4], memoryless=Cosine(5.0))
    >>> condition = convergence_condition(model, (-5.0, 5.0))
    >>> round(condition.hysteresis_slope, 3), round(condition.memoryless_slope, 3), condition.holds
    (6.0, 5.0, True)
    """
    low, high = finite_array(input_range, "input_range", size=2)
    v = np.linspace(low, high, _GRID)
    zero = model.radii == 0
    hysteresis = 0.0
    if np.any(zero):
        branches = (model.envelopes.rising(v), model.envelopes.falling(v))
        rising, falling = (np.gradient(b.reshape(_GRID, -1), v, axis=0, edge_order=2) for b in branches)
        per_play = np.broadcast_to(np.minimum(rising, falling), (_GRID, model.plays))
        hysteresis = float(np.min(per_play[:, zero] @ model.weights[zero]))
    steepest = float(np.max(np.abs(model.memoryless.slope(v))))
    return ConvergenceCondition(hysteresis, steepest, bool(hysteresis > steepest))


class FixedPointBatch(NamedTuple):
    """Inverted samples (n,), the iterations each took, where it converged, and the final memory."""

    input: FloatArray
    output: FloatArray
    iterations: NDArray[np.int64]
    converged: NDArray[np.bool_]
    state: FloatArray


@dataclass(frozen=True, eq=False)
class FixedPointInverse:
    """v_k = Psi^-1[u_d - D(v_{k-1})] until |v_k - v_{k-1}| < tolerance, (6.3).

    Parameters
    ----------
    model : EGPI
    input_range : (low, high) inputs allowed; None takes the model's
    tolerance : sigma [input unit]
    max_iterations : after which a sample counts as not converged
    """

    model: PlayModel
    input_range: tuple[float, float] | None = None
    tolerance: float = 1e-4
    max_iterations: int = 200
    condition: ConvergenceCondition = field(init=False)
    hysteresis: RobustInverse = field(init=False, repr=False)

    def __post_init__(self) -> None:
        model = self.model
        positive_number(self.tolerance, "tolerance")
        if int(self.max_iterations) < 1:
            raise ValueError(f"max_iterations: found {self.max_iterations}, need at least 1")
        limits = self.input_range if self.input_range is not None else model.input_range
        part = GPI(model.radii, model.weights, model.envelopes, model.bias, limits, "accept")
        inverse = RobustInverse(part)
        object.__setattr__(self, "hysteresis", inverse)
        object.__setattr__(self, "input_range", inverse.input_range)
        given = cast("tuple[float, float]", inverse.input_range)  # the inverse has taken the model's
        object.__setattr__(self, "condition", convergence_condition(model, given))

    def simulate(self, output: ArrayLike, state: FloatArray | None = None) -> FixedPointBatch:
        """Invert wanted outputs (n,) from the model's memory `state` (1 + N,), lower saturation if None."""
        wishes = finite_array(output, "output")
        start = self.model.initial_state() if state is None else state
        memory = self.model._checked_state(start, None)[0]
        low, high = cast("tuple[float, float]", self.input_range)  # set at the start
        if not low <= memory[0] <= high:
            egpi_step(min(max(memory[0], low), high), self.model.packed, memory)
        inputs, outputs = np.empty_like(wishes), np.empty_like(wishes)
        iterations = np.zeros(wishes.size, dtype=np.int64)
        converged = np.zeros(wishes.size, dtype=bool)
        for k, wish in enumerate(wishes.tolist()):
            v = float(memory[0])
            for iteration in range(1, self.max_iterations + 1):
                rest = wish - float(self.model.memoryless(v))
                before, v = v, inverse_kernels.solve(rest, self.hysteresis.packed, memory)
                iterations[k] = iteration
                if abs(v - before) < self.tolerance:
                    converged[k] = True
                    break
            inputs[k] = v
            outputs[k] = egpi_step(v, self.model.packed, memory)
        return FixedPointBatch(inputs, outputs, iterations, converged, memory)
