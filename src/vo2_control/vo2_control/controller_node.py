"""`controller`: set-point and estimated deflection in, heater current out.

One law per sample. A sample without usable input (a NaN, an absent channel, a reference that is missing, an
estimator that stopped) leads to what the project calls safe current: hold for three samples, then 0 A.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from vo2_models.parameters import Parameter
from vo2_plant_sim.interface.diagnostics import Diagnostics
from vo2_plant_sim.interface.executable import run_nodes
from vo2_plant_sim.interface.lockstep import StampOrder
from vo2_plant_sim.interface.model import PRESETS, model_parameters, operating_point
from vo2_plant_sim.interface.parameters import ParameterTable
from vo2_plant_sim.interface.samples import SampleReader, SampleWriter
from vo2_plant_sim.interface.topics import (
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

from vo2_control.controller import Controller
from vo2_control.designs import CONTROLLER_KINDS, CONTROLLER_PARAMETERS, design_controller
from vo2_control.input_guard import InputGuard

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
)
_NAN = float("nan")


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
        self._law: Controller = self._design()
        self._revision = self._table.revision
        self._guard = InputGuard(SAFE_CURRENT_A)
        self._order = StampOrder()
        self._reference: tuple[int, float] | None = None
        self._estimate: tuple[int, tuple[float, ...]] | None = None
        self._answer = b""
        self._inputs_since_tick = 0
        self._designer: ThreadPoolExecutor | None = None
        self._designing: Future[Controller] | None = None
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
        if self._estimate is None or not self._table.flag("enabled"):
            return
        stamp_ns, (deflection, surrogate, _bound) = self._estimate
        reference = _NAN if self._reference is None else self._reference[1]
        if self._table.flag("reference_hold"):
            if self._reference is None:
                self._miss(
                    stamp_ns, f"no set-point on {REFERENCE} yet; start the reference node or publish one"
                )
                return
        elif self._reference is None or self._reference[0] != stamp_ns:
            return
        self._estimate = None
        self._inputs_since_tick += 1
        if self._table.revision != self._revision:
            self._rebuild()
        self._take_over_designed()
        if self._order.jumped_back(stamp_ns):
            self._diagnostics.report(
                "stamps", "warn", "the stamp jumped back: the loop starts anew", stamp_ns=stamp_ns
            )
            self._guard = InputGuard(SAFE_CURRENT_A)
        if not math.isfinite(deflection):
            self._miss(stamp_ns, f"tip_deflection on {ESTIMATE} is {deflection}: see what the estimator says")
            return
        if not math.isfinite(reference):
            self._miss(stamp_ns, f"tip_deflection on {REFERENCE} is {reference}: send finite set-points")
            return
        if self._guard.needs_restart:
            self._law.reset(self._guard.start_from(surrogate), reference, deflection)
        current = self._law.update(reference, deflection)
        if self._guard.missed or self._guard.needs_restart:
            self._diagnostics.report("input", "ok", "input is there, the loop is closed", stamp_ns=stamp_ns)
        self._guard.used(current)
        self._publish(stamp_ns, current)

    def _miss(self, stamp_ns: int, why: str) -> None:
        current = self._guard.miss()
        if self._guard.is_safe:
            self._diagnostics.report(
                "input", "error", f"safe current {current:g} A: {why}", stamp_ns=stamp_ns
            )
        else:
            self._diagnostics.report("input", "warn", f"holding the last command: {why}", stamp_ns=stamp_ns)
        self._estimate = None
        self._publish(stamp_ns, current)

    def _publish(self, stamp_ns: int, current_a: float) -> None:
        self._order.accept(stamp_ns)
        self._answer = self._writer.write(stamp_ns, (current_a,))
        self._publisher.publish(self._answer)

    def _on_tick(self) -> None:
        """Wall time: a period without an answered estimate is a missed input."""
        last_ns = self._order.last_ns
        if last_ns is None or not self._table.flag("enabled"):
            return
        if self._inputs_since_tick == 0:
            waiting = REFERENCE if self._estimate is not None else ESTIMATE
            self._miss(last_ns + round(self._period_s * 1e9), f"nothing on {waiting}: is its node running?")
        self._inputs_since_tick = 0

    def _design(self) -> Controller:
        table = self._table
        return design_controller(
            table.text("kind"),
            preset=table.text("preset"),
            sample_period_s=self._period_s,
            values=table.given(),
        )

    def _rebuild(self) -> None:
        """Take over changed parameters; a law that cannot be designed leaves the present one at work.

        Tuning for a model takes seconds. In lockstep time waits for it; in wall time it is done beside the
        loop, which goes on with the former law.
        """
        self._revision = self._table.revision
        if self._wall:
            if self._designer is None:
                self._designer = ThreadPoolExecutor(1)
            self._designing = self._designer.submit(self._design)
            return
        try:
            self._take_over(self._design())
        except ValueError as error:
            self._refuse(error)

    def _take_over_designed(self) -> None:
        """Wall time: use the law that was designed beside the loop, once it is ready."""
        if self._designing is None or not self._designing.done():
            return
        designing, self._designing = self._designing, None
        try:
            self._take_over(designing.result())
        except ValueError as error:
            self._refuse(error)

    def _take_over(self, law: Controller) -> None:
        self._law = law
        self._guard.needs_restart = True
        self._diagnostics.report("design", "ok", f"{self._table.text('kind')} designed anew")

    def _refuse(self, error: ValueError) -> None:
        self._diagnostics.report("design", "error", f"{error}; the former law stays")

    def _on_redesign(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._revision = self._table.revision
        try:
            self._take_over(self._design())
        except ValueError as error:
            response.message = f"refused: {error}; the former law stays"
            return response
        response.success = True
        response.message = f"{self._table.text('kind')} designed from the present parameters"
        return response


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run_nodes(ControllerNode, args=args)


if __name__ == "__main__":
    sys.exit(main())
