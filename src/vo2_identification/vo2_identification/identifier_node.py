"""`identifier`: excites the device through the running graph, records, fits, and hands the model on.

Started and cancelled by service or by action; progress goes to `/diagnostics` and to the action's client. The fitted
model becomes the node's own `model.*` parameters, is set on the nodes named in `targets`, and is saved as a parameter
file. `~/diagnose` compares the last recording with the present model and tells what the model leaves out.
"""

from __future__ import annotations

import math
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.client import Client
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.emergency_stop import EmergencyStop
from vo2_interface.executable import node_main
from vo2_interface.inputs import SampleInput
from vo2_interface.lockstep import StampOrder
from vo2_interface.managed import AUTOSTART, ManagedNode
from vo2_interface.model import model_parameters, operating_point
from vo2_interface.parameters import ParameterTable, ros_parameters
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.timers import create_steady_timer
from vo2_interface.topics import (
    COMMAND,
    COMMAND_CHANNELS,
    DEFAULT_NAMESPACE,
    MEASUREMENT,
    SAMPLE_QOS,
)
from vo2_models.device.description import check_model_of
from vo2_models.identification.digest import DIGEST_PARAMETERS
from vo2_models.identification.drive_fit import HOLD_OUT
from vo2_models.model_file import save_model_parameters
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording

from vo2_identification.diagnosis_job import DiagnosisJob, summary_values
from vo2_identification.excitation_plan import EXCITATION_PARAMETERS, excitation_currents
from vo2_identification.sample_log import SampleLog
from vo2_identification.work_action import WorkAction

__all__ = ["IDENTIFIER_PARAMETERS", "IdentifierNode", "main"]

IDENTIFIER_PARAMETERS = (
    Parameter(
        "preset",
        "integrated",
        "",
        "Device: integrated, peltier, peltier_chapter8, or the path of a device file.",
    ),
    Parameter("rate_hz", 0.0, "Hz", "Sampling rate; 0 for the preset's.", 0.0, 20e3),
    AUTOSTART,
    *EXCITATION_PARAMETERS,
    Parameter("fit", True, "", "Fit after recording; off, the excitation is only played."),
    Parameter(
        "drive_channel",
        "",
        "",
        "For a device that no preset describes: the channel its laws are fitted over, such as heater_voltage.",
    ),
    Parameter(
        "drive_hold_out", "none", "", "Samples that fit does not see, for a later check.", choices=HOLD_OUT
    ),
    Parameter("drive_plays", 6, "1", "Plays of each of its laws.", 1, 100),
    Parameter("drive_per_play", False, "", "Whether each of its plays has envelopes of its own."),
    Parameter("targets", ["estimator"], "", "Nodes that get the fitted model."),
    Parameter("model_file", "", "", "Where the fitted model is saved; empty for nowhere."),
    Parameter("quiet_s", 2.0, "s", "Listening ends after this much wall time without a sample.", 0.1, 1e4),
)
_CHANNELS = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE, "heater_voltage")
_AT_REST = ("idle", "done", "failed", "cancelled")
_POLL_S = 0.05
_SERVICE_TIMEOUT_S = 15.0
_ASK_AGAIN_S = 3.0


@dataclass
class _Fit:
    """A fit at work in its own thread, and what came out."""

    recording: Recording
    thread: threading.Thread | None = None
    model: dict[str, Value] = field(default_factory=dict)
    error: str = ""
    started_s: float = 0.0


@dataclass
class _Target:
    """A node that is to get the model: what is asked of it, when it was asked last, until when it may answer."""

    client: Client
    request: SetParametersAtomically.Request
    deadline_s: float
    answer: Future | None = None
    asked_s: float = -math.inf

    def ask(self) -> None:
        """Ask once the service is there, and again if no answer comes: early in its life a link may lose one."""
        now = time.monotonic()
        if now - self.asked_s > _ASK_AGAIN_S and self.client.service_is_ready():
            self.answer, self.asked_s = self.client.call_async(self.request), now


class IdentifierNode(ManagedNode):
    """Services and samples in, commands and a model out."""

    def __init__(self) -> None:
        super().__init__("identifier", namespace=DEFAULT_NAMESPACE)
        records = (*IDENTIFIER_PARAMETERS, *model_parameters(), *DIGEST_PARAMETERS)
        self._table = ParameterTable(
            self, records, read_only=("preset", "rate_hz", "autostart"), judge=self._judge
        )
        self._preset = self._table.text("preset")
        self._judge(self._table.given())
        point = operating_point(self._preset)
        self._period_s, self._safe_a = 1.0 / (self._table.number("rate_hz") or point.rate_hz), point.safe_a
        self._diagnostics = Diagnostics(self, hardware_id=self._preset)
        self._state, self._said = "idle", ""
        self._currents: NDArray[np.float64] = np.empty(0)
        self._log = SampleLog(_CHANNELS)
        self._last_recording: Recording | None = None
        self._fit: _Fit | None = None
        self._diagnosis: DiagnosisJob | None = None
        self._pending: dict[str, _Target] = {}
        self._order = StampOrder()
        self._answer = b""
        self._device = ""
        self._heard_s = 0.0
        self._told_percent = -1
        self._reader = SampleReader(_CHANNELS)
        self._writer = SampleWriter(COMMAND_CHANNELS, self._preset)
        self._publisher = self.create_publisher(JointState, COMMAND, SAMPLE_QOS)
        self._diagnostics.watch_listeners(self._publisher)
        self._stop = EmergencyStop(self, self._diagnostics)
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self.create_service(Trigger, "~/diagnose", self._on_diagnose)
        self._identify_action = WorkAction(
            self, "Identify", "identify", start=self._begin, cancel=self._cancel_work
        )
        self._diagnose_action = WorkAction(
            self, "Diagnose", "diagnose", start=self._begin_diagnosis, cancel=self._cancel_diagnosis
        )
        self._manage(self._diagnostics, autostart=self._table.flag("autostart"))
        SampleInput(self, MEASUREMENT, self._guarded(self._on_measurement), self._diagnostics)
        create_steady_timer(self, _POLL_S, self._guarded(self._on_poll))

    def _judge(self, values: Mapping[str, Value]) -> None:
        """Refuse a model of another device."""
        if device := values.get("model.device"):
            check_model_of(str(device), self._preset)

    # --- life cycle ---------------------------------------------------------------------------------

    def _configure(self) -> None:
        """Nothing is built before an excitation is asked for."""

    def _activate(self) -> None:
        self._tell("idle", "ready; call ~/start")

    def _rest(self) -> None:
        """Leave a device that is being excited at the safe current, and give up what is at work."""
        if self._state == "exciting":
            self.rest()
        self._give_up()

    def destroy_node(self) -> None:
        """Leave the graph, actions first."""
        for action in (self._identify_action, self._diagnose_action):
            action.destroy()
        super().destroy_node()

    # --- for whoever composes this node into a process of its own -----------------------------------

    @property
    def state(self) -> str:
        """What it is at: idle, listening, exciting, fitting, publishing, done, failed or cancelled."""
        return self._state

    @property
    def last_words(self) -> str:
        """What it told last of its state."""
        return self._said

    @property
    def share_played(self) -> float:
        """Share of the excitation that was answered, 0 to 1."""
        return min(1.0, len(self._log) / max(self._currents.size, 1))

    def stop(self) -> None:
        """End an excitation with the sample that comes next; what was recorded until then counts."""
        if self._state == "exciting":
            self._currents = self._currents[: len(self._log)]

    def rest(self) -> None:
        """Answer the newest sample of an excitation with the safe current: one that has ended leaves it open."""
        if self._order.last_ns is not None:
            self._publisher.publish(self._writer.write(self._order.last_ns, (self._safe_a,)))

    # --- services ---------------------------------------------------------------------------------

    def _on_start(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._begin()
        return response

    def _begin(self) -> tuple[bool, str]:
        """Begin to excite or to listen; return whether that began, and what begins or why not."""
        if not self.active:
            return False, f"{self.lifecycle_state}: activate the node first"
        if self._state not in _AT_REST:
            return False, f"busy ({self._state}); call ~/cancel first"
        if self._stop.active:
            return False, "emergency stop is active; release it first"
        try:
            self._currents = excitation_currents(self._preset, self._period_s, self._table)
        except ValueError as error:
            return False, str(error)
        self._log = SampleLog(_CHANNELS)
        self._order = StampOrder()
        self._heard_s = math.inf
        self._told_percent = -1
        kind = self._table.text("excitation.kind")
        self._tell(
            "listening" if kind == "listen" else "exciting", f"{kind} of {self._currents.size} samples"
        )
        return True, f"{kind}: {self._currents.size} samples, {self._currents.size * self._period_s:g} s"

    def _on_cancel(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        ended = self._give_up()
        response.success = bool(ended)
        response.message = ended or f"nothing to cancel ({self._state})"
        return response

    def _give_up(self) -> str:
        """Cancel what is at work; return what that was in words, empty for nothing."""
        ended = [each for each in (self._cancel_work(), self._cancel_diagnosis()) if each]
        return f"cancelled while {' and '.join(ended)}" if ended else ""

    def _cancel_work(self) -> str:
        """Give up excitation, fit and what follows; return the state that was left, empty for none."""
        state = self._state
        if state not in ("exciting", "listening", "fitting", "publishing"):
            return ""
        self._fit = None
        self._pending.clear()
        self._tell("cancelled", f"cancelled while {state}")
        return state

    def _cancel_diagnosis(self) -> str:
        """Give up a diagnosis; return what was left, empty for none."""
        if self._diagnosis is None:
            return ""
        self._diagnosis.cancel()
        self._diagnosis = None
        self._tell_diagnosis("cancelled", "cancelled")
        return "diagnosing"

    def _on_diagnose(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._begin_diagnosis()
        return response

    def _begin_diagnosis(self) -> tuple[bool, str]:
        """Begin to diagnose the last recording; return whether that began, and what begins or why not."""
        if not self.active:
            return False, f"{self.lifecycle_state}: activate the node first"
        if self._diagnosis is not None:
            return False, f"busy: {self._diagnosis.text}; its answer comes on /diagnostics"
        if self._state not in _AT_REST:
            return False, f"busy ({self._state}); wait for its end or call ~/cancel first"
        if self._last_recording is None:
            return False, "found no recording, need one: call ~/start (excitation.kind informative, fit off)"
        model = self._table.given("model.")
        if not model:
            return False, "found no model, need one: identify with fit on, or load a file that fit wrote"
        self._diagnosis = DiagnosisJob(self._last_recording, model)
        words = f"diagnosing {len(self._last_recording)} samples; the answer comes on /diagnostics"
        self._tell_diagnosis("running", words)
        return True, words

    # --- samples ----------------------------------------------------------------------------------

    def _on_measurement(self, data: bytes) -> None:
        if self._state not in ("exciting", "listening"):
            return
        stamp_ns, values = self._reader.read(data)
        order = self._order.judge(stamp_ns)
        if order == "repeat":
            if self._answer:
                self._publisher.publish(self._answer)
            return
        if order == "late":
            self._diagnostics.count("late", f"samples on {MEASUREMENT} came late and were dropped")
            return
        if order == "restart":
            self._tell(
                "failed",
                "the stamp jumped back while recording: was the plant or the bag restarted? start again",
            )
            return
        self._order.accept(stamp_ns)
        self._heard_s = time.monotonic()
        self._device = self._reader.device
        if self._state == "listening":
            self._log.append(stamp_ns, values)
            return
        if self._stop.active:
            self._publisher.publish(self._writer.write(stamp_ns, (self._safe_a,)))
            self._tell("failed", "emergency stop; release it, then call ~/start again")
            return
        if not math.isfinite(values[0]):
            self._tell(
                "failed",
                f"{HEATER_CURRENT} on {MEASUREMENT} is absent or not finite: nothing can be identified",
            )
            return
        k = len(self._log)
        if k == self._currents.size:
            self._log.append(stamp_ns, values)
            self._finish_recording()
            return
        current = float(self._currents[k])
        self._log.append(stamp_ns, values, current)
        self._answer = self._writer.write(stamp_ns, (current,))
        self._publisher.publish(self._answer)
        percent = 100 * (k + 1) // self._currents.size
        if percent >= self._told_percent + 5:
            self._told_percent = percent
            self._tell(
                "exciting", f"{k + 1} of {self._currents.size} samples", percent=percent, stamp_ns=stamp_ns
            )

    def _finish_recording(self) -> None:
        self._answer = b""
        try:
            recording = self._log.recording(self._device or self._preset)
        except ValueError as error:
            self._tell("failed", str(error))
            return
        self._last_recording = recording
        if not self._table.flag("fit"):
            self._tell("done", f"recorded {len(recording)} samples", percent=100)
            return
        self._fit = _Fit(recording, started_s=time.monotonic())
        self._fit.thread = threading.Thread(target=_run_fit, args=(self._fit, self._fitting()), daemon=True)
        self._tell("fitting", f"fitting {len(recording)} samples")
        self._fit.thread.start()

    def _fitting(self) -> Callable[[Recording], Mapping[str, Value]]:
        """Return the fit that the parameters ask for; its modules load when it runs."""
        table, preset = self._table, self._preset
        drive, hold_out = table.text("drive_channel"), table.text("drive_hold_out")
        plays, per_play = int(table.number("drive_plays")), table.flag("drive_per_play")

        def fit(recording: Recording) -> Mapping[str, Value]:
            if drive:
                from vo2_models.identification.drive_fit import fit_drive

                return fit_drive(recording, drive, hold_out=hold_out, plays=plays, per_play=per_play)  # type: ignore[arg-type]
            from vo2_models.identification.device_fit import PLAYS
            from vo2_models.identification.model_fit import fit_model

            return fit_model([recording], preset, plays=PLAYS)[1]

        return fit

    # --- what follows the recording, polled -------------------------------------------------------

    def _on_poll(self) -> None:
        self._follow_diagnosis()
        if self._state == "listening" and time.monotonic() - self._heard_s > self._table.number("quiet_s"):
            self._finish_recording()
        elif self._state == "fitting" and self._fit and self._fit.thread and not self._fit.thread.is_alive():
            self._hand_on(self._fit)
        elif self._state == "publishing":
            self._check_targets()

    def _hand_on(self, fit: _Fit) -> None:
        if fit.error:
            self._tell("failed", fit.error)
            return
        try:
            # an array without elements has no type in ROS: it says nothing and stays unset
            model = {name: value for name, value in fit.model.items() if not _is_empty(value)}
            self._table.set(model)
            if self._table.text("model_file"):
                save_model_parameters(
                    self._table.text("model_file"),
                    fit.model,
                    comment="Identified by vo2_identification identifier.",
                )
        except (ValueError, OSError) as error:
            self._tell("failed", f"the fitted model cannot be kept: {error}")
            return
        seconds = time.monotonic() - fit.started_s
        self._tell("publishing", f"fitted in {seconds:.1f} s; handing the model on")
        request = SetParametersAtomically.Request()
        # what the calibration left over serves a diagnosis; the other nodes do not know it
        own = {record.name for record in DIGEST_PARAMETERS}
        shared = {name: value for name, value in model.items() if name not in own}
        request.parameters = [parameter.to_parameter_msg() for parameter in ros_parameters(shared)]
        for target in self._table["targets"]:  # type: ignore[union-attr]
            client = self.create_client(SetParametersAtomically, f"{target}/set_parameters_atomically")
            self._pending[str(target)] = _Target(client, request, time.monotonic() + _SERVICE_TIMEOUT_S)

    def _check_targets(self) -> None:
        for target, asked in list(self._pending.items()):
            asked.ask()
            if asked.answer is not None and asked.answer.done():
                result = asked.answer.result().result
                if not result.successful:
                    self._tell("failed", f"{target} refused the model: {result.reason}")
                    return
                del self._pending[target]
            elif time.monotonic() > asked.deadline_s:
                self._tell("failed", f"{target} does not answer: is this node running? (parameter targets)")
                return
        if not self._pending:
            self._tell("done", "model identified, published and set", percent=100)

    def _follow_diagnosis(self) -> None:
        """Tell progress in steps of 5 %, and the answer."""
        job = self._diagnosis
        if job is None:
            return
        if job.running:
            self._tell_diagnosis("running", job.text, {"percent": 5 * int(20 * job.share)})
            return
        self._diagnosis = None
        if job.answer is None:
            self._tell_diagnosis("failed", job.error)
            return
        answer = job.answer
        self._tell_diagnosis("done", answer.summary, summary_values(answer))
        self._diagnose_action.end(
            True,
            message=answer.summary,
            verdict=answer.verdict,
            effects=[each.id for each in answer.effects],
            probabilities=[each.probability for each in answer.effects],
        )

    def _tell_diagnosis(self, state: str, text: str, values: Mapping[str, object] | None = None) -> None:
        level = "error" if state == "failed" else "ok"
        told = {"state": state, **(values or {})}
        self._diagnostics.report("diagnosis", level, text, told)
        if state == "running":
            self._diagnose_action.publish_feedback(text=text, percent=told.get("percent", 0))
        elif state != "done":
            self._diagnose_action.end(False, message=text)

    def _tell(self, state: str, text: str, *, percent: int = 0, stamp_ns: int | None = None) -> None:
        self._state, self._said = state, text
        level = "error" if state == "failed" else "ok"
        values: dict[str, object] = {"state": state, "percent": percent}
        if state == "done" and self._last_recording is not None:
            time_s = self._last_recording.time_s
            values |= {"first_stamp_s": f"{time_s[0]:.9f}", "last_stamp_s": f"{time_s[-1]:.9f}"}
        self._diagnostics.report("progress", level, text, values, stamp_ns=stamp_ns)
        if state in _AT_REST:
            kept = self._table.text("model_file") if state == "done" and self._table.flag("fit") else ""
            self._identify_action.end(state == "done", message=text, model_file=kept)
        else:
            self._identify_action.publish_feedback(state=state, text=text, percent=percent)


def _is_empty(value: Value) -> bool:
    return isinstance(value, list) and not value


def _run_fit(fit: _Fit, fitting: Callable[[Recording], Mapping[str, Value]]) -> None:
    try:
        fit.model = dict(fitting(fit.recording))
    except ValueError as error:
        fit.error = f"the recording cannot be fitted: {error}"
    except Exception as error:  # a thread has nobody above it: what it dies of must reach the operator
        traceback.print_exc()
        fit.error = f"the fit broke down: {error!r}; the log has the traceback"


main = node_main(IdentifierNode)

if __name__ == "__main__":
    sys.exit(main())
