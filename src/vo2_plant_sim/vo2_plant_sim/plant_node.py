"""`plant`: the simulated device under test on the graph.

In lockstep a command answers the measurement whose stamp it carries; the plant applies it, advances one
sample and publishes the next measurement, as fast as the loop answers. In wall time the plant keeps the
pace, applies the newest command, and takes the safe current when commands stop. There it refuses commands that
are too old by the stamp they answer, and listens to one commander until that one is silent. In both it applies
no current that the device does not bear.

`--effects DIR`, before `--ros-args` and as often as needed, adds a folder of effect files of your own to what the
parameter `effects` knows.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from vo2_interface.command_gate import CommandGate
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.emergency_stop import EmergencyStop
from vo2_interface.executable import node_main
from vo2_interface.inputs import SampleInput
from vo2_interface.lockstep import REPEAT_S
from vo2_interface.model import model_parameters, operating_point
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import ClockWriter, SampleReader, SampleWriter
from vo2_interface.timers import create_steady_timer
from vo2_interface.timing import LoopTiming
from vo2_interface.topics import (
    CLOCK,
    COMMAND,
    COMMAND_CHANNELS,
    COMMANDER,
    DEFAULT_NAMESPACE,
    LOCKSTEP_QOS,
    MEASUREMENT,
    ONE_DEVICE,
    SAMPLE_QOS,
)
from vo2_models.device.description import preset as description
from vo2_models.parameters import Parameter, Value

from vo2_plant_sim.simulated_device import SIMULATED_DEVICE_PARAMETERS, TRUE_CHANNELS, simulated_device

__all__ = ["PLANT_PARAMETERS", "PlantNode", "main"]

PLANT_PARAMETERS = (
    Parameter(
        "preset",
        "integrated",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file.",
    ),
    Parameter(
        "time", "lockstep", "", "Simulated time in lockstep, or wall time.", choices=("lockstep", "wall")
    ),
    Parameter("rate_hz", 0.0, "Hz", "Sampling rate; 0 for the preset's.", 0.0, 20e3),
    Parameter(
        "run_until_s",
        0.0,
        "s",
        "Lockstep: simulated time stands still from this stamp on until the value is raised; 0 for never.",
        0.0,
        1e10,
    ),
    Parameter(
        "start_s",
        1.0,
        "s",
        "Lockstep: stamp of the first sample. By default simulated time, and with it a bag, begins in 1970.",
        1.0,
        2e9,
    ),
    Parameter("clock", True, "", "Lockstep: publish simulated time on /clock, at most every 10 ms of it."),
    Parameter(
        "true_channels", False, "", "Add what no rig measures: true_tip_deflection and true_temperature."
    ),
)
_CLOCK_NS = 10_000_000
_BEAT_NS = 1_000_000_000
_OVER_S = 3.0
"""Wall time without a command that does not belong here after which the warning of it is taken back [s]."""
_LATE = 0.75
"""Share of a period by which a sample may be late before it counts as skipped."""


class PlantNode(Node):
    """Parameters in, commands in, one step of the device, measurements out.

    Parameters
    ----------
    namespace : its default namespace
    defaults : values instead of the defaults of `PLANT_PARAMETERS` and `SIMULATED_DEVICE_PARAMETERS`; what a file or a
        command line says goes before them
    """

    def __init__(
        self, namespace: str = DEFAULT_NAMESPACE, defaults: Mapping[str, Value] = MappingProxyType({})
    ) -> None:
        super().__init__("plant", namespace=namespace)
        own = [
            replace(record, default=defaults.get(record.name, record.default))
            for record in (*PLANT_PARAMETERS, *SIMULATED_DEVICE_PARAMETERS)
        ]
        records = (*own, *model_parameters())
        fixed = [record.name for record in own]
        fixed.remove("run_until_s")
        self._table = ParameterTable(self, records, read_only=fixed)
        preset = self._table.text("preset")
        self._device = simulated_device(preset, self._table.number("rate_hz"), self._table)
        self._period_ns = round(self._device.period * 1e9)
        self._lockstep = self._table.text("time") == "lockstep"
        self._truth = self._table.flag("true_channels")
        # of a published file `preset` is a whole description
        device_id = description(preset).id
        self._diagnostics = Diagnostics(self, hardware_id=device_id, wall_time=not self._lockstep)
        self._until_ns = 0
        self._odd_at: float | None = None
        self._revision = -1
        self._index = -1
        self._start_ns = round(self._table.number("start_s") * 1e6) * 1000  # a double has no more of it
        self._stamp_ns = self._start_ns
        self._command: tuple[int, float] | None = None
        point = operating_point(preset)
        self._gate = CommandGate(point, self._period_ns, self._diagnostics)
        self._timing = LoopTiming(self._device.period)
        self._used_a = self._safe_a = point.safe_a
        self._clock_every = max(1, _CLOCK_NS // self._period_ns)
        self._beat_every = max(1, _BEAT_NS // self._period_ns)
        names = (*self._device.channels, *TRUE_CHANNELS) if self._truth else self._device.channels
        self._writer = SampleWriter(names, preset)
        self._clock_writer = ClockWriter()
        self._reader = SampleReader(COMMAND_CHANNELS)
        self._answer = b""
        qos = LOCKSTEP_QOS if self._lockstep else SAMPLE_QOS
        self._publisher = self.create_publisher(JointState, MEASUREMENT, qos)
        alone = dict(ONE_DEVICE)
        self._clock_out = None
        if self._lockstep and self._table.flag("clock"):
            self._clock_out = self.create_publisher(Clock, CLOCK, SAMPLE_QOS)
            alone[CLOCK] = "let one plant tell the time, clock:=false on the others"
        self._diagnostics.watch_listeners(self._publisher, alone)
        self._stop = EmergencyStop(self, self._diagnostics)
        self._published_at = time.monotonic()
        if self._lockstep:
            SampleInput(self, COMMAND, self._on_command, self._diagnostics)
            self._advance(self._safe_a)
            self._publish()
            create_steady_timer(self, REPEAT_S / 4.0, self._on_quiet)
        else:
            self._due_s = 0.0
            self._reader = SampleReader((*COMMAND_CHANNELS, COMMANDER))
            SampleInput(self, COMMAND, self._on_paced_command, self._diagnostics)
            create_steady_timer(self, self._device.period, self._on_tick)
        self._tell_device(device_id)

    def _tell_device(self, device_id: str) -> None:
        """Say what is simulated: from outside one device looks like another."""
        table = self._table
        what = f"seed {table.number('seed'):g}" if table.text("source") == "truth" else "the model of model.*"
        parts = [
            f"simulates {device_id}, {what}",
            f"effects {table.text('effects') or 'none'}",
            f"noise {'on' if table.flag('noise') else 'off'}",
            f"{table.text('time')} time at {1.0 / self._device.period:g} Hz",
        ]
        self._diagnostics.report("device", "ok", ", ".join(parts))

    def _on_paced_command(self, data: bytes) -> None:
        """Wall time: take the newest command of the one that commands."""
        stamp_ns, (current, commander) = self._reader.read(data)
        before_ns = self._gate.answered_ns
        if self._gate.take(stamp_ns, current, commander, self._stamp_ns) is None or stamp_ns == before_ns:
            # refused, or a current that is held without a new sample: no answer to time
            return
        now = time.monotonic()
        late_s = now - self._published_at + 1e-9 * (self._stamp_ns - stamp_ns)
        self._timing.command(now, max(late_s, 0.0))

    def _on_command(self, data: bytes) -> None:
        """Lockstep: take the answer to the present sample."""
        stamp_ns, (current,) = self._reader.read(data)
        current = self._gate.borne(current, self._stamp_ns)
        if stamp_ns == self._stamp_ns and self._command is None:
            self._command = (stamp_ns, current)
            self._answer_lockstep()
            if self._odd_at is not None and time.monotonic() - self._odd_at > _OVER_S:
                self._odd_at = None
                self._diagnostics.report("command", "ok", "one command for each measurement again")
        elif stamp_ns > self._stamp_ns:
            self._odd_at = time.monotonic()
            self._diagnostics.report(
                "command",
                "warn",
                "commands stamped ahead of the measurement are dropped: is there a second plant in this namespace? "
                "A command must carry the stamp of the measurement that it answers",
                stamp_ns=self._stamp_ns,
            )
        elif stamp_ns == self._stamp_ns - self._period_ns and current != self._used_a:
            self._odd_at = time.monotonic()
            self._diagnostics.report(
                "command",
                "warn",
                f"two different commands for one measurement: let only one node command on {COMMAND}",
                stamp_ns=self._stamp_ns,
            )

    def _answer_lockstep(self) -> None:
        """Advance one sample with the command at hand, unless simulated time is to stand still."""
        if self._table.revision != self._revision:
            self._revision = self._table.revision
            self._until_ns = round(self._table.number("run_until_s") * 1e9)
        if self._command is None:
            return
        if 0 < self._until_ns <= self._stamp_ns:
            stamp = f"{self._stamp_ns * 1e-9:.9f}"
            self._diagnostics.report(
                "time",
                "ok",
                "simulated time stands still (run_until_s)",
                {"stamp_s": stamp},
                stamp_ns=self._stamp_ns,
            )
            return
        current = self._command[1]
        self._command = None
        self._advance(current)
        self._publish()

    def _on_quiet(self) -> None:
        """Lockstep, by wall time: take up a raised run_until_s, repeat a sample that nobody answered."""
        self._answer_lockstep()
        now = time.monotonic()
        if now - self._published_at >= REPEAT_S:
            self._publish()

    def _on_tick(self) -> None:
        """Wall time: keep the pace, whoever answers."""
        period, now = self._device.period, time.monotonic()
        if self._index < 0:
            self._start_ns = time.time_ns()
            self._due_s = now
        if now - self._due_s < -0.5 * period:
            return
        # the earliest ticks tell when samples are due, so that one that came late does not make the others early
        self._due_s = min(self._due_s, now)
        behind = int((now - self._due_s) / period + 1.0 - _LATE)
        self._due_s += (behind + 1) * period
        self._timing.sample(now, behind, self._gate.answered_ns >= self._stamp_ns)
        # after a long stall the device is not stepped through all of it
        steps = min(behind + 1, round(1e9 / self._period_ns) + 1)
        self._index += behind + 1 - steps
        for _ in range(steps):
            self._advance(self._gate.next_period())
        self._publish()
        if self._index % self._beat_every == 0:
            self._diagnostics.report("pace", "ok", "wall time", self._timing.values())

    def _advance(self, current_a: float) -> None:
        if self._stop.active:
            current_a = self._safe_a
        values = self._device.step(current_a)
        self._used_a = current_a
        self._index += 1
        self._stamp_ns = self._start_ns + self._index * self._period_ns
        true = self._device.true_values() if self._truth else ()
        self._answer = self._writer.write(self._stamp_ns, (*values, *true))
        self._diagnostics.note_sample(self._answer)
        if self._lockstep and self._index % self._beat_every == 0:
            self._diagnostics.beat(self._stamp_ns)

    def _publish(self) -> None:
        try:
            self._publisher.publish(self._answer)
        except rclpy_implementation.RCLError:
            if not self._lockstep:
                raise
            # nobody has got it: `_on_quiet` tries again
            self._diagnostics.report(
                "listeners",
                "warn",
                f"a listener of {MEASUREMENT} does not keep up: simulated time waits for it, up to 20 s if it is gone",
                stamp_ns=self._stamp_ns,
            )
            return
        self._published_at = time.monotonic()
        if self._lockstep and self._diagnostics.level("listeners") != "ok":
            self._diagnostics.report(
                "listeners", "ok", "every listener keeps up again", stamp_ns=self._stamp_ns
            )
        # after the sample that the loop waits for
        if self._clock_out is not None and self._index % self._clock_every == 0:
            self._clock_out.publish(self._clock_writer.write(self._stamp_ns))


main = node_main(PlantNode)

if __name__ == "__main__":
    sys.exit(main())
