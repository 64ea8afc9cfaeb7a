"""`beam`: the tip of the cantilever as a frame, `geometry_msgs/TransformStamped` on `tip`, for 3D views.

From `vo2_base` at the clamp to `vo2_tip`: x along the beam, z the way it bends, enlarged by `scale`; the slope is that of
a beam with constant curvature. The bent beam itself comes as TF from `ros2 launch vo2_interface beam.launch.py`.
"""

from __future__ import annotations

import math
import sys

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from vo2_models.device.description import DeviceParameter, preset
from vo2_models.parameters import Parameter
from vo2_models.recording import TIP_DEFLECTION

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.executable import node_main
from vo2_interface.inputs import SampleInput
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader, stamp_message
from vo2_interface.topics import DEFAULT_NAMESPACE, MEASUREMENT, SAMPLE_QOS

__all__ = ["BEAM_PARAMETERS", "BeamNode", "main", "tip_pose"]

BEAM_PARAMETERS = (
    DeviceParameter("preset", "integrated", "", "Device: a preset, or the path of a device file."),
    Parameter("scale", 1000.0, "1", "How many times larger than it is the beam is shown.", 1.0, 1e6),
    Parameter("every_s", 0.02, "s", "Time on the samples' clock between two messages.", 0.0, 10.0),
)


def tip_pose(deflection_m: float, length_m: float) -> tuple[float, float]:
    """Return the height of the tip over its length, and its slope, of a beam with constant curvature.

    Parameters
    ----------
    deflection_m : of the tip [m]
    length_m : of the beam [m]

    Returns
    -------
    tuple : height over length [1], slope [rad]
    """
    return deflection_m / length_m, 2.0 * deflection_m / length_m


class BeamNode(Node):
    """Measurements in, the pose of the tip out."""

    def __init__(self) -> None:
        super().__init__("beam", namespace=DEFAULT_NAMESPACE)
        table = ParameterTable(self, BEAM_PARAMETERS, read_only=[each.name for each in BEAM_PARAMETERS])
        device = preset(table.text("preset"))
        if not math.isfinite(device.length):
            raise ValueError(f"preset: {device.id} has no structure.length, need that of the cantilever [m]")
        self._length_m, self._scale = device.length, table.number("scale")
        self._every_ns = round(1e9 * table.number("every_s"))
        self._due_ns = 0
        self._reader = SampleReader([device.names.get(TIP_DEFLECTION, TIP_DEFLECTION)])
        self._publisher = self.create_publisher(TransformStamped, "tip", SAMPLE_QOS)
        SampleInput(self, MEASUREMENT, self._on_measurement, Diagnostics(self, hardware_id=device.id))

    def _on_measurement(self, data: bytes) -> None:
        stamp_ns, (deflection,) = self._reader.read(data)
        # a stamp far behind is that of a source that has started anew
        if not math.isfinite(deflection) or -1_000_000_000 < stamp_ns - self._due_ns < 0:
            return
        self._due_ns = stamp_ns + self._every_ns
        height, slope = tip_pose(deflection, self._length_m)
        message = TransformStamped(child_frame_id="vo2_tip")
        message.header.frame_id, message.header.stamp = "vo2_base", stamp_message(stamp_ns)
        size = self._length_m * self._scale
        message.transform.translation.x, message.transform.translation.z = size, size * height
        message.transform.rotation.y = -math.sin(slope / 2.0)
        message.transform.rotation.w = math.cos(slope / 2.0)
        self._publisher.publish(message)


main = node_main(BeamNode)

if __name__ == "__main__":
    sys.exit(main())
