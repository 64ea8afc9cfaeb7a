"""`controller`: set-point and estimated deflection in, heater current out.

One law per sample. A sample without usable input (a NaN, an absent channel, a reference that is missing, an
estimator that stopped) leads to what the project calls safe current: hold for three samples, then that of the device.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

from std_srvs.srv import Trigger
from vo2_interface.executable import node_main
from vo2_interface.topics import ESTIMATE, ESTIMATE_CHANNELS
from vo2_models.parameters import Parameter

from vo2_control.command_node import COMMAND_NODE_PARAMETERS, CommandNode
from vo2_control.controller import Controller
from vo2_control.designer import Design, Designer, Task, make_design
from vo2_control.designs import CONTROLLER_KINDS, CONTROLLER_PARAMETERS
from vo2_control.safe import OPEN, Decision, Supervisor

__all__ = ["CONTROLLER_NODE_PARAMETERS", "ControllerNode", "main"]

_OWN_PARAMETERS = (
    Parameter("kind", "pi", "", "Control law.", choices=CONTROLLER_KINDS),
    Parameter(
        "feedforward",
        False,
        "",
        "Add the current of the inverted model (model.*), so that the feedback corrects only what it gets wrong.",
    ),
)
CONTROLLER_NODE_PARAMETERS = (*COMMAND_NODE_PARAMETERS, *_OWN_PARAMETERS)
_SETTLE_CONSTANTS = 5.0


class ControllerNode(CommandNode):
    """Parameters in, estimates and set-points in, one call of the law, currents out."""

    def __init__(self) -> None:
        super().__init__(
            "controller", (*_OWN_PARAMETERS, *CONTROLLER_PARAMETERS), ESTIMATE, ESTIMATE_CHANNELS
        )
        self._designer: Designer | None = None
        self._pending: Controller | None = None
        self.create_service(Trigger, "~/redesign", self._on_redesign)
        self._listen()

    def _configure(self) -> None:
        """Design the law that the parameters ask for."""
        self._revision = self._table.revision
        design = make_design(self._task())
        # in wall time what changes later is designed beside the loop, in lockstep time waits for it
        self._designer = Designer() if self._wall else None
        self._law, self._ahead, self._reach = design.law, design.ahead, design.reach_m
        self._pending = None
        self._tell_feedforward(design)
        self._restart()

    def _cleanup(self) -> None:
        super()._cleanup()
        if self._designer is not None:
            self._designer.close()
            self._designer = None

    def close(self) -> None:
        """Leave the device at the safe current, and end the process that designs."""
        super().close()
        self._cleanup()

    def _restart(self) -> None:
        self._supervisor = Supervisor(self._law, self._settings(self._reach))

    def _decide(
        self, supervisor: Supervisor, stamp_ns: int, values: tuple[float, ...], reference_m: float
    ) -> Decision | str:
        deflection, surrogate, _bound = values
        if not math.isfinite(deflection):
            return f"tip_deflection on {ESTIMATE} is {deflection}: see what the estimator says"
        self._take_over_designed()
        if self._wall and self._echo.behind and supervisor.mode in ("tracking", "limited"):
            self._diagnostics.count("late commands", "the plant was behind a command: it was said again")
            return supervisor.repeat(stamp_ns * 1e-9)
        supervisor.begin_at(surrogate)
        ahead = 0.0
        if self._ahead is not None or self._pending is not None:
            reachable = supervisor.reachable(reference_m)
            ahead = self._feedforward(supervisor, reachable)
            if self._pending is not None:
                self._law, self._pending = self._pending, None
                supervisor.replace_controller(self._law, reachable, deflection, ahead)
        return supervisor.sample(stamp_ns * 1e-9, reference_m, deflection, ahead, followed=self._followed)

    def _feedforward(self, supervisor: Supervisor, reference_m: float) -> float:
        """Return the current of the inverted model for the next sample [A]; 0 A without one."""
        if self._ahead is None:
            return 0.0
        if self._pending is not None or supervisor.mode in OPEN:
            # settled first: the lead of a cold start would come back as a bump one sample after the bumpless start
            self._ahead.reset()
            samples = math.ceil(_SETTLE_CONSTANTS * self._ahead.thermal.time_constant_s / self._period_s)
            for _ in range(samples):
                self._ahead.update(reference_m)
        return self._ahead.update(reference_m).current_a

    def _on_tick(self) -> None:
        if self.active:
            self._take_over_designed()
        super()._on_tick()

    def _task(self) -> Task:
        """Return what the present parameters ask for."""
        table = self._table
        preset, ahead = table.text("preset"), table.flag("feedforward")
        return Task(table.text("kind"), preset, self._period_s, table.given(), ahead)

    def _rebuild(self) -> str:
        """Take over changed parameters; return why not, empty if nothing is against it.

        A law that cannot be designed leaves the present one at work, and so does one that is still being designed
        beside the loop.
        """
        task = self._task()
        if self._designer is not None:
            self._designer.ask(task)
            return ""
        try:
            self._take_over(make_design(task))
        except ValueError as error:
            return self._refuse(error)
        return ""

    def _take_over_designed(self) -> None:
        """Wall time: use the law that was designed beside the loop, once it is ready."""
        if self._designer is None or not self._designer.busy:
            return
        try:
            design = self._designer.answer()
        except ValueError as error:
            self._refuse(error)
            return
        if design is not None:
            self._take_over(design)

    def _take_over(self, design: Design) -> None:
        """Start with the design at the next sample, from the current that flows then."""
        self._pending, self._ahead = design.law, design.ahead
        self._reach = design.reach_m
        if self._supervisor is not None:
            self._supervisor.settings = replace(self._supervisor.settings, reach_m=self._reach)
        self._diagnostics.report("design", "ok", f"{self._table.text('kind')} designed anew")
        self._tell_feedforward(design)

    def _tell_feedforward(self, design: Design) -> None:
        if self._table.flag("feedforward") and design.ahead is None:
            self._diagnostics.report("feedforward", "error", f"{design.without}; feedback alone until then")
        elif self._diagnostics.level("feedforward") != "ok" or design.ahead is not None:
            text = "off" if design.ahead is None else "current of the inverted model is added"
            self._diagnostics.report("feedforward", "ok", text)

    def _refuse(self, error: ValueError) -> str:
        """Say why a design is refused, and return it."""
        why = f"refused: {error}; the former law stays"
        self._diagnostics.report("design", "error", why)
        return why

    def _on_redesign(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.lifecycle_state not in ("inactive", "active"):
            response.message = f"{self.lifecycle_state}: configure the node first"
            return response
        refused = self._rebuild()
        response.success = not refused
        kind = self._table.text("kind")
        beside = f"{kind} is designed beside the loop; the outcome comes on /diagnostics"
        response.message = refused or (
            beside if self._wall else f"{kind} designed from the present parameters"
        )
        return response


main = node_main(ControllerNode)

if __name__ == "__main__":
    sys.exit(main())
