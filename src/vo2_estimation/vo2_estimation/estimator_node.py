"""`estimator`: film resistance in, tip deflection with its temperature surrogate and error bound out."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping
from statistics import median_low

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
    ESTIMATE,
    ESTIMATE_CHANNELS,
    MEASUREMENT,
    SAMPLE_QOS,
)
from vo2_models.device.description import DeviceDescription, check_model_of
from vo2_models.device.description import preset as description
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION

from vo2_estimation.resistance_check import ResistanceCheck, sensor_limits
from vo2_estimation.schemes import SCHEMES, Scheme, make_scheme

__all__ = ["ESTIMATOR_PARAMETERS", "EstimatorNode", "main"]

ESTIMATOR_PARAMETERS = (
    Parameter(
        "preset",
        "integrated",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file.",
    ),
    Parameter(
        "kind",
        "composite",
        "",
        "Self-sensing scheme; drive predicts deflection and resistance from the drive alone.",
        choices=SCHEMES,
    ),
    Parameter(
        "drive_channel",
        "heater_voltage",
        "",
        "Channel that kind drive takes with a law of its own; a model that fit wrote takes the drive.",
    ),
    Parameter(
        "sensor.check",
        True,
        "",
        "Whether a stuck, saturated or disconnected resistance sensor gives NaN, on which a loop goes safe.",
    ),
    Parameter(
        "sensor.lower_ohm",
        0.0,
        "ohm",
        "Lower end of the sensor's range; 0 for a tenth of the preset's.",
        0.0,
        1e15,
    ),
    Parameter(
        "sensor.upper_ohm",
        0.0,
        "ohm",
        "Upper end of the sensor's range; 0 for ten times the preset's.",
        0.0,
        1e15,
    ),
)
_NAN = float("nan")
_BEAT_SAMPLES = 1000
_STEPS = 31
"""Last steps between samples whose median is taken for the period."""
_GAP = 1.5
"""Periods between two samples beyond which one was lost."""
_STILL = 0.03
"""Share of the body's time constant in which nothing happens that a hysteresis remembers."""
_JITTER = 0.02
"""Relative deviation of the sample period from the model's that counts as another period."""
_OFF_PERIOD_SAMPLES = 10
"""Samples in a row at another period before it is told: a single gap is no other rate."""
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
        self._check: ResistanceCheck | None = None
        self._off_period = 0
        self._used_ns: int | None = None
        self._steps_ns: deque[int] = deque(maxlen=_STEPS)
        self._device = description(preset)
        self._reader = SampleReader((RESISTANCE, HEATER_CURRENT))
        self._writer = SampleWriter(ESTIMATE_CHANNELS, preset)
        self._answer = b""
        self._publisher = self.create_publisher(JointState, ESTIMATE, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher)
        SampleInput(self, MEASUREMENT, self._on_measurement, self._diagnostics)
        self._rebuild()

    def _on_measurement(self, data: bytes) -> None:
        stamp_ns, (value, current) = self._reader.read(data)
        order = self._order.judge(stamp_ns)
        if order == "repeat":
            self._publisher.publish(self._answer)
            return
        if order == "late":
            self._diagnostics.count("late", f"samples on {MEASUREMENT} came late and were dropped")
            return
        if self._table.revision != self._revision:
            self._rebuild(stamp_ns)
            # the scheme may want another channel
            stamp_ns, (value, current) = self._reader.read(data)
        if order == "restart":
            self._diagnostics.report(
                "stamps",
                "warn",
                f"the stamp on {MEASUREMENT} jumped back: taken as a new recording of a cold device",
                stamp_ns=stamp_ns,
            )
            self._used_ns = None
            self._steps_ns.clear()
            if self._scheme is not None:
                self._scheme.restart()
        if self._scheme is not None and self._scheme.period_s:
            self._check_period(self._scheme.period_s, stamp_ns)
        self._order.accept(stamp_ns)
        self._answer = self._writer.write(stamp_ns, self._estimate(stamp_ns, value, current))
        self._publisher.publish(self._answer)
        self._count += 1
        if self._count % _BEAT_SAMPLES == 0:
            self._diagnostics.beat(stamp_ns)

    def _check_period(self, period_s: float, stamp_ns: int) -> None:
        """Tell when samples come at another period than the one the model's dynamics hold for."""
        if self._order.last_ns is None:
            return
        found = (stamp_ns - self._order.last_ns) * 1e-9
        if abs(found - period_s) <= _JITTER * period_s:
            self._off_period = 0
            if self._diagnostics.level("period") != "ok":
                self._diagnostics.report("period", "ok", f"{period_s:g} s, as the model", stamp_ns=stamp_ns)
            return
        self._off_period += 1
        if self._off_period == _OFF_PERIOD_SAMPLES:
            self._diagnostics.report(
                "period",
                "warn",
                f"samples come every {found:.4g} s, the dynamics of the model hold for {period_s:g} s: identify at this "
                "rate, or choose kind composite",
                stamp_ns=stamp_ns,
            )

    def _estimate(self, stamp_ns: int, value: float, current: float) -> tuple[float, ...]:
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
        if self._check is not None and (fault := self._check.fault(stamp_ns * 1e-9, value, current)):
            if self._diagnostics.level("input") == "ok":
                self._diagnostics.report(
                    "input",
                    "error",
                    f"{RESISTANCE} on {MEASUREMENT}: {fault}; the estimate is NaN until the reading changes",
                    stamp_ns=stamp_ns,
                )
            return (_NAN,) * len(scheme.channels)
        if self._diagnostics.level("input") != "ok":
            self._diagnostics.report("input", "ok", f"{scheme.input_channel} is back", stamp_ns=stamp_ns)
        self._bridge(scheme, stamp_ns)
        values = scheme.step(value)
        if scheme.known and self._diagnostics.level("memory") != "ok":
            self._diagnostics.report(
                "memory", "ok", "known again: an end of the major loop erased it", stamp_ns=stamp_ns
            )
        return values

    def _bridge(self, scheme: Scheme, stamp_ns: int) -> None:
        """Let the scheme know of samples that are missing since the last one that it has used."""
        used_ns, self._used_ns = self._used_ns, stamp_ns
        if used_ns is None:
            return
        step_ns = stamp_ns - used_ns
        scheme.pass_time(1e-9 * step_ns)
        # a clock of wall time jitters: after a late sample the next one comes early
        self._steps_ns.append(step_ns)
        if (
            step_ns <= _GAP * median_low(self._steps_ns)
            or 1e-9 * step_ns <= _STILL * self._device.time_constant
        ):
            return
        scheme.bridge()
        if scheme.known:
            self._diagnostics.count(
                "gaps",
                f"samples on {MEASUREMENT} were lost: what the drive did meanwhile is not in the estimate",
                stamp_ns=stamp_ns,
            )
        else:
            self._diagnostics.report(
                "memory",
                "warn",
                f"samples on {MEASUREMENT} were lost: {TIP_DEFLECTION}_bound holds for any excursion meanwhile",
                stamp_ns=stamp_ns,
            )

    def _rebuild(self, stamp_ns: int | None = None) -> None:
        """Take over changed parameters; the memory starts at the cold device, where every recording starts."""
        self._revision = self._table.revision
        given = self._table.given("model.")
        kind = self._table.text("kind")
        self._scheme, self._check = None, None
        if not given:
            self._diagnostics.report("model", "warn", _NO_MODEL, stamp_ns=stamp_ns)
            return
        try:
            self._device = self._device_of(given)
            self._scheme = make_scheme(
                kind, self._table.text("drive_channel"), given, self._device.resistance_range
            )
            self._check = self._make_check(given)
        except ValueError as error:
            self._scheme = None
            self._diagnostics.report("model", "error", f"{error}; every estimate is NaN", stamp_ns=stamp_ns)
            return
        self._reader = SampleReader((self._scheme.input_channel, HEATER_CURRENT))
        self._writer = SampleWriter(self._scheme.channels, self._table.text("preset"))
        note = self._scheme.note
        self._diagnostics.report(
            "model",
            "warn" if note else "ok",
            f"{kind} scheme at work{note and ': '}{note}",
            stamp_ns=stamp_ns,
        )

    def _device_of(self, given: Mapping[str, Value]) -> DeviceDescription:
        """Return the device of the model, which need not be told by `preset` too; without one that of `preset`.

        Raises
        ------
        ValueError : `preset` is set, to another device.
        """
        own, preset = str(given.get("model.device") or ""), self._table.text("preset")
        # what it is by default cannot be told from what was set to the same
        if own and "preset" in self._table.given():
            check_model_of(own, preset)
        return description(own or preset)

    def _make_check(self, given: Mapping[str, Value]) -> ResistanceCheck | None:
        """Return the check of the sensor, None where it is off or where the scheme does not use the resistance."""
        table = self._table
        if self._scheme is None or self._scheme.input_channel != RESISTANCE or not table.flag("sensor.check"):
            return None
        low, high = table.number("sensor.lower_ohm"), table.number("sensor.upper_ohm")
        return ResistanceCheck(sensor_limits(self._device.key, given, lower_ohm=low, upper_ohm=high))


main = node_main(EstimatorNode)

if __name__ == "__main__":
    sys.exit(main())
