"""`feedforward`: set-point in, heater current out of the inverse of the model, without feedback.

It commands alone: for feedback beside it, switch it on inside the controller (its parameter `feedforward`). A sample
without usable set-point leads to what the project calls safe current: hold for three samples, then 0 A.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rclpy.node import Node
from sensor_msgs.msg import JointState
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
    LATCHED_QOS,
    MEASUREMENT,
    READ_QOS,
    REFERENCE,
    REFERENCE_CHANNELS,
    SAFE_CURRENT_A,
    SAMPLE_QOS,
)
from vo2_models.parameters import Parameter

from vo2_control.designs import LIMIT_PARAMETERS, design_feedforward, open_loop, reach
from vo2_control.safe import SafetySettings, Supervisor

if TYPE_CHECKING:
    from vo2_control.feedforward import InverseFeedforward

__all__ = ["FEEDFORWARD_PARAMETERS", "FeedforwardNode", "main"]

FEEDFORWARD_PARAMETERS = (
    Parameter(
        "preset", "integrated", "", "Device preset: range of the current, sample period.", choices=PRESETS
    ),
    Parameter("enabled", True, "", "Whether the node commands; off, it only listens."),
    Parameter("time", "lockstep", "", "Whose pace the loop keeps.", choices=("lockstep", "wall")),
    Parameter("rate_hz", 0.0, "Hz", "Sampling rate; 0 for the preset's.", 0.0, 20e3),
    Parameter(
        "reference_hold",
        False,
        "",
        "True: the last set-point holds until the next (set-points by hand). "
        "False: every measurement waits for the set-point of its own stamp.",
    ),
    *LIMIT_PARAMETERS,
)
_LATE = 1.5
"""Periods after the last input at which the next one counts as missing."""


class FeedforwardNode(Node):
    """Parameters in, measurement stamps and set-points in, one step of the inverse, currents out."""

    def __init__(self) -> None:
        super().__init__("feedforward", namespace=DEFAULT_NAMESPACE)
        self._table = ParameterTable(
            self, (*FEEDFORWARD_PARAMETERS, *model_parameters()), read_only=("preset", "time", "rate_hz")
        )
        preset = self._table.text("preset")
        self._period_s = 1.0 / (self._table.number("rate_hz") or operating_point(preset).rate_hz)
        self._wall = self._table.text("time") == "wall"
        self._diagnostics = Diagnostics(self, hardware_id=preset)
        self._ahead: InverseFeedforward | None = None
        self._supervisor: Supervisor | None = None
        self._reach = (-math.inf, math.inf)
        self._revision = self._table.revision
        self._order = StampOrder()
        self._reference: tuple[int, float] | None = None
        self._waiting_ns: int | None = None
        self._answer = b""
        self._input_s = -math.inf
        self._measurement_reader = SampleReader(())
        self._reference_reader = SampleReader(REFERENCE_CHANNELS)
        self._writer = SampleWriter(COMMAND_CHANNELS, preset)
        self._publisher = self.create_publisher(JointState, COMMAND, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher)
        self.create_subscription(JointState, REFERENCE, self._on_reference, LATCHED_QOS, raw=True)
        self.create_subscription(JointState, MEASUREMENT, self._on_measurement, READ_QOS, raw=True)
        self._rebuild()
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

    def _on_measurement(self, data: bytes) -> None:
        stamp_ns, _ = self._measurement_reader.read(data)
        if self._order.is_repeat(stamp_ns):
            if self._answer and self._table.flag("enabled"):
                self._publisher.publish(self._answer)
            return
        self._waiting_ns = stamp_ns
        self._act()

    def _act(self) -> None:
        """Answer the waiting measurement if its set-point is there."""
        stamp_ns = self._waiting_ns
        if stamp_ns is None or not self._table.flag("enabled"):
            return
        hold = self._table.flag("reference_hold")
        if not hold and (self._reference is None or self._reference[0] != stamp_ns):
            return
        self._waiting_ns = None
        self._input_s = time.monotonic()
        if self._table.revision != self._revision:
            self._rebuild()
        if self._order.jumped_back(stamp_ns):
            self._diagnostics.report(
                "stamps", "warn", "the stamp jumped back: taken as a cold device", stamp_ns=stamp_ns
            )
            self._restart()
        if self._supervisor is None or self._ahead is None:
            self._publish(stamp_ns, SAFE_CURRENT_A)
            return
        if self._reference is None:
            self._lost(stamp_ns, f"no set-point on {REFERENCE} yet; start the reference node or publish one")
            return
        reference = self._reference[1]
        if not math.isfinite(reference):
            self._lost(stamp_ns, f"tip_deflection on {REFERENCE} is {reference}: send finite set-points")
            return
        if self._supervisor.mode == "safe":
            # the device cooled meanwhile, and its hysteresis with it
            self._ahead.reset()
        current = self._ahead.update(self._supervisor.reachable(reference)).current_a
        decision = self._supervisor.sample(stamp_ns * 1e-9, reference, 0.0, feedforward_a=current)
        if decision.mode == "limited":
            self._diagnostics.report("reference", "warn", decision.reason, stamp_ns=stamp_ns)
        elif self._diagnostics.level("reference") != "ok":
            self._diagnostics.report("reference", "ok", "reference is reachable again", stamp_ns=stamp_ns)
        if self._diagnostics.level("input") != "ok":
            self._diagnostics.report("input", "ok", "input is there again", stamp_ns=stamp_ns)
        self._publish(stamp_ns, decision.current_a)

    def _lost(self, stamp_ns: int, why: str) -> None:
        if self._supervisor is None:
            self._publish(stamp_ns, SAFE_CURRENT_A)
            return
        decision = self._supervisor.lost(stamp_ns * 1e-9, why)
        level = "error" if decision.mode == "safe" else "warn"
        self._diagnostics.report("input", level, decision.reason, stamp_ns=stamp_ns)
        self._waiting_ns = None
        self._publish(stamp_ns, decision.current_a)

    def _publish(self, stamp_ns: int, current_a: float) -> None:
        self._order.accept(stamp_ns)
        self._answer = self._writer.write(stamp_ns, (current_a,))
        self._publisher.publish(self._answer)

    def _on_tick(self) -> None:
        """Wall time: a period without an answered measurement is a missed input."""
        last_ns = self._order.last_ns
        if last_ns is None or not self._table.flag("enabled"):
            return
        # the clock here and the arrival of samples drift against each other: a period without input is no gap yet
        now = time.monotonic()
        if now - self._input_s > _LATE * self._period_s:
            # so that the next tick, early or late, tells the next missing sample
            self._input_s = now - 0.75 * self._period_s
            missing = MEASUREMENT if self._waiting_ns is None else REFERENCE
            self._lost(last_ns + round(self._period_s * 1e9), f"nothing on {missing}: is its node running?")

    def _rebuild(self) -> None:
        """Invert the model that the parameters hold; one that cannot be inverted leaves the former at work."""
        self._revision = self._table.revision
        try:
            ahead = design_feedforward(
                preset=self._table.text("preset"), sample_period_s=self._period_s, values=self._table.given()
            )
        except ValueError as error:
            kept = (
                "the former inverse stays" if self._ahead else f"safe current {SAFE_CURRENT_A:g} A until then"
            )
            self._diagnostics.report("model", "error", f"{error}; {kept}")
            return
        self._ahead, self._reach = ahead, reach(ahead)
        self._restart()
        low, high = self._reach
        self._diagnostics.report(
            "model", "ok", f"inverse of the model, {1e6 * low:.2f} to {1e6 * high:.2f} um reachable"
        )

    def _restart(self) -> None:
        """Start from a long rest without current, with nothing held."""
        if self._ahead is None:
            return
        self._ahead.reset()
        settings = SafetySettings(
            self._period_s, safe_current_a=SAFE_CURRENT_A, hold_periods=HOLD_SAMPLES, reach_m=self._reach
        )
        self._supervisor = Supervisor(open_loop(self._ahead.limits, self._period_s), settings)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run_nodes(FeedforwardNode, args=args)


if __name__ == "__main__":
    sys.exit(main())
