"""What a loop does while its input is missing: hold, then the safe current, then start again without a bump."""

from __future__ import annotations

import math

from vo2_plant_sim.interface.lockstep import HOLD_SAMPLES

__all__ = ["InputGuard"]


class InputGuard:
    """Counts missed inputs and says which current is due.

    Parameters
    ----------
    safe_current_a : where the loop goes after `HOLD_SAMPLES` missed inputs [A]

    Attributes
    ----------
    missed : inputs missed in a row
    needs_restart : whether the law must start anew at its next input: at the very start, and after the
        safe current was applied
    """

    def __init__(self, safe_current_a: float) -> None:
        self.safe_current_a = safe_current_a
        self.missed = 0
        self.needs_restart = True
        self._last_a = safe_current_a
        self._has_commanded = False

    def miss(self) -> float:
        """Count one missed input; return the current to apply [A]."""
        self.missed += 1
        if self.missed > HOLD_SAMPLES:
            self.needs_restart = True
            self._last_a = self.safe_current_a
            self._has_commanded = True
        return self._last_a

    def used(self, current_a: float) -> None:
        """Note that an input was there and led to `current_a` [A]."""
        self.missed = 0
        self.needs_restart = False
        self._has_commanded = True
        self._last_a = current_a

    @property
    def is_safe(self) -> bool:
        """Whether the safe current is being applied."""
        return self.missed > HOLD_SAMPLES

    def start_from(self, surrogate_a: float) -> float:
        """Return the current to start the law from without a bump [A].

        The current applied last; at the very start, when another node may have commanded before, the
        temperature surrogate, which is the current that holds the present temperature.
        """
        return surrogate_a if not self._has_commanded and math.isfinite(surrogate_a) else self._last_a
