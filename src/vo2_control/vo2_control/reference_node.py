"""`reference`: the set-point on `/vo2/reference`, evaluated at the stamp of each measurement."""

from __future__ import annotations

import sys

from rclpy.node import Node
from sensor_msgs.msg import JointState
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.executable import node_main
from vo2_interface.inputs import SampleInput
from vo2_interface.lockstep import StampOrder
from vo2_interface.model import model_parameters
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.topics import (
    DEFAULT_NAMESPACE,
    LATCHED_QOS,
    MEASUREMENT,
    REFERENCE,
    REFERENCE_CHANNELS,
)
from vo2_models.device.description import preset as description
from vo2_models.parameters import Parameter
from vo2_models.recording import TIP_DEFLECTION

from vo2_control.references import REFERENCES, Multisine, ReferenceSignal, Steps, read_table, reference_signal

__all__ = ["REFERENCE_PARAMETERS", "ReferenceNode", "main"]

LEVEL = 1e6
"""Most that a set-point may be, in the unit of the device's response: metres, or what a device file has."""
_FAR = 10.0
"""Set-point over the range of the device's response from which it is a mistake in the unit."""
REFERENCE_PARAMETERS = (
    Parameter(
        "preset",
        "integrated",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file, whose signals are given below.",
    ),
    Parameter(
        "signal",
        "steps",
        "",
        "What to follow; set anew, even to the same text, it starts again at the next measurement; none is silence.",
        choices=("steps", "sine", "multisine", "csv", "none"),
    ),
    Parameter(
        "steps.levels_m",
        [],
        "m",
        "Levels in turn; empty for the preset's.",
        -LEVEL,
        LEVEL,
        kind="float_array",
    ),
    Parameter("steps.hold_s", 1.0, "s", "How long each level of steps.levels_m lasts.", 1e-6, 1e6),
    Parameter("multisine.offset_m", 30e-6, "m", "Mean of the sum of sines.", -LEVEL, LEVEL),
    Parameter(
        "multisine.amplitudes_m",
        [],
        "m",
        "Amplitudes of the sines; empty for the preset's signal.",
        -LEVEL,
        LEVEL,
        kind="float_array",
    ),
    Parameter(
        "multisine.frequencies_hz", [], "Hz", "Frequencies of the sines.", 0.0, 1e5, kind="float_array"
    ),
    Parameter("multisine.duration_s", 20.0, "s", "How long the sum of sines is meant to last.", 1e-6, 1e9),
    Parameter("csv.file", "", "", "CSV with the columns time_s and tip_deflection (m), for signal csv."),
)


class ReferenceNode(Node):
    """Parameters in, measurement stamps in, set-points out."""

    def __init__(self) -> None:
        super().__init__("reference", namespace=DEFAULT_NAMESPACE)
        self._table = ParameterTable(
            self, (*REFERENCE_PARAMETERS, *model_parameters()), read_only=("preset",)
        )
        self._device = description(self._table.text("preset"))
        self._diagnostics = Diagnostics(self)
        self._signal: ReferenceSignal | None = self._build()
        self._revision = self._table.revision
        self._start_ns: int | None = None
        self._order = StampOrder()
        self._reader = SampleReader(())
        self._writer = SampleWriter(REFERENCE_CHANNELS, self._table.text("preset"))
        self._answer = b""
        self._publisher = self.create_publisher(JointState, REFERENCE, LATCHED_QOS)
        self._diagnostics.watch_listeners(self._publisher)
        SampleInput(self, MEASUREMENT, self._on_measurement, self._diagnostics)

    def _on_measurement(self, data: bytes) -> None:
        stamp_ns, _ = self._reader.read(data)
        order = self._order.judge(stamp_ns)
        if order == "repeat" and self._answer:
            self._publisher.publish(self._answer)
            return
        if order == "late":
            self._diagnostics.count("late", f"samples on {MEASUREMENT} came late and were dropped")
            return
        if order == "restart":
            self._start_ns = None
        if self._table.revision != self._revision:
            self._revision = self._table.revision
            self._rebuild()
        if self._start_ns is None:
            self._start_ns = stamp_ns
        self._order.accept(stamp_ns)
        if self._signal is None:
            self._answer = b""
            return
        value = self._signal.at((stamp_ns - self._start_ns) * 1e-9)
        self._answer = self._writer.write(stamp_ns, (value,))
        self._publisher.publish(self._answer)

    def _rebuild(self) -> None:
        try:
            self._signal = self._build()
        except ValueError as error:
            self._diagnostics.report("signal", "error", f"{error}; the former signal goes on")
            return
        self._start_ns = None
        self._diagnostics.report("signal", "ok", f"follows {self._table.text('signal')}")

    def _build(self) -> ReferenceSignal | None:
        table = self._table
        known = self._device.id in REFERENCES  # of another device the range may not be told
        span, unit = (
            self._device.deflection_range if known else LEVEL,
            self._device.units.get(TIP_DEFLECTION, "m"),
        )
        signal = table.text("signal")
        if signal == "none":
            return None
        sines = () if signal == "csv" else ("multisine.offset_m", "multisine.amplitudes_m")
        for name in ("steps.levels_m",) if signal == "steps" else sines:
            levels = table.numbers(name) if isinstance(table[name], list) else [table.number(name)]
            if name in table.given() and max(map(abs, levels), default=0.0) > _FAR * span:
                raise ValueError(
                    f"{name}: found {max(levels, key=abs):g} {unit}, need at most {_FAR * span:g}: device {self._device.id} "
                    f"moves over {span:g} {unit}"
                )
        if signal == "csv":
            if not table.text("csv.file"):
                raise ValueError("csv.file: found no name, need a CSV file for signal csv")
            return read_table(table.text("csv.file"))
        if signal == "steps" and table.numbers("steps.levels_m"):
            return Steps(tuple(table.numbers("steps.levels_m")), table.number("steps.hold_s"))
        if signal != "steps" and table.numbers("multisine.amplitudes_m"):
            return Multisine(
                table.number("multisine.offset_m"),
                tuple(table.numbers("multisine.amplitudes_m")),
                tuple(table.numbers("multisine.frequencies_hz")),
                table.number("multisine.duration_s"),
            )
        return reference_signal(table.text("preset"), signal)


main = node_main(ReferenceNode)

if __name__ == "__main__":
    sys.exit(main())
