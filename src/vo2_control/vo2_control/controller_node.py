"""`controller`: set-point and estimated deflection in, heater current out.

One law per sample. A sample without usable input (a NaN, an absent channel, a reference that is missing, an
estimator that stopped) leads to what the project calls safe current: hold for three samples, then 0 A.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.executable import run_nodes
from vo2_interface.lockstep import HOLD_SAMPLES, StampOrder
from vo2_interface.model import PRESETS, model_parameters, operating_point
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.topics import (
    COMMAND,
    COMMAND_CHANNELS,
    DEFAULT_NAMESPACE,
    ESTIMATE,
    ESTIMATE_CHANNELS,
    LATCHED_QOS,
    READ_QOS,
    REFERENCE,
    REFERENCE_CHANNELS,
    SAFE_CURRENT_A,
    SAMPLE_QOS,
)
from vo2_models.parameters import Parameter

from vo2_control.controller import Controller
from vo2_control.designer import Design, Designer, Task, make_design
from vo2_control.designs import CONTROLLER_KINDS, CONTROLLER_PARAMETERS
from vo2_control.safe import SafetySettings, Supervisor

__all__ = ["CONTROLLER_NODE_PARAMETERS", "ControllerNode", "main"]

CONTROLLER_NODE_PARAMETERS = (
    Parameter(
        "preset", "integrated", "", "Device preset: range of the current, sample period.", choices=PRESETS
    ),
    Parameter("kind", "pi", "", "Control law.", choices=CONTROLLER_KINDS),
    Parameter("enabled", True, "", "Whether the node commands; off, it only listens."),
    Parameter("time", "lockstep", "", "Whose pace the loop keeps.", choices=("lockstep", "wall")),
    Parameter("rate_hz", 0.0, "Hz", "Sampling rate; 0 for the preset's.", 0.0, 20e3),
    Parameter(
        "reference_hold",
        False,
        "",
        "True: the last set-point holds until the next (set-points by hand). "
        "False: every estimate waits for the set-point of its own stamp.",
    ),
    Parameter(
        "feedforward",
        False,
        "",
        "Add the current of the inverted model (model.*), so that the feedback corrects only what it gets wrong.",
    ),
)
_NAN = float("nan")
_SETTLE_CONSTANTS = 5.0
_LATE = 1.5
"""Periods after the last input at which the next one counts as missing."""


class ControllerNode(Node):
    """Parameters in, estimates and set-points in, one call of the law, currents out."""

    def __init__(self) -> None:
        super().__init__("controller", namespace=DEFAULT_NAMESPACE)
        records = (*CONTROLLER_NODE_PARAMETERS, *CONTROLLER_PARAMETERS, *model_parameters())
        self._table = ParameterTable(self, records, read_only=("preset", "time", "rate_hz"))
        self._point = operating_point(self._table.text("preset"))
        self._period_s = 1.0 / (self._table.number("rate_hz") or self._point.rate_hz)
        self._wall = self._table.text("time") == "wall"
        self._diagnostics = Diagnostics(self, hardware_id=self._table.text("preset"))
        design = make_design(self._task())
        # in wall time what changes later is designed beside the loop, in lockstep time waits for it
        self._designer = Designer() if self._wall else None
        self._law, self._ahead = design.law, design.ahead
        self._pending: Controller | None = None
        self._tell_feedforward(design)
        self._settings = SafetySettings(
            self._period_s, safe_current_a=SAFE_CURRENT_A, hold_periods=HOLD_SAMPLES, reach_m=design.reach_m
        )
        self._supervisor = Supervisor(self._law, self._settings)
        self._order = StampOrder()
        self._reference: tuple[int, float] | None = None
        self._estimate: tuple[int, tuple[float, ...]] | None = None
        self._answer = b""
        self._input_s = -math.inf
        self._estimate_reader = SampleReader(ESTIMATE_CHANNELS)
        self._reference_reader = SampleReader(REFERENCE_CHANNELS)
        self._writer = SampleWriter(COMMAND_CHANNELS, self._table.text("preset"))
        self._publisher = self.create_publisher(JointState, COMMAND, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher)
        self.create_subscription(JointState, REFERENCE, self._on_reference, LATCHED_QOS, raw=True)
        self.create_subscription(JointState, ESTIMATE, self._on_estimate, READ_QOS, raw=True)
        self.create_service(Trigger, "~/redesign", self._on_redesign)
        if self._wall:
            self.create_timer(self._period_s, self._on_tick)

    def close(self) -> None:
        """Leave the device at the safe current (wall time; in lockstep no time passes without us)."""
        if self._wall and self._table.flag("enabled") and self._order.last_ns is not None:
            self._publish(self._order.last_ns, SAFE_CURRENT_A)
        if self._designer is not None:
            self._designer.close()

    def _on_reference(self, data: bytes) -> None:
        stamp_ns, (value,) = self._reference_reader.read(data)
        self._reference = (stamp_ns, value)
        self._act()

    def _on_estimate(self, data: bytes) -> None:
        stamp_ns, values = self._estimate_reader.read(data)
        if self._order.is_repeat(stamp_ns):
            if self._answer and self._table.flag("enabled"):
                self._publisher.publish(self._answer)
            return
        self._estimate = (stamp_ns, values)
        self._act()

    def _act(self) -> None:
        """Answer the waiting estimate if its set-point is there."""
        table = self._table
        if self._estimate is None or not table["enabled"]:
            return
        stamp_ns, (deflection, surrogate, _bound) = self._estimate
        if self._reference is None:
            if table["reference_hold"]:
                self._miss(
                    stamp_ns, f"no set-point on {REFERENCE} yet; start the reference node or publish one"
                )
            return
        reference_ns, reference = self._reference
        if reference_ns != stamp_ns and not table["reference_hold"]:
            return
        self._estimate = None
        self._input_s = time.monotonic()
        if table.revision != self._revision:
            self._rebuild()
        if self._designer is not None:
            self._take_over_designed()
        if self._order.jumped_back(stamp_ns):
            self._diagnostics.report(
                "stamps", "warn", "the stamp jumped back: the loop starts anew", stamp_ns=stamp_ns
            )
            self._supervisor = Supervisor(self._law, self._settings)
        if not math.isfinite(deflection):
            self._miss(stamp_ns, f"tip_deflection on {ESTIMATE} is {deflection}: see what the estimator says")
            return
        if not math.isfinite(reference):
            self._miss(stamp_ns, f"tip_deflection on {REFERENCE} is {reference}: send finite set-points")
            return
        supervisor = self._supervisor
        was_closed = supervisor.mode in ("tracking", "limited")
        if not was_closed:
            supervisor.begin_at(surrogate)
        ahead = 0.0
        if self._ahead is not None or self._pending is not None:
            reachable = supervisor.reachable(reference)
            ahead = self._feedforward(reachable)
            if self._pending is not None:
                self._law, self._pending = self._pending, None
                supervisor.replace_controller(self._law, reachable, deflection, ahead)
        decision = supervisor.sample(stamp_ns * 1e-9, reference, deflection, ahead)
        if not was_closed:
            self._diagnostics.report("input", "ok", "input is there, the loop is closed", stamp_ns=stamp_ns)
        if decision.mode == "limited":
            self._diagnostics.report("reference", "warn", decision.reason, stamp_ns=stamp_ns)
        elif self._diagnostics.level("reference") != "ok":
            self._diagnostics.report("reference", "ok", "reference is reachable again", stamp_ns=stamp_ns)
        self._publish(stamp_ns, decision.current_a)

    def _feedforward(self, reference_m: float) -> float:
        """Return the current of the inverted model for the next sample [A]; 0 A without one."""
        if self._ahead is None:
            return 0.0
        if self._pending is not None or self._supervisor.mode in ("idle", "safe"):
            # settled first: the lead of a cold start would come back as a bump one sample after the bumpless start
            self._ahead.reset()
            samples = math.ceil(_SETTLE_CONSTANTS * self._ahead.thermal.time_constant_s / self._period_s)
            for _ in range(samples):
                self._ahead.update(reference_m)
        return self._ahead.update(reference_m).current_a

    def _miss(self, stamp_ns: int, why: str) -> None:
        decision = self._supervisor.lost(stamp_ns * 1e-9, why)
        level = "error" if decision.mode == "safe" else "warn"
        self._diagnostics.report("input", level, decision.reason, stamp_ns=stamp_ns)
        self._estimate = None
        self._publish(stamp_ns, decision.current_a)

    def _publish(self, stamp_ns: int, current_a: float) -> None:
        self._order.accept(stamp_ns)
        self._answer = self._writer.write(stamp_ns, (current_a,))
        self._publisher.publish(self._answer)

    def _on_tick(self) -> None:
        """Wall time: a period without an answered estimate is a missed input."""
        self._take_over_designed()
        last_ns = self._order.last_ns
        if last_ns is None or not self._table.flag("enabled"):
            return
        # the clock here and the arrival of samples drift against each other: a period without input is no gap yet
        now = time.monotonic()
        if now - self._input_s > _LATE * self._period_s:
            # so that the next tick, early or late, tells the next missing sample
            self._input_s = now - 0.75 * self._period_s
            waiting = REFERENCE if self._estimate is not None else ESTIMATE
            self._miss(last_ns + round(self._period_s * 1e9), f"nothing on {waiting}: is its node running?")

    def _task(self) -> Task:
        """Return what the present parameters ask for."""
        table = self._table
        self._revision = table.revision
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
        self._settings = replace(self._settings, reach_m=design.reach_m)
        self._supervisor.settings = self._settings
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
        refused = self._rebuild()
        response.success = not refused
        kind = self._table.text("kind")
        beside = f"{kind} is designed beside the loop; the outcome comes on /diagnostics"
        response.message = refused or (
            beside if self._wall else f"{kind} designed from the present parameters"
        )
        return response


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run_nodes(ControllerNode, args=args)


if __name__ == "__main__":
    sys.exit(main())
