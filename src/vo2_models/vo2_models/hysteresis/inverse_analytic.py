"""Analytic inverses: of the classical model, (B.14)-(B.17), and through it of the generalised model, (B.13).

The generalised model with a shared pair of envelopes is the classical one, Pi, applied to its own play of
smallest radius: that play x carries gamma_R on the way up and gamma_L on the way down, and every other play follows
x alone. So x = Pi^-1[y], and the input is gamma_R^-1(x) where x rises, gamma_L^-1(x) where it falls, and stays where x
stays. The smallest radius need not be zero: gamma_R - r_0 and gamma_L + r_0 with radii r_j - r_0 are the same model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.envelopes import LinearEnvelopes
from vo2_models.hysteresis.kernels import envelope_inverse
from vo2_models.hysteresis.prandtl_ishlinskii import CPI, GPI
from vo2_models.validation import finite_array

__all__ = ["AnalyticInverse", "inverse_cpi", "inverse_cpi_state"]

FloatArray = NDArray[np.float64]


def _invertible(radii: FloatArray, weights: FloatArray) -> None:
    if radii[0] != 0:
        raise ValueError(
            f"radii: found smallest radius {radii[0]:g}, need 0: the inverse (B.15) rests on the play of radius zero"
        )
    if not weights[0] > 0:
        raise ValueError(f"weights: found {weights[0]:g} for the smallest radius, need it above 0 (B.16)")
    total = np.cumsum(weights)
    if np.any(total <= 0):
        k = int(np.flatnonzero(total <= 0)[0])
        raise ValueError(
            f"weights: found the sum of the first {k + 1} to be {total[k]:g}, need every such sum above 0 (B.17)"
        )


def inverse_cpi(model: CPI) -> GPI:
    """Return the inverse of a classical model: again one, (B.14)-(B.17), behind the shift y - bias.

    Raises
    ------
    ValueError : no play of radius 0, or weights whose leading sums are not all above 0.

    Examples
    --------
    >>> model = CPI([0.0, 1.0], [1.0, 1.0])
    >>> inverse = inverse_cpi(model)
    >>> inverse.radii.tolist(), inverse.weights.tolist()
    ([0.0, 1.0], [1.0, -0.5])
    """
    radii, weights = model.radii, model.weights
    _invertible(radii, weights)
    total = np.cumsum(weights)
    inverse_radii = np.concatenate([[0.0], np.cumsum(total[:-1] * np.diff(radii))])
    inverse_weights = np.concatenate([[1.0 / weights[0]], -weights[1:] / (total[1:] * total[:-1])])
    shift = LinearEnvelopes(1.0, -model.bias, 1.0, -model.bias)
    return GPI(inverse_radii, inverse_weights, shift)


def inverse_cpi_state(model: CPI, state: FloatArray) -> FloatArray:
    """Return the memory of `inverse_cpi(model)` that belongs to the model's memory `state` (1 + N,).

    The inverse's plays are w^_j = w_j sum_{i <= j} p_i + sum_{i > j} p_i w_i.
    """
    memory, weights = model._checked_state(state, None)[0][1:], model.weights
    contributions = weights * memory
    smaller = memory * np.cumsum(weights)
    larger = np.sum(contributions) - np.cumsum(contributions)
    return np.concatenate([[model.output(state)], smaller + larger])


@dataclass(frozen=True, eq=False)
class AnalyticInverse:
    """Inverse (B.13) of a generalised model with a shared pair of envelopes, for whole sequences.

    Parameters
    ----------
    model : GPI with a shared envelope pair and weights whose leading sums are above 0
    input_range : (low, high) inputs in use; None takes the model's

    Raises
    ------
    ValueError : one pair per play, weights that do not allow it, or no input range.
    """

    model: GPI
    input_range: tuple[float, float] | None = None
    classical: CPI = field(init=False, repr=False)

    def __post_init__(self) -> None:
        limits = self.input_range if self.input_range is not None else self.model.input_range
        if limits is None:
            raise ValueError("input_range: found none, need (low, high) here or in the model")
        if self.model.envelopes.plays is not None:
            raise ValueError(
                "model: found one envelope pair per play, need a shared one; RobustInverse takes both"
            )
        if self.model.memoryless.terms():
            raise ValueError("model: found a memoryless part, need none; RobustInverse takes both")
        low, high = (float(x) for x in finite_array(limits, "input_range", size=2))
        radii = self.model.radii
        classical = CPI(radii - radii[0], self.model.weights, self.model.bias)
        _invertible(classical.radii, classical.weights)
        object.__setattr__(self, "input_range", (low, high))
        object.__setattr__(self, "classical", classical)

    def simulate(self, output: ArrayLike, state: FloatArray) -> FloatArray:
        """Return the inputs (n,) that give the wanted outputs (n,), from the model's memory `state` (1 + N,).

        Raises
        ------
        ValueError : an output that no input in the range gives; the message names the sample.
        """
        wishes = finite_array(output, "output")
        memory = self.model._checked_state(state, None)[0]
        if not np.all(np.isfinite(memory)):
            raise ValueError("state: found infinite values, need a finite input to start from")
        low, high = cast("tuple[float, float]", self.input_range)  # set at the start
        shift = float(self.model.radii[0])
        start = np.concatenate([memory[1:2], memory[1:]])
        inner, _ = inverse_cpi(self.classical).simulate(wishes, inverse_cpi_state(self.classical, start))
        kind, stride, numbers = self.model.envelopes.packed()
        blocks = numbers[:stride], numbers[stride:]
        inputs = np.empty_like(wishes)
        now, before = memory[0], memory[1]
        rounding = 1e-13 * (1.0 + np.max(np.abs(inner), initial=0.0))
        for k, x in enumerate(inner.tolist()):
            if abs(x - before) > rounding:
                rising = x > before
                g = x + shift if rising else x - shift
                now = envelope_inverse(kind, blocks[0 if rising else 1], 1, stride, 0, g)
                before = x
            slack = 1e-9 * (high - low)
            if not low - slack <= now <= high + slack:
                raise ValueError(
                    f"output: found {wishes[k]:g} at index {k}, which needs an input of {now:g}; need outputs that "
                    f"inputs {low:g} to {high:g} can give, or RobustInverse, which takes the nearest"
                )
            inputs[k] = now
        return inputs
