"""Whether the plant does what it is told, from the current that comes back with its measurement."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from vo2_interface.lockstep import HOLD_SAMPLES

__all__ = ["CommandEcho"]

_AT_SAFE = 0.02
"""Share of the device's current range within which a measured current is the safe one: noise and offset of its sensor."""
_AWAY = 0.2
"""Share beyond which a command is not the safe current, for any driver: a dead zone is narrower."""
_SAME = 0.1
"""Share of the step between two commands within which a measured current is one of them."""
_STEP = 0.002
"""Share of the current range below which a step of the command does not matter."""
_STRAY = 10
"""Samples in a row for which a measured current is far from all commands and comes no nearer, from which it is astray."""


class CommandEcho:
    """Compares commands with the measured current.

    A plant that gets no commands goes to the safe current (the contract). So it does not listen when it is there though
    something else was commanded in each of the last periods. Gains and lags of a driver do not matter.

    Parameters
    ----------
    safe_a : safe current [A]
    span_a : width of the range of currents that the device bears [A]

    Attributes
    ----------
    followed : whether the plant follows the commands
    behind : whether it still applies one of the commands before the last: that one came late, or was lost
    astray : measured current [A] that has long been far from every command and comes no nearer: a driver that does not obey, or
        a sensor that does not tell; NaN where there is none
    told : last command that may show in it [A]
    """

    def __init__(self, safe_a: float, span_a: float) -> None:
        self._safe_a = safe_a
        self._at_safe_a, self._away_a = _AT_SAFE * span_a, _AWAY * span_a
        self._step_a = _STEP * span_a
        self._sent: deque[tuple[int, float]] = deque(maxlen=2 * HOLD_SAMPLES)
        self.restart()

    def restart(self) -> None:
        """Forget what was commanded: only what the plant does from now on counts."""
        self.followed = self.behind = False
        self._sent.clear()
        self.astray, self.told = math.nan, math.nan
        self._strays, self._strayed_by = 0, 0.0

    def command(self, stamp_ns: int, current_a: float) -> None:
        """Note a command."""
        self._sent.append((stamp_ns, current_a))

    def measure(self, stamp_ns: int, current_a: float) -> None:
        """Note a measured current [A]; NaN, not measured, counts as followed."""
        told = [current for at_ns, current in self._sent if at_ns < stamp_ns][-HOLD_SAMPLES:]
        if not told:
            return
        self.told = told[-1]
        self._look_astray(current_a, told)
        steps = [earlier - told[-1] for earlier in told[:-1]]
        self.behind = any(
            abs(step) > self._step_a and abs(current_a - told[-1] - step) <= _SAME * abs(step)
            for step in steps
        )
        if not abs(current_a - self._safe_a) <= self._at_safe_a:
            self.followed = True
        # a plant that came to the safe current of its own accord has left the loop, for one sample too: what an integrator
        # makes of that sample is an excursion. One that is late still applies one of the last commands
        elif min(abs(current - self._safe_a) for current in told) > self._away_a:
            self.followed = self.followed and len(told) < HOLD_SAMPLES
        else:
            self.followed = True

    def _look_astray(self, current_a: float, told: Sequence[float]) -> None:
        off = max(min(told) - current_a, current_a - max(told))
        if not off > self._away_a:
            self.astray, self._strays = math.nan, 0
            return
        if self._strays == 0 or off < self._strayed_by - self._at_safe_a:  # a slow driver is on its way
            self._strays, self._strayed_by = 0, off
        self._strays += 1
        self.astray = current_a if self._strays >= _STRAY else math.nan
