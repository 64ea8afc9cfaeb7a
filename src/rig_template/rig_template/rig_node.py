"""`rig`: a DAQ behind a text protocol as the device of the graph, in wall time.

It samples at a set rate, publishes `measurement`, and drives the current that `command` asks for: of one commander,
young, in order, within the limits of the device file, the safe current after three periods without. It is managed:
only an active node switches the output on. An instrument that fails, and every fault of the node itself, ends in the
safe current, output off, and `unconfigured`. Change the words of the protocol by parameters; for a device that speaks
otherwise, copy the package and replace `_sample` and `_drive`.
"""

from __future__ import annotations

import math
import sys
import time

from sensor_msgs.msg import JointState
from vo2_interface.command_gate import CommandGate
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.emergency_stop import EmergencyStop
from vo2_interface.executable import node_main
from vo2_interface.inputs import SampleInput
from vo2_interface.managed import AUTOSTART, ManagedNode
from vo2_interface.model import operating_point
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.timers import create_steady_timer
from vo2_interface.timing import LoopTiming
from vo2_interface.topics import (
    COMMAND,
    COMMAND_CHANNELS,
    COMMANDER,
    DEFAULT_NAMESPACE,
    MEASUREMENT,
    ONE_DEVICE,
    SAMPLE_QOS,
)
from vo2_models.parameters import Parameter

from rig_template.link import Link, LinkError, open_link

__all__ = ["RIG_PARAMETERS", "RigNode", "main"]

RIG_PARAMETERS = (
    Parameter(
        "preset",
        "integrated",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file.",
    ),
    Parameter(
        "connection", "tcp://127.0.0.1:5025", "", "tcp://HOST:PORT, or serial:///dev/ttyUSB0?baud=115200."
    ),
    Parameter("rate_hz", 0.0, "Hz", "Sampling rate; 0 for the preset's.", 0.0, 20e3),
    AUTOSTART,
    Parameter("timeout_s", 0.1, "s", "After which an answer that has not come is a fault.", 1e-3, 60.0),
    Parameter(
        "channels",
        ["heater_current", "film_resistance", "tip_deflection"],
        "",
        "Names of the values that the instrument answers a reading with, in their order, in SI units.",
    ),
    Parameter("protocol.identify", "*IDN?", "", "Question that is asked once; empty for none."),
    Parameter("protocol.read", "READ?", "", "Question that is answered with one sample, values with commas."),
    Parameter("protocol.drive", "SOUR:CURR {:.9g}", "", "Line that sets the current [A]."),
    Parameter("protocol.on", "OUTP ON", "", "Line that switches the output on; empty for none."),
    Parameter("protocol.off", "OUTP OFF", "", "Line that switches the output off; empty for none."),
)
_NS = 1_000_000_000
_OVERRANGE = 9.9e37
"""What SCPI answers beyond a range; 9.91e37 is no number at all: Rohde & Schwarz, NGE100B User Manual, "Numeric values"."""
_PACE_S = 1.0
"""Time between two reports of how well the periods are kept [s]."""
_LATE = 0.75
"""Share of a period by which a sample may be late before it counts as skipped."""


class RigNode(ManagedNode):
    """Commands in, lines to the instrument, measurements out."""

    def __init__(self) -> None:
        super().__init__("rig", namespace=DEFAULT_NAMESPACE)
        self._table = ParameterTable(
            self, RIG_PARAMETERS, read_only=[record.name for record in RIG_PARAMETERS]
        )
        preset = self._table.text("preset")
        point = operating_point(preset)
        self._period_s = 1.0 / (self._table.number("rate_hz") or point.rate_hz)
        self._channels = tuple(str(name) for name in self._table["channels"])  # type: ignore[union-attr]
        self._diagnostics = Diagnostics(self, hardware_id=preset, wall_time=True)
        self._safe_a = point.safe_a
        self._gate = CommandGate(point, round(self._period_s * _NS), self._diagnostics)
        self._stop = EmergencyStop(self, self._diagnostics)
        self._link: Link | None = None
        self._stamp_ns, self._due_s, self._drives_a = 0, 0.0, self._safe_a
        self._timing, self._told_s = LoopTiming(self._period_s), 0.0
        self._reader = SampleReader((*COMMAND_CHANNELS, COMMANDER))
        self._writer = SampleWriter(self._channels, preset)
        self._publisher = self.create_publisher(JointState, MEASUREMENT, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher, ONE_DEVICE)
        self._manage(self._diagnostics, autostart=self._table.flag("autostart"))
        SampleInput(self, COMMAND, self._guarded(self._on_command), self._diagnostics)
        create_steady_timer(self, self._period_s, self._guarded(self._on_tick))

    # --- what speaks to the instrument: replace this for another one --------------------------------

    def _connect(self) -> None:
        table = self._table
        self._link = open_link(table.text("connection"), table.number("timeout_s"))
        try:
            table.text("protocol.drive").format(self._safe_a)
        except (ValueError, IndexError, KeyError) as error:
            raise LinkError(f"protocol.drive: {error}: need one {{}} for the current") from error
        who = self._link.ask(table.text("protocol.identify")) if table.text("protocol.identify") else ""
        self._diagnostics.report("instrument", "ok", f"{table.text('connection')}: {who or 'connected'}")

    def _switch(self, on: bool) -> None:
        words = self._table.text("protocol.on" if on else "protocol.off")
        if self._link is not None and words:
            self._link.write(words)

    def _drive(self, current_a: float) -> None:
        if self._link is not None:
            self._link.write(self._table.text("protocol.drive").format(current_a))
        self._drives_a = current_a

    def _sample(self) -> tuple[float, ...]:
        """Return one value per channel; raise `LinkError` for anything else."""
        if self._link is None:
            raise LinkError("not connected: configure the node")
        answer = self._link.ask(self._table.text("protocol.read"))
        try:
            values = tuple(float(part) for part in answer.split(","))
        except ValueError:
            values = ()
        if len(values) != len(self._channels):
            raise LinkError(
                f"{self._table.text('protocol.read')}: found {answer[:60]!r}, need {len(self._channels)} numbers "
                f"({', '.join(self._channels)})"
            )
        without = [name for name, value in zip(self._channels, values, strict=True) if not _is_reading(value)]
        if without:
            self._diagnostics.report(
                "reading",
                "error",
                f"{self._table.text('protocol.read')}: no value of {', '.join(without)} (not a number, or beyond the "
                "instrument's range): published as NaN",
            )
        elif self._diagnostics.level("reading") != "ok":
            self._diagnostics.report("reading", "ok", "every channel has a value")
        return tuple(value if _is_reading(value) else math.nan for value in values)

    # --- life cycle ---------------------------------------------------------------------------------

    def _configure(self) -> None:
        try:
            self._connect()
            self._rest()
        except LinkError:
            self._cleanup()
            raise

    def _activate(self) -> None:
        self._gate.reset()
        self._drive(self._safe_a)
        self._switch(True)
        self._due_s, self._stamp_ns = time.monotonic(), 0

    def _rest(self) -> None:
        """Safe current, output off."""
        if self._link is not None:
            self._drive(self._safe_a)
            self._switch(False)

    def _cleanup(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def _end(self) -> None:
        try:
            self._rest()
        except LinkError as error:
            self._diagnostics.report(
                "instrument", "error", f"{error}: the node cannot switch it off, do so by hand"
            )
        self._cleanup()

    def close(self) -> None:
        """Leave the device at the safe current, output off: the process ends."""
        self._active = False
        self._end()

    # --- samples ------------------------------------------------------------------------------------

    def _on_command(self, data: bytes) -> None:
        stamp_ns, (current, commander) = self._reader.read(data)
        if not self.active or not self._stamp_ns:
            return
        applied = self._gate.take(stamp_ns, current, commander, self._stamp_ns)
        if applied is not None:
            now = time.monotonic()
            self._timing.command(now, max(0.0, 1e-9 * (time.time_ns() - stamp_ns)))
            self._apply(applied)

    def _apply(self, current_a: float) -> None:
        """Drive a current at once, whatever is commanded the safe one while the graph is stopped."""
        if self._stop.active:
            current_a = self._safe_a
        if current_a == self._drives_a:
            return
        try:
            self._drive(current_a)
        except LinkError as error:
            self._lose(error)

    def _on_tick(self) -> None:
        if not self.active:
            return
        now = time.monotonic()
        if now - self._due_s < -0.5 * self._period_s:
            return
        self._due_s = min(self._due_s, now)
        behind = int((now - self._due_s) / self._period_s + 1.0 - _LATE)
        self._due_s += (behind + 1) * self._period_s
        self._timing.sample(now, behind, self._gate.answered_ns >= self._stamp_ns)
        for _ in range(behind + 1):
            current = self._gate.next_period()
        self._apply(current)
        if not self.active:
            return
        self._stamp_ns = time.time_ns()
        try:
            values = self._sample()
        except LinkError as error:
            self._lose(error)
            return
        message = self._writer.write(self._stamp_ns, values)
        self._publisher.publish(message)
        self._diagnostics.note_sample(message)
        if now - self._told_s >= _PACE_S:
            self._told_s = now
            self._diagnostics.report("pace", "ok", "wall time", self._timing.values())

    def _lose(self, error: LinkError) -> None:
        """End at an instrument that does not answer as it should."""
        self._diagnostics.report("instrument", "error", str(error))
        self._fail(str(error))


def _is_reading(value: float) -> bool:
    """Whether a number is one that was measured."""
    return abs(value) < _OVERRANGE  # false of NaN


main = node_main(RigNode)

if __name__ == "__main__":
    sys.exit(main())
