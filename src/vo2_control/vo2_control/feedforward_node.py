"""`feedforward`: set-point in, heater current out of the inverse of the model, without feedback.

It commands alone: for feedback beside it, switch it on inside the controller (its parameter `feedforward`). A sample
without usable set-point leads to what the project calls safe current: hold for three samples, then that of the device.
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

from vo2_interface.executable import node_main
from vo2_interface.topics import MEASUREMENT

from vo2_control.command_node import COMMAND_NODE_PARAMETERS, CommandNode
from vo2_control.designs import LIMIT_PARAMETERS, design_feedforward, open_loop, reach
from vo2_control.safe import OPEN, Decision, Supervisor

if TYPE_CHECKING:
    from vo2_control.feedforward import InverseFeedforward

__all__ = ["FEEDFORWARD_PARAMETERS", "FeedforwardNode", "main"]

FEEDFORWARD_PARAMETERS = (*COMMAND_NODE_PARAMETERS, *LIMIT_PARAMETERS)


class FeedforwardNode(CommandNode):
    """Parameters in, measurement stamps and set-points in, one step of the inverse, currents out."""

    def __init__(self) -> None:
        super().__init__("feedforward", LIMIT_PARAMETERS, MEASUREMENT, ())
        self._ahead: InverseFeedforward | None = None
        self._reach = (-math.inf, math.inf)
        self._listen()

    def _configure(self) -> None:
        """Invert the model that the parameters hold, if they hold one."""
        self._revision = self._table.revision
        self._rebuild()

    def _cleanup(self) -> None:
        super()._cleanup()
        self._ahead = None

    def _decide(
        self, supervisor: Supervisor, stamp_ns: int, values: tuple[float, ...], reference_m: float
    ) -> Decision | str:
        ahead = self._ahead
        if ahead is None:
            return "no model to invert"
        if supervisor.mode in OPEN:
            # the device cooled meanwhile, and its hysteresis with it
            ahead.reset()
        current = ahead.update(supervisor.reachable(reference_m)).current_a
        return supervisor.sample(stamp_ns * 1e-9, reference_m, 0.0, current, followed=self._followed)

    def _rebuild(self) -> None:
        """Invert the model that the parameters hold; one that cannot be inverted leaves the former at work."""
        try:
            ahead = design_feedforward(
                preset=self._table.text("preset"), sample_period_s=self._period_s, values=self._table.given()
            )
        except ValueError as error:
            kept = (
                "the former inverse stays"
                if self._ahead
                else f"safe current {self._point.safe_a:g} {self._point.unit} until then"
            )
            self._diagnostics.report("model", "error", f"{error}; {kept}")
            return
        self._ahead, self._reach = ahead, reach(ahead)
        self._restart()
        shown = self._settings(self._reach).shown(*self._reach)
        self._diagnostics.report("model", "ok", f"inverse of the model, {shown} reachable")

    def _restart(self) -> None:
        """Start from a long rest without current, with nothing held."""
        if self._ahead is None:
            return
        self._ahead.reset()
        self._supervisor = Supervisor(
            open_loop(self._ahead.limits, self._period_s), self._settings(self._reach)
        )


main = node_main(FeedforwardNode)

if __name__ == "__main__":
    sys.exit(main())
