"""What of the commands on a topic reaches a driven device in wall time."""

from __future__ import annotations

import math

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.lockstep import HOLD_SAMPLES
from vo2_interface.model import OperatingPoint
from vo2_interface.topics import COMMAND

__all__ = ["CommandGate"]

_SOLE = "another node commands too; only the first is heard until it is silent: let one node command"


class CommandGate:
    """Lets through commands of one node, young, in order and within limits; after three periods without, the safe current.

    Periods count from the sample that the last command answered, whenever the command came: a late one is held for less.

    Parameters
    ----------
    point : limits and safe current of the device
    period_ns : sample period [ns]
    diagnostics : where refusals are told, as `command`, `commanders` and `stale`

    Attributes
    ----------
    answered_ns : stamp of the newest sample that a command answered
    """

    def __init__(self, point: OperatingPoint, period_ns: int, diagnostics: Diagnostics) -> None:
        self._least_a, self._most_a, self._safe_a = point.least_a, point.most_a, point.safe_a
        self._period_ns, self._diagnostics = period_ns, diagnostics
        self._unit = point.unit
        self.reset()

    def reset(self) -> None:
        """Begin anew, at the safe current."""
        self.answered_ns = 0
        self._current_a: float | None = None
        self._borne = True
        self._silent = self._age = HOLD_SAMPLES + 1
        self._commander = math.nan

    def borne(self, current_a: float, stamp_ns: int) -> float:
        """Return what the device bears of a commanded current [A], and tell where that is another one."""
        self._borne = self._least_a <= current_a <= self._most_a
        if self._borne:
            return current_a
        if math.isfinite(current_a):
            applied = min(max(current_a, self._least_a), self._most_a)
            why = f"outside the {self._least_a:g} to {self._most_a:g} {self._unit} that the device bears"
        else:
            applied, why = self._safe_a, "absent or not finite"
        self._diagnostics.report(
            "command",
            "error",
            f"heater_current on {COMMAND} is {current_a:g} {self._unit}, {why}; {applied:g} {self._unit} is applied instead",
            stamp_ns=stamp_ns,
        )
        return applied

    def take(self, stamp_ns: int, current_a: float, commander: float, present_ns: int) -> float | None:
        """Take a command; return the current to apply [A], None where the command is refused.

        Parameters
        ----------
        stamp_ns : of the sample that it answers
        current_a : commanded [A]
        commander : number of the node that commands, NaN for one that has none
        present_ns : stamp of the newest sample

        Returns
        -------
        float or None
        """
        if self._silent > HOLD_SAMPLES:
            self._commander = commander
        # two without a name are one
        elif commander != self._commander and not (math.isnan(commander) and math.isnan(self._commander)):
            self._diagnostics.count("commanders", _SOLE)
            return None
        if abs(present_ns - stamp_ns) > HOLD_SAMPLES * self._period_ns:
            self._diagnostics.count(
                "stale", f"commands answer no sample of the last {HOLD_SAMPLES} periods and were not applied"
            )
            return None
        if stamp_ns < self.answered_ns:
            self._diagnostics.count("stale", "commands came out of order and were not applied")
            return None
        self._current_a = self.borne(current_a, present_ns)
        self._silent, self.answered_ns = 0, stamp_ns
        self._age = max(0, round((present_ns - stamp_ns) / self._period_ns))
        return self._current_a

    def next_period(self) -> float:
        """Begin a sample period; return the current that flows in it [A]."""
        self._silent += 1
        self._age += 1
        if self._current_a is None:
            return self._safe_a
        if self._age > HOLD_SAMPLES + 1:
            self._diagnostics.report(
                "command",
                "error",
                f"no command for {HOLD_SAMPLES} periods: safe current {self._safe_a:g} {self._unit}",
            )
            self._current_a = None
            return self._safe_a
        if self._silent <= 1 and self._borne:
            self._diagnostics.report("command", "ok", "commands arrive")
        return self._current_a
