"""Serve a page of the running loop on this host: the cantilever to scale, the loop, traces, stop and release.

With `model`, a file that `fit` wrote, the simulation runs beside the device, and the page marks where they differ.
Open the printed address in a browser. The page shows what the topics carry; its buttons are the emergency
stop and the transitions `activate` and `deactivate` of the node that commands.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from copy import copy

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from std_msgs.msg import Bool
from vo2_models.device.description import DeviceParameter, preset
from vo2_models.parameters import Parameter
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.executable import node_main
from vo2_interface.inputs import SampleInput
from vo2_interface.live.frames import Frames
from vo2_interface.live.server import LiveServer
from vo2_interface.live.simulated import Expected, SimulatedBeside
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader
from vo2_interface.topics import (
    DEFAULT_NAMESPACE,
    EMERGENCY_STOP,
    EMERGENCY_STOP_QOS,
    ESTIMATE,
    MEASUREMENT,
    OVERRIDABLE_INPUT,
    REFERENCE,
)

__all__ = ["LIVE_PARAMETERS", "LiveNode", "main"]

LIVE_PARAMETERS = (
    DeviceParameter("preset", "integrated", "", "Device: a preset, or the path of a device file."),
    Parameter(
        "model", "", "", "Model file that `fit` wrote, of the simulation to compare with; empty for none."
    ),
    Parameter(
        "port", 8765, "", "Port of the page on 127.0.0.1; 0 for any that is free.", 0, 65535, kind="int"
    ),
    Parameter("commander", "controller", "", "Managed node that the page activates and deactivates."),
)


_LEAST_TURN = 0.05
"""Turn that is marked in the loop, as a share of the range."""
_MEASURED = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)


class _Either:
    """Reads channels that have one of two names.

    Parameters
    ----------
    names : of each channel its name in the contract and in the device file
    """

    def __init__(self, names: Sequence[tuple[str, str]]) -> None:
        self._names = names
        self._reader = SampleReader([name for pair in names for name in pair])

    def read(self, data: bytes) -> tuple[int, list[float]]:
        """Return stamp [ns] and values, NaN where neither name is there."""
        stamp_ns, values = self._reader.read(data)
        first, second = values[::2], values[1::2]
        return stamp_ns, [
            a if self._reader.has(n[0]) else b for n, a, b in zip(self._names, first, second, strict=True)
        ]


class LiveNode(Node):
    """Samples in, a page out."""

    def __init__(self) -> None:
        super().__init__("live", namespace=DEFAULT_NAMESPACE)
        table = ParameterTable(self, LIVE_PARAMETERS, read_only=("preset", "model", "port", "commander"))
        device = preset(table.text("preset"))
        self._beside = _simulated(table.text("model"), device.id)
        self._diagnostics = Diagnostics(self)
        self._frames = Frames(_LEAST_TURN * device.deflection_range)
        self._last_ns = -1
        names, units = device.names, device.units
        tip = names.get(TIP_DEFLECTION, TIP_DEFLECTION)
        # the graph has the contract's names; a node of somebody else may call them as the device file does
        self._measurement = _Either([(role, names.get(role, role)) for role in _MEASURED])
        self._estimate = _Either([(f"{TIP_DEFLECTION}{end}", f"{tip}{end}") for end in ("", "_bound")])
        self._reference = _Either([(TIP_DEFLECTION, tip)])
        SampleInput(self, MEASUREMENT, self._on_measurement, self._diagnostics)
        SampleInput(self, ESTIMATE, self._on_estimate, self._diagnostics)
        SampleInput(self, REFERENCE, self._on_reference, self._diagnostics, latched=True, steady=False)
        self._stop = self.create_publisher(Bool, EMERGENCY_STOP, EMERGENCY_STOP_QOS)
        self.create_subscription(
            Bool,
            EMERGENCY_STOP,
            self._on_stop,
            copy(EMERGENCY_STOP_QOS),  # an override is written into it
            qos_overriding_options=OVERRIDABLE_INPUT,
        )
        self._commander = self.create_client(ChangeState, f"{table.text('commander')}/change_state")
        port = int(table.number("port"))
        told = {
            "id": device.id,
            "length_m": device.length if math.isfinite(device.length) else None,
            "deflection_m": (0.0, device.deflection_range),
            "resistance_ohm": device.resistance_range if RESISTANCE in device.channels else None,
            "drive_range": sorted(device.current_range),
            "drive": (device.drive_channel, device.drive_unit),
            "response": (tip, units.get(TIP_DEFLECTION, "m")),
            "model": self._beside is not None,
        }
        try:
            self._server = LiveServer(self._frames, told, self._on_button, port)
        except OSError as error:
            raise ValueError(
                f"port: found {port}, which is not free ({error.strerror}); need another, or 0"
            ) from error
        self.port = self._server.port
        self.get_logger().info(f"open http://127.0.0.1:{self.port}/ in a browser on this host")

    def _on_measurement(self, data: bytes) -> None:
        stamp_ns, (current, resistance, deflection) = self._measurement.read(data)
        # the plant repeats a sample until it is answered
        if stamp_ns == self._last_ns:
            return
        expected = Expected()
        if self._beside is not None:
            expected = self._beside.step(stamp_ns, current, resistance, deflection)
        self._frames.measured(stamp_ns, current, resistance, deflection, expected)
        self._last_ns = stamp_ns

    def _on_estimate(self, data: bytes) -> None:
        stamp_ns, values = self._estimate.read(data)
        self._frames.estimated(stamp_ns, *values)

    def _on_reference(self, data: bytes) -> None:
        stamp_ns, values = self._reference.read(data)
        self._frames.referred(stamp_ns, *values)

    def _on_stop(self, message: Bool) -> None:
        self._frames.stopped = message.data

    def _on_button(self, name: str) -> bool:
        """Do what a button says; return whether there is somebody to do it. What a transition leads to its node tells."""
        if name in ("stop", "release"):
            self._stop.publish(Bool(data=name == "stop"))
            return True
        if there := self._commander.service_is_ready():
            self._commander.call_async(ChangeState.Request(transition=Transition(label=name)))
        return there

    def close(self) -> None:
        """End the page."""
        self._server.close()


def _simulated(path: str, device: str) -> SimulatedBeside | None:
    """Return the simulation of a model file, None for an empty path."""
    if not path:
        return None
    # loads the compiler
    from vo2_models.device.model import DeviceModel

    model = DeviceModel.load(path)
    if model.description.id != device:
        raise ValueError(f"model: {path} is of {model.description.id}, need one of the preset {device}")
    return SimulatedBeside(model)


main = node_main(LiveNode)

if __name__ == "__main__":
    sys.exit(main())
