"""`estimator`: film resistance in, tip deflection with its temperature surrogate and error bound out."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rclpy.node import Node
from sensor_msgs.msg import JointState
from vo2_models.parameters import Parameter
from vo2_models.recording import RESISTANCE
from vo2_plant_sim.interface.diagnostics import Diagnostics
from vo2_plant_sim.interface.executable import run_nodes
from vo2_plant_sim.interface.lockstep import StampOrder
from vo2_plant_sim.interface.model import PRESETS, model_parameters
from vo2_plant_sim.interface.parameters import ParameterTable
from vo2_plant_sim.interface.samples import SampleReader, SampleWriter
from vo2_plant_sim.interface.topics import (
    DEFAULT_NAMESPACE,
    ESTIMATE,
    ESTIMATE_CHANNELS,
    MEASUREMENT,
    READ_QOS,
    SAMPLE_QOS,
)

from vo2_estimation.schemes import SCHEMES, Scheme, make_scheme

__all__ = ["ESTIMATOR_PARAMETERS", "EstimatorNode", "main"]

ESTIMATOR_PARAMETERS = (
    Parameter("preset", "integrated", "", "Device preset.", choices=PRESETS),
    Parameter(
        "kind",
        "composite",
        "",
        "Self-sensing scheme; drive predicts deflection and resistance from the drive alone.",
        choices=SCHEMES,
    ),
    Parameter("drive_channel", "heater_voltage", "", "Channel that kind drive takes as its input."),
)
_NAN = float("nan")
_BEAT_SAMPLES = 1000
_NO_MODEL = (
    "no model yet: every estimate is NaN; run the identifier (~/start), or load a file that it or fit wrote "
    "(ros2 param load, --params-file)"
)


class EstimatorNode(Node):
    """Parameters in, measurements in, one step of the scheme, estimates out.

    Without a usable model or resistance the answer is NaN, so that a lockstep loop goes on and its
    controller takes the safe current.
    """

    def __init__(self) -> None:
        super().__init__("estimator", namespace=DEFAULT_NAMESPACE)
        self._table = ParameterTable(
            self, (*ESTIMATOR_PARAMETERS, *model_parameters()), read_only=("preset",)
        )
        preset = self._table.text("preset")
        self._diagnostics = Diagnostics(self, hardware_id=preset)
        self._scheme: Scheme | None = None
        self._revision = -1
        self._order = StampOrder()
        self._count = 0
        self._reader = SampleReader((RESISTANCE,))
        self._writer = SampleWriter(ESTIMATE_CHANNELS, preset)
        self._answer = b""
        self._publisher = self.create_publisher(JointState, ESTIMATE, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher)
        self.create_subscription(JointState, MEASUREMENT, self._on_measurement, READ_QOS, raw=True)
        self._rebuild()

    def _on_measurement(self, data: bytes) -> None:
        stamp_ns, (value,) = self._reader.read(data)
        if self._order.is_repeat(stamp_ns):
            self._publisher.publish(self._answer)
            return
        if self._table.revision != self._revision:
            self._rebuild(stamp_ns)
            # the scheme may want another channel
            stamp_ns, (value,) = self._reader.read(data)
        if self._order.jumped_back(stamp_ns):
            self._diagnostics.report(
                "stamps",
                "warn",
                f"the stamp on {MEASUREMENT} jumped back: taken as a new recording of a cold device",
                stamp_ns=stamp_ns,
            )
            if self._scheme is not None:
                self._scheme.restart()
        self._order.accept(stamp_ns)
        self._answer = self._writer.write(stamp_ns, self._estimate(stamp_ns, value))
        self._publisher.publish(self._answer)
        self._count += 1
        if self._count % _BEAT_SAMPLES == 0:
            self._diagnostics.beat(stamp_ns)

    def _estimate(self, stamp_ns: int, value: float) -> tuple[float, ...]:
        scheme = self._scheme
        if scheme is None:
            return (_NAN,) * len(self._writer.channels)
        if not scheme.usable(value):
            channel = scheme.input_channel
            if not self._reader.has(channel):
                what = f"is absent (there are {', '.join(self._reader.names) or 'no channels'})"
            else:
                what = f"is {value}"
            self._diagnostics.report(
                "input",
                "error",
                f"{channel} on {MEASUREMENT} {what}: need {scheme.need}; the estimate is NaN until then",
                stamp_ns=stamp_ns,
            )
            return (_NAN,) * len(scheme.channels)
        if self._diagnostics.level("input") != "ok":
            self._diagnostics.report("input", "ok", f"{scheme.input_channel} is back", stamp_ns=stamp_ns)
        return scheme.step(value)

    def _rebuild(self, stamp_ns: int | None = None) -> None:
        """Take over changed parameters; the memory starts at the cold device, where every recording starts."""
        self._revision = self._table.revision
        given = self._table.given("model.")
        kind = self._table.text("kind")
        self._scheme = None
        if not given:
            self._diagnostics.report("model", "warn", _NO_MODEL, stamp_ns=stamp_ns)
            return
        try:
            self._scheme = make_scheme(kind, self._table.text("drive_channel"), given)
        except ValueError as error:
            self._diagnostics.report("model", "error", f"{error}; every estimate is NaN", stamp_ns=stamp_ns)
            return
        self._reader = SampleReader((self._scheme.input_channel,))
        self._writer = SampleWriter(self._scheme.channels, self._table.text("preset"))
        self._diagnostics.report("model", "ok", f"{kind} scheme at work", stamp_ns=stamp_ns)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run_nodes(EstimatorNode, args=args)


if __name__ == "__main__":
    sys.exit(main())
