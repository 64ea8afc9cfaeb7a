"""What the nodes that command have in common: one sample and one set-point in, one current out, and safe without them.

In lockstep every sample is answered. In wall time a sample counts only while it is young: what piled up behind a stall
is dropped, a period without input is told to the supervisor, and the loop closes once the plant follows.
"""

from __future__ import annotations

import math
import secrets
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median

from sensor_msgs.msg import JointState
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.emergency_stop import EmergencyStop
from vo2_interface.inputs import SampleInput
from vo2_interface.lockstep import HOLD_SAMPLES, SampleAge, StampOrder
from vo2_interface.managed import AUTOSTART, ManagedNode
from vo2_interface.model import model_parameters, operating_point
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.timers import create_steady_timer
from vo2_interface.topics import (
    COMMAND,
    COMMAND_CHANNELS,
    COMMANDER,
    DEFAULT_NAMESPACE,
    MEASUREMENT,
    REFERENCE,
    REFERENCE_CHANNELS,
    SAMPLE_QOS,
)
from vo2_models.device.description import preset as description
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import TIP_DEFLECTION

from vo2_control.designs import check_device_limits
from vo2_control.echo import CommandEcho
from vo2_control.safe import OPEN, Decision, SafetySettings, Supervisor

__all__ = ["COMMAND_NODE_PARAMETERS", "CommandNode"]

COMMAND_NODE_PARAMETERS = (
    Parameter(
        "preset",
        "integrated",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file.",
    ),
    AUTOSTART,
    Parameter(
        "enabled",
        True,
        "",
        "Whether the node commands; off, it sends the safe current once and only listens.",
    ),
    Parameter("time", "lockstep", "", "Whose pace the loop keeps.", choices=("lockstep", "wall")),
    Parameter("rate_hz", 0.0, "Hz", "Sampling rate; 0 for the preset's.", 0.0, 20e3),
    Parameter(
        "reference_hold",
        False,
        "",
        "True: the last set-point holds until the next (set-points by hand). "
        "False: every sample waits for the set-point of its own stamp.",
    ),
)
_LISTEN_S = 0.5
"""Wall time for which a node that has just found its input, or another commander, listens before it commands [s]."""
_LATE = 1.5
"""Periods after which a sample that has not come counts as missing, and one that comes is too old to be answered."""
_STEPS, _OTHER_RATE = 32, 0.2
"""Samples after which their rate is looked at, and by how much it may differ from the node's [1]."""
_ON_THE_WAY = 0.25
"""Share of a period that a command may take to the plant, so that it arrives before the next sample."""


class CommandNode(ManagedNode):
    """A node that answers each sample of `source` together with its set-point.

    A node built on it makes `_supervisor` in `_configure` (None: the safe current for every sample), calls `_listen` at
    the end of its constructor, and implements `_restart`, `_rebuild` and `_decide`.

    Parameters
    ----------
    name : of the node
    records : parameters beside `COMMAND_NODE_PARAMETERS` and `model.*`
    source : topic whose samples are answered
    channels : what it needs of them
    """

    def __init__(self, name: str, records: Sequence[Parameter], source: str, channels: Sequence[str]) -> None:
        super().__init__(name, namespace=DEFAULT_NAMESPACE)
        self._table = ParameterTable(
            self,
            (*COMMAND_NODE_PARAMETERS, *records, *model_parameters()),
            read_only=("preset", "time", "rate_hz", "autostart"),
            judge=self._judge,
        )
        self._revision = self._table.revision
        preset = self._table.text("preset")
        self._point = operating_point(preset)
        self._period_s = 1.0 / (self._table.number("rate_hz") or self._point.rate_hz)
        self._wall = self._table.text("time") == "wall"
        self._diagnostics = Diagnostics(self, hardware_id=preset, wall_time=self._wall)
        self._stop = EmergencyStop(self, self._diagnostics)
        self._supervisor: Supervisor | None = None
        self._source = source
        self._order, self._age = StampOrder(), SampleAge()
        self._source_ns: int | None = None
        self._steps_s: list[float] = []
        self._echo = CommandEcho(self._point.safe_a, self._point.most_a - self._point.least_a)
        self._reference: tuple[int, float] | None = None
        self._waiting: tuple[int, tuple[float, ...]] | None = None
        self._answer = b""
        self._input_s = self._heard_s = -math.inf
        self._good_ns = 0
        self._source_reader = SampleReader(channels)
        self._reference_reader = SampleReader(REFERENCE_CHANNELS)
        self._current_reader = SampleReader(COMMAND_CHANNELS)
        # in lockstep a command carries nothing that differs from run to run
        self._name: tuple[float, ...] = (float(secrets.randbits(32)),) if self._wall else ()
        self._rival_s, self._rival = -math.inf, math.nan
        self._commanders, self._listen_until_s = 0, -math.inf
        self._rival_reader = SampleReader((COMMANDER,))
        self._writer = SampleWriter((*COMMAND_CHANNELS, *((COMMANDER,) if self._wall else ())), preset)
        self._publisher = self.create_publisher(JointState, COMMAND, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher)

    def _listen(self) -> None:
        """Begin to live: samples are taken last, so that none waits for what the node builds."""
        self._manage(self._diagnostics, autostart=self._table.flag("autostart"))
        SampleInput(self, REFERENCE, self._guarded(self._on_reference), self._diagnostics, latched=True)
        SampleInput(self, self._source, self._guarded(self._on_source), self._diagnostics)
        if self._wall:
            SampleInput(self, MEASUREMENT, self._on_current, self._diagnostics)
            SampleInput(self, COMMAND, self._on_command, self._diagnostics, steady=False)
            create_steady_timer(self, self._period_s, self._guarded(self._on_tick))

    def _activate(self) -> None:
        """Begin as for a device that has been switched on, and listen for other commanders first."""
        self._order, self._age = StampOrder(), SampleAge()
        self._waiting, self._answer = None, b""
        self._commanders, self._listen_until_s = 0, -math.inf
        self._echo.restart()
        self._restart()

    def _rest(self) -> None:
        """Leave the device at the safe current (wall time; in lockstep no time passes without us)."""
        commands = self._supervisor is not None and self._supervisor.mode != "idle"
        if self._wall and commands and self._order.last_ns is not None:
            self._publish(self._present_ns(), self._point.safe_a)
        if self._supervisor is not None:
            self._supervisor.stand_by()

    def _cleanup(self) -> None:
        self._supervisor = None

    # --- what a node built on this one adds ---------------------------------------------------------

    @abstractmethod
    def _rebuild(self) -> object:
        """Take over changed parameters."""

    @abstractmethod
    def _restart(self) -> None:
        """Start anew, as for a device that has been switched on."""

    @abstractmethod
    def _decide(
        self, supervisor: Supervisor, stamp_ns: int, values: tuple[float, ...], reference_m: float
    ) -> Decision | str:
        """Return what to command for a sample and its finite set-point, or in words why the sample cannot be used."""

    def _settings(self, reach_m: tuple[float, float]) -> SafetySettings:
        device = description(self._table.text("preset"))
        told = device.tells("responses", device.names.get(TIP_DEFLECTION, ""), "range")
        settings = SafetySettings(
            self._period_s,
            safe_current_a=self._point.safe_a,
            hold_periods=HOLD_SAMPLES,
            reach_m=reach_m,
            wall_time=self._wall,
            unit=self._point.unit,
            response_unit=device.units.get(TIP_DEFLECTION, "m"),
        )
        return replace(settings, range_m=device.deflection_extent) if told else settings

    @property
    def _followed(self) -> bool:
        """Whether the plant does what it is told; in lockstep it cannot go on without."""
        return self._echo.followed or not self._wall

    # --- samples ------------------------------------------------------------------------------------

    def _on_reference(self, data: bytes) -> None:
        stamp_ns, (value,) = self._reference_reader.read(data)
        self._reference = (stamp_ns, value)
        self._act()

    def _on_current(self, data: bytes) -> None:
        stamp_ns, (current,) = self._current_reader.read(data)
        self._echo.measure(stamp_ns, current)

    def _on_command(self, data: bytes) -> None:
        _stamp_ns, (name,) = self._rival_reader.read(data)
        if name != self._name[0]:
            self._rival_s, self._rival = time.monotonic(), name

    def _stands_by(self, mode: str) -> bool:
        """Whether another node commands: the first that does goes on, of two that begin together the lower number."""
        if mode not in OPEN or time.monotonic() - self._rival_s > HOLD_SAMPLES * self._period_s:
            return False
        return mode != "starting" or not self._rival > self._name[0]

    def _listens(self, mode: str) -> bool:
        """Whether it is too early to know that nobody else commands.

        A node meets the others one after the other: its input may come before it hears who answers that. So it listens
        from its first sample on, and anew where another commander appears, for several of the other's commands.
        """
        now = time.monotonic()
        if mode == "idle":
            before, self._commanders = self._commanders, self.count_publishers(COMMAND)
            if self._commanders > before:
                self._listen_until_s = now + max(_LISTEN_S, 2 * HOLD_SAMPLES * self._period_s)
        return now < self._listen_until_s

    def _holds_back(self, stamp_ns: int) -> bool:
        """Wall time: whether a sample is left to another commander."""
        supervisor = self._supervisor
        if supervisor is not None:
            supervisor.release(stamp_ns * 1e-9, followed=self._followed)
        mode = supervisor.mode if supervisor is not None else "idle"
        if self._stands_by(mode):
            if supervisor is not None:
                supervisor.stand_by()
            self._diagnostics.report(
                "input",
                "warn",
                f"another node commands on {COMMAND}: standing by until it is silent",
                stamp_ns=stamp_ns,
            )
            return True
        return mode in OPEN and self._listens(mode)

    def _on_source(self, data: bytes) -> None:
        stamp_ns, values = self._source_reader.read(data)
        order = self._order.judge(stamp_ns)
        if order == "repeat":
            if self._answer and self.active and not self._wall and self._table.flag("enabled"):
                self._publisher.publish(self._answer)
            return
        if order == "late":
            self._diagnostics.count("late", f"samples on {self._source} came late and were dropped")
            return
        if order == "restart":
            self._diagnostics.report(
                "stamps",
                "warn",
                f"the stamp on {self._source} jumped back: the loop starts anew",
                stamp_ns=stamp_ns,
            )
            self._age = SampleAge()
            self._restart()
        self._heard_s = time.monotonic()
        self._age.hear(stamp_ns, self._heard_s)
        self._look_at_rate(stamp_ns)
        self._waiting = (stamp_ns, values)
        self._act()

    def _look_at_rate(self, stamp_ns: int) -> None:
        """Tell where samples do not come at the rate that the law and its limits in time are made for."""
        last_ns, self._source_ns = self._source_ns, stamp_ns
        if last_ns is None or stamp_ns <= last_ns:
            self._steps_s.clear()
            return
        self._steps_s.append(1e-9 * (stamp_ns - last_ns))
        if len(self._steps_s) < _STEPS:
            return
        period_s, level = median(self._steps_s), self._diagnostics.level("rate")
        self._steps_s.clear()
        if abs(period_s / self._period_s - 1.0) > _OTHER_RATE:
            text = f"samples on {self._source} come at {1.0 / period_s:.4g} Hz, this node runs at {1.0 / self._period_s:.4g} Hz"
            self._diagnostics.report(
                "rate", "warn", f"{text}: set rate_hz and start it anew", stamp_ns=stamp_ns
            )
        elif level != "ok":
            self._diagnostics.report("rate", "ok", "samples come at the rate of this node", stamp_ns=stamp_ns)

    def _act(self) -> None:
        """Answer the waiting sample if its set-point is there."""
        table = self._table
        if not self.active or self._waiting is None or not table["enabled"]:
            return
        stamp_ns, values = self._waiting
        if self._wall and self._holds_back(stamp_ns):
            self._waiting = None
            self._order.accept(stamp_ns)
            self._input_s = time.monotonic()
            return
        if self._reference is None:
            if table["reference_hold"]:
                self._miss(
                    stamp_ns, f"no set-point on {REFERENCE} yet; start the reference node or publish one"
                )
            return
        reference_ns, reference = self._reference
        if reference_ns != stamp_ns and not table["reference_hold"]:
            return
        self._waiting = None
        self._order.accept(stamp_ns)
        now = time.monotonic()
        age = self._age.age_s(stamp_ns, now) / self._period_s if self._wall else 0.0
        if age > HOLD_SAMPLES:
            self._diagnostics.count(
                "stale", f"samples on {self._source} were older than {HOLD_SAMPLES} periods and not answered"
            )
            return
        self._input_s = now
        if table.revision != self._revision:
            self._revision = table.revision
            self._rebuild()
        supervisor = self._supervisor
        if supervisor is None or self._stop.active:
            if supervisor is not None:
                supervisor.stand_by()
            self._publish(stamp_ns, self._point.safe_a)
            return
        if not math.isfinite(reference):
            self._miss(stamp_ns, f"tip_deflection on {REFERENCE} is {reference}: send finite set-points")
            return
        if age > _LATE:
            # a newer one is on its way: of what piled up only that may move the law, or an integrator would run ahead
            self._miss(stamp_ns, f"samples on {self._source} come more than {_LATE:g} periods late")
            return
        if self._wall and math.isfinite(astray := self._echo.astray):
            unit = self._point.unit
            self._miss(
                stamp_ns,
                f"the measured current is {astray:.4g} {unit} where {self._echo.told:.4g} {unit} are commanded: "
                "the driver does not obey, or its sensor is wrong",
            )
            return
        before = supervisor.mode
        if before != "starting" and before in OPEN:
            self._echo.restart()
        decision = self._decide(supervisor, stamp_ns, values, reference)
        if isinstance(decision, str):
            self._miss(stamp_ns, decision)
            return
        if decision.mode in ("holding", "safe"):
            self._let_go(decision, stamp_ns)
            return
        self._tell(before, decision, stamp_ns)
        self._good_ns = stamp_ns
        self._publish(stamp_ns, decision.current_a)

    def _tell(self, before: str, decision: Decision, stamp_ns: int) -> None:
        """Report what has changed with a sample."""
        report, level = self._diagnostics.report, self._diagnostics.level
        if decision.mode == "starting":
            report("input", "warn", decision.reason, stamp_ns=stamp_ns)
        elif before in OPEN or level("input") != "ok":
            report("input", "ok", "input is there, the loop is closed", stamp_ns=stamp_ns)
        if decision.mode == "limited":
            report("reference", "warn", decision.reason, stamp_ns=stamp_ns)
        elif level("reference") != "ok":
            report("reference", "ok", "reference is reachable again", stamp_ns=stamp_ns)

    def _miss(self, stamp_ns: int, why: str) -> None:
        """Answer a sample that cannot be used or that did not come."""
        self._waiting = None
        if self._supervisor is None:
            self._publish(stamp_ns, self._point.safe_a)
            return
        self._let_go(self._supervisor.lost(stamp_ns * 1e-9, why), stamp_ns)

    def _let_go(self, decision: Decision, stamp_ns: int) -> None:
        """Report why a sample has no answer of the law, and command what there is without."""
        level = "error" if decision.mode == "safe" else "warn"
        self._diagnostics.report("input", level, decision.reason, stamp_ns=stamp_ns)
        if self._wall and decision.mode == "holding":
            # the plant counts from the sample that led to the current: it ends the hold even where this node comes late
            stamp_ns = self._good_ns
        self._publish(stamp_ns, decision.current_a)

    def _publish(self, stamp_ns: int, current_a: float) -> None:
        """Command a current, whatever the law says within what the device bears."""
        current = min(max(current_a, self._point.least_a), self._point.most_a)
        if self._stop.active:
            current = self._point.safe_a
        self._answer = self._writer.write(stamp_ns, (current, *self._name))
        self._publisher.publish(self._answer)
        self._echo.command(stamp_ns, current)

    def _on_tick(self) -> None:
        """Wall time: a period without an answered sample is a missed input."""
        if not self.active or self._order.last_ns is None:
            return
        if not self._table.flag("enabled"):
            self._rest()
            return
        if self._holds_back(self._order.last_ns):
            return
        # the clock here and the arrival of samples drift against each other: a period without input is no gap yet
        now = time.monotonic()
        if now - self._input_s > _LATE * self._period_s:
            # so that the next tick, early or late, tells the next missing sample
            self._input_s = now - 0.75 * self._period_s
            missing = REFERENCE if now - self._heard_s < 2 * _LATE * self._period_s else self._source
            self._miss(self._present_ns(), f"nothing on {missing}: is its node running?")

    def _present_ns(self) -> int:
        """Return the stamp [ns] of the sample that should be the last one when what is now commanded arrives.

        The clock here ticks at any phase of the plant's: the next tick would tell one that is due soon too late.
        """
        last_ns = self._order.last_ns or 0
        passed_s = self._age.stamp_s(time.monotonic()) - 1e-9 * last_ns
        return last_ns + round(1e9 * self._period_s) * max(1, int(passed_s / self._period_s + _ON_THE_WAY))

    def _judge(self, values: Mapping[str, Value]) -> None:
        """Refuse parameters that the device does not bear."""
        check_device_limits(self._table.text("preset"), self._period_s, values)
