"""`disturbance`: the current noise of section 8.4.3 between a controller and the device, on the graph.

It hears what the controller commands on `undisturbed`, adds the noise of the command's stamp and sends it on as
`command`. The noise follows from seed and stamp alone, so that an answer that is repeated is the same again.
"""

from __future__ import annotations

import sys

from rclpy.node import Node
from sensor_msgs.msg import JointState
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.executable import node_main
from vo2_interface.model import operating_point
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.topics import COMMAND, COMMAND_CHANNELS, DEFAULT_NAMESPACE, READ_QOS, SAMPLE_QOS
from vo2_models.parameters import Parameter

from vo2_studies.reproduce.peltier import current_noise

__all__ = ["DisturbanceNode", "main"]

UNDISTURBED = "undisturbed"
_RECORDS = (
    Parameter(
        "preset",
        "peltier",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file.",
    ),
    Parameter("seed", 1, "1", "Seed of the noise.", 0, 2**31 - 1),
    Parameter("count", 8800, "1", "Samples of noise; none after them.", 100, 10_000_000),
)


class DisturbanceNode(Node):
    """Commands in, commands with noise out."""

    def __init__(self) -> None:
        super().__init__("disturbance", namespace=DEFAULT_NAMESPACE)
        table = ParameterTable(self, _RECORDS, read_only=tuple(record.name for record in _RECORDS))
        preset = table.text("preset")
        self._period_ns = round(1e9 / operating_point(preset).rate_hz)
        self._noise = current_noise(int(table.number("count")), int(table.number("seed"))).tolist()
        self._first_ns: int | None = None
        self._reader = SampleReader(COMMAND_CHANNELS)
        self._writer = SampleWriter(COMMAND_CHANNELS, preset)
        self._publisher = self.create_publisher(JointState, COMMAND, SAMPLE_QOS)
        Diagnostics(self, hardware_id=preset).watch_listeners(self._publisher)
        self.create_subscription(JointState, UNDISTURBED, self._on_command, READ_QOS, raw=True)

    def _on_command(self, data: bytes) -> None:
        stamp_ns, (current,) = self._reader.read(data)
        if self._first_ns is None:
            self._first_ns = stamp_ns
        at = round((stamp_ns - self._first_ns) / self._period_ns)
        noise = self._noise[at] if 0 <= at < len(self._noise) else 0.0
        self._publisher.publish(self._writer.write(stamp_ns, (current + noise,)))


main = node_main(DisturbanceNode)

if __name__ == "__main__":
    sys.exit(main())
