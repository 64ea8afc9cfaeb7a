"""Self-sensing on a stream whose past is not wholly known: after a cold start, after samples that got lost.

What the hysteresis remembers of an unseen stretch lies between two extremes: that the device went to the hot end of
its major loop and came back, and that it went to the cold end (wiping-out, section 2.3: either erases all that was
before). Each extreme is carried along as a memory of its own. The estimate goes on from the memory that is bridged
monotonically; its error bound grows by the distance to the farthest of the others. At the ends of the major loop all of
them become equal: the memory is known again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.self_sensing.scheme import SelfSensing

__all__ = ["StreamingMemory"]

Floats = NDArray[np.float64]

_BEYOND = 2.0
"""Factor beyond the resistances in use at which the major loop is closed for certain."""
_EQUAL = 1e-6
"""Relative difference of two memories below which they are one: the inverse is solved to far less."""
_END = 0.05
"""Share of the logarithmic range next to either end at which branches have met, as far as resistances in use go."""


class StreamingMemory:
    """A scheme and what it remembers, with the extremes that an unseen stretch leaves possible.

    Parameters
    ----------
    scheme : any self-sensing scheme
    resistance_range : lowest and highest resistance in use [ohm]

    Attributes
    ----------
    known : whether one memory is left
    """

    def __init__(self, scheme: SelfSensing, resistance_range: tuple[float, float]) -> None:
        self._scheme = scheme
        low, high = resistance_range
        self._ends = (low / _BEYOND, high * _BEYOND)
        near = (high / low) ** _END
        self._hot, self._cold = low * near, high / near
        self.restart()

    @property
    def known(self) -> bool:
        return not self._others

    def restart(self) -> None:
        """Begin with a device of unknown past, taken for one that comes from the cold."""
        self._state = self._scheme.initial_state()
        self.bridge()

    def bridge(self) -> None:
        """Between two samples others were lost: any excursion is possible."""
        self._others = [self._at_end(resistance) for resistance in self._ends]
        self._met_hot = self._met_cold = False

    def _at_end(self, resistance: float) -> Floats:
        state = self._state.copy()
        self._scheme.step(resistance, state)
        return state

    def step(self, resistance: float) -> tuple[float, float, float]:
        """Return (deflection [m], temperature surrogate [A], bound [m]) for a resistance [ohm]."""
        deflection, _temperature, surrogate, bound = self._scheme.step(resistance, self._state)
        if self._others:
            distance = 0.0
            for other in self._others:
                distance = max(distance, abs(self._scheme.step(resistance, other)[0] - deflection))
            bound += distance
            self._met_hot |= resistance <= self._hot
            self._met_cold |= resistance >= self._cold
            self._others = [other for other in self._others if not self._is_known(other)]
        return deflection, surrogate, bound

    def _is_known(self, other: Floats) -> bool:
        """Whether a memory is the one of the estimate: exactly, or as far as both ends of the loop in use tell."""
        # turns that were never made are infinite
        scale = float(np.max(np.abs(self._state), initial=0.0, where=np.isfinite(self._state)))
        apart = other != self._state
        same = bool(np.all(np.abs(other[apart] - self._state[apart]) <= _EQUAL * scale))
        return same or (self._met_hot and self._met_cold)
