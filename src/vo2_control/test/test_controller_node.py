"""The controller as a node: answers in lockstep, safe current on lost input, bumpless return, redesign."""

import itertools
import math
import time
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import Trigger
from vo2_control.controller_node import ControllerNode
from vo2_control.designs import check_device_limits, design_feedforward, reach
from vo2_control.reference_node import ReferenceNode
from vo2_interface.model import operating_point
from vo2_interface.parameters import ros_parameters
from vo2_interface.testing import bench

from vo2_control import command_node

MS = 1_000_000
UM = 1e-6
START_MS = 2000
POINT = operating_point("integrated")


def controller(*parameters):
    arguments = ["--ros-args"]
    for parameter in parameters:
        arguments += ["-p", parameter]
    return bench(arguments)


def estimate(deflection, surrogate=0.006):
    return {"tip_deflection": deflection, "temperature_surrogate": surrogate, "tip_deflection_bound": 1e-6}


def command_of(rig, k, deflection, reference=30 * UM):
    """Say estimate and reference of sample k and return the command that answers."""
    return command_at(rig, k * MS, deflection, reference)


def command_at(rig, stamp_ns, deflection, reference=30 * UM):
    """Say estimate and reference of a stamp and return the command that answers."""
    rig.say("/vo2/estimate", stamp_ns, estimate(deflection))
    rig.say("/vo2/reference", stamp_ns, {"tip_deflection": reference})
    rig.until(lambda: any(stamp == stamp_ns for stamp, _ in rig.heard["/vo2/command"]))
    return next(values[0] for stamp, values in rig.heard["/vo2/command"] if stamp == stamp_ns)


def after_listening(rig, period_ms=50):
    """Wall time: let the node listen for other commanders; samples go on from a stamp of START_MS."""
    rig.say("/vo2/estimate", MS, estimate(30 * UM))
    rig.spin(max(0.5, 6e-3 * period_ms) + 0.05)


def paced_command(rig, k, deflection, reference=30 * UM, period_ms=50):
    """Wall time: the same on a plant that follows, so that the loop closes."""
    commands = rig.heard["/vo2/command"]
    flowing = commands[-1][1][0] if commands else 0.0
    stamp_ms = START_MS + k * period_ms
    rig.say("/vo2/measurement", stamp_ms * MS, {"heater_current": flowing})
    return command_of(rig, stamp_ms, deflection, reference)


def test_samples_at_another_rate_than_the_nodes_are_told_and_taken_back():
    with controller("rate_hz:=1000.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        for k in range(40):
            command_at(rig, 4 * k * MS, 30 * UM)
        rig.until(lambda: "come at 250 Hz, this node runs at 1000 Hz" in rig.status("controller: rate")[0])
        for k in range(160, 240):
            command_at(rig, k * MS, 30 * UM)
        rig.until(lambda: "come at the rate of this node" in rig.status("controller: rate")[0])


def test_a_command_waits_for_the_reference_of_its_stamp():
    with controller() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        rig.say("/vo2/reference", 0, {"tip_deflection": 30 * UM})
        rig.say("/vo2/estimate", MS, estimate(20 * UM))
        rig.spin(0.3)
        assert rig.heard["/vo2/command"] == []
        rig.say("/vo2/reference", MS, {"tip_deflection": 30 * UM})
        rig.until(lambda: [stamp for stamp, _ in rig.heard["/vo2/command"]] == [MS])


def test_it_starts_without_a_bump_from_the_current_that_holds_the_temperature():
    with controller() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        assert command_of(rig, 1, 30 * UM, 30 * UM) == pytest.approx(0.006, abs=1e-6)


def test_lost_input_holds_three_samples_then_safe_current_then_a_return_without_a_bump():
    with controller() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        last = [command_of(rig, k, 29 * UM) for k in range(1, 4)][-1]
        held = [command_of(rig, k, math.nan) for k in range(4, 9)]
        assert held == [last, last, last, 0.0, 0.0]
        text = rig.status("controller: input")[0]
        rig.until(lambda: rig.status("controller: input")[0].endswith("safe current 0 A"))
        assert rig.status("controller: input")[0].startswith("tip_deflection on estimate is nan")
        back = command_of(rig, 9, 30 * UM)
        # as near to the safe current as the operating range allows
        assert back == pytest.approx(POINT.lower_a, abs=1e-6), text
        rig.until(lambda: "closed" in rig.status("controller: input")[0])


def test_the_safe_current_is_that_of_the_device_file(tmp_path):
    device = tmp_path / "warm.yaml"
    shipped = (files("vo2_models.device") / "files" / "integrated.yaml").read_text()
    device.write_text(shipped.replace("safe: 0.0", "safe: 2.0e-3").replace("id: integrated", "id: warm"))
    with controller(f"preset:={device}", "pid.kp:=1.4", "pid.ki:=2.03e4") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        assert [command_of(rig, k, math.nan) for k in range(1, 6)][-1] == 2.0e-3


def test_a_loop_on_a_force_closes_and_a_value_that_is_none_is_told_once_with_the_reason(tmp_path):
    device = tmp_path / "grip.yaml"
    device.write_text(
        "schema: vo2-device/1\nid: grip\ndrive: {channel: heater_current, unit: A, limits: [0.0, 12.0e-3]}\n"
        "body: {kind: first_order, ambient: 22.0, square_gain: 1.0e+6, time_constant: 5.0e-3}\n"
        "responses:\n  force: {unit: N, range: [0.0, 60.0]}\nsampling: {period: 1.0e-3}\n"
    )
    with controller(f"preset:={device}", "pid.kp:=1.0e-6", "pid.ki:=1.0e-3") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        closed = [command_of(rig, k, 20.0, 30.0) for k in range(1, 5)]
        assert np.all(np.diff(closed) > 0)
        lost = [command_of(rig, k, 700.0 + k, 30.0) for k in range(5, 12)]
        assert lost == [closed[-1]] * 3 + [0.0] * 4
        rig.until(lambda: "estimate is beyond 600 N" in rig.status("controller: input")[0])
        assert node._diagnostics.level("input") == "error"
        with pytest.raises(ValueError, match=r"A/N at once.*0\.06 N of noise"):
            check_device_limits(str(device), 1e-3, {"pid.kp": 1.0})


def test_wall_time_an_estimator_that_stops_leads_to_the_safe_current():
    # slow: on a busy machine a sample of this process may be a tenth of a second late
    with controller("time:=wall", "rate_hz:=4.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        after_listening(rig, 250)
        last = [paced_command(rig, k, 29 * UM, period_ms=250) for k in range(1, 6)][-1]
        assert last > POINT.lower_a
        rig.until(lambda: rig.heard["/vo2/command"][-1][1][0] == 0.0)
        stamps, values = zip(*rig.heard["/vo2/command"], strict=True)
        answered_ns = (START_MS + 5 * 250) * MS
        first = stamps.index(answered_ns) + 1
        after = [value[0] for value in values[first:]]
        held = after.index(0.0)
        assert 2 <= held <= 4
        assert set(after[:held]) == {last}
        # the plant counts from the sample that led to the current, however late this node is
        assert set(stamps[first : first + held]) == {answered_ns} and stamps[first + held] > answered_ns
        rig.until(lambda: "nothing on estimate" in rig.status("controller: input")[0])


def test_wall_time_a_reference_that_stops_is_told_as_that_and_nothing_else():
    with controller("time:=wall", "rate_hz:=4.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        after_listening(rig, 250)
        for k in range(1, 4):
            paced_command(rig, k, 29 * UM, period_ms=250)
        said = len(rig.statuses)
        for k in range(4, 12):
            rig.say("/vo2/estimate", (START_MS + k * 250) * MS, estimate(29 * UM))
            rig.spin(0.4 if k % 2 else 0.1)  # uneven, as from a busy process: a period may bring no sample
        missing = {
            text.split(":")[0] for name, text, _ in rig.statuses[said:] if name.endswith("controller: input")
        }
        assert missing == {"nothing on reference"}


@pytest.mark.parametrize("phase", [0.0, 0.55, 0.8])
def test_wall_time_the_safe_current_arrives_before_the_plant_would_hold_a_fourth_sample(phase, monkeypatch):
    """By a clock of its own, and so slow that the node's timer keeps out of it; the plant's next sample is the fifth."""
    now = [0.0]
    monkeypatch.setattr(command_node, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with controller("time:=wall", "rate_hz:=0.01") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        after_listening(rig)
        for k in range(10, 16):
            now[0] = 100.0 * k
            last = paced_command(rig, k, 29 * UM, period_ms=100_000)
        assert last > POINT.lower_a
        before = len(rig.heard["/vo2/command"])
        for periods in np.arange(1.0, 4.75 - phase):
            now[0] = 100.0 * (15 + periods + phase)
            node._on_tick()
        rig.until(lambda: rig.heard["/vo2/command"][-1][1][0] == 0.0)
        told = [values[0] for _, values in rig.heard["/vo2/command"][before:]]
        assert set(told[:-1]) == {last}


def test_a_set_point_by_hand_holds_until_the_next():
    with controller("reference_hold:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        rig.say("/vo2/reference", 0, {"tip_deflection": 30 * UM})
        rig.spin(0.2)
        for k in (1, 2, 3):
            rig.say("/vo2/estimate", k * MS, estimate(25 * UM))
        rig.until(lambda: len(rig.heard["/vo2/command"]) == 3)


def test_redesign_takes_over_gains_and_refuses_what_makes_no_controller():
    with controller() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        redesign = redesigner(rig)
        node._table.set({"pid.kp": 2.0, "pid.ki": 100.0})
        assert redesign().success
        node._table.set({"limits.lower_a": 0.008, "limits.upper_a": 0.004})
        answer = redesign()
        assert not answer.success
        assert "limits: found lower 0.008 A" in answer.message


def redesigner(rig):
    client = rig.node.create_client(Trigger, "/vo2/controller/redesign")
    rig.until(client.service_is_ready)

    def redesign():
        future = client.call_async(Trigger.Request())
        rig.until(future.done, timeout_s=90.0)  # a synthesis takes seconds of a processor
        return future.result()

    return redesign


def test_robust_design_commands_and_a_refused_one_leaves_the_former_at_work():
    with controller("preset:=peltier", "kind:=hinf") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        redesign = redesigner(rig)
        warmer = [command_of(rig, 125 * k, 25 * UM, 30 * UM) for k in range(1, 6)]
        # negative current heats this device: a deflection below its reference asks for less current
        assert warmer[-1] < warmer[0]
        running = node._law
        for k, (values, reason) in enumerate(
            (
                ({"hinf.current_gain_k_per_a": 50.0}, "need the sign - of this device"),
                ({"hinf.current_gain_k_per_a": -50.0, "hinf.performance.gain": 100.0}, "need at most 1"),
            ),
            6,
        ):
            node._table.set(values)
            answer = redesign()
            assert not answer.success and reason in answer.message
            rig.until(lambda reason=reason: reason in rig.status("controller: design")[0])
            command_of(rig, 125 * k, 25 * UM, 30 * UM)
            assert node._law is running
        node._table.set({"hinf.performance.gain": 0.05})
        assert redesign().success
        command_of(rig, 125 * 99, 25 * UM, 30 * UM)
        assert node._law is not running


def test_robust_design_for_the_wrong_device_is_refused_at_the_start():
    with controller("kind:=hinf") as rig, pytest.raises(ValueError, match=r"need the sign \+ of this device"):
        rig.add(ControllerNode)


@pytest.mark.slow
def test_robust_design_from_the_model_and_a_model_without_dynamics_leaves_it_at_work(fitted_model):
    """What is asked over the service: a law for this model; for a model without dynamics one line, and the former law stays."""
    with controller("kind:=pi") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        redesign = redesigner(rig)
        node._table.set({**fitted_model, "kind": "hinf"})
        assert redesign().success
        first = command_of(rig, 1, 29 * UM, 30 * UM)
        assert command_of(rig, 2, 29 * UM, 30 * UM) > first  # an integrator asks for more
        running = node._law
        assert running.law.coordinate == "heating_power" and running.law.order >= 1
        node._table.set({"model.thermal.time_constant": 1e-6, "model.driver.dead_time": 0.0})
        answer = redesign()
        assert not answer.success and answer.message.count("\n") == 0
        assert "model.thermal.time_constant: found 1e-06 s" in answer.message
        assert "without dynamics" in answer.message and "the former law stays" in answer.message
        command_of(rig, 3, 29 * UM, 30 * UM)
        assert node._law is running


def test_feedforward_is_added_and_changes_with_the_reference(fitted_model):
    """Gains of 0 leave the feedforward alone, shifted by what made the start bumpless."""
    steps = [30 * UM] * 3 + [36 * UM] * 3 + [26 * UM] * 3
    with controller("feedforward:=true", "pid.kp:=1e-9", "pid.ki:=1e-9") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        assert node.set_parameters_atomically(ros_parameters(fitted_model)).successful
        got = [command_of(rig, k, 30 * UM, reference) for k, reference in enumerate(steps, 1)]
        ahead = design_feedforward(preset="integrated", sample_period_s=1e-3, values=fitted_model)
        alone = ahead.run([30 * UM] * 12 + steps)[0][12:]
        assert got[0] == pytest.approx(0.006, abs=1e-6)
        assert got == pytest.approx(list(alone + got[0] - alone[0]), abs=2e-6)


def test_feedforward_without_model_is_told_and_feedback_goes_on():
    with controller("feedforward:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        command_of(rig, 1, 29 * UM)
        assert command_of(rig, 9, 29 * UM) > POINT.lower_a
        node._diagnostics.beat()
        rig.until(lambda: "feedback alone" in rig.status("controller: feedforward")[0])
        assert "model.device: found none" in rig.status("controller: feedforward")[0]


def test_a_redesign_while_running_makes_no_bump(fitted_model):
    with controller() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        before = [command_of(rig, k, 30 * UM, 30 * UM) for k in range(1, 4)][-1]
        gains = {"pid.kp": 3.0, "pid.ki": 100.0, "feedforward": True}
        assert node.set_parameters_atomically(ros_parameters({**fitted_model, **gains})).successful
        after = [command_of(rig, k, 30 * UM, 30 * UM) for k in range(4, 12)]
        assert after == pytest.approx([before] * 8, abs=2e-6)


def test_a_set_point_out_of_reach_of_the_model_is_clipped_and_told(fitted_model):
    ahead = design_feedforward(preset="integrated", sample_period_s=1e-3, values=fitted_model)
    with controller("pid.kp:=1.0", "pid.ki:=100.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        assert node.set_parameters_atomically(ros_parameters(fitted_model)).successful
        command_of(rig, 1, 30 * UM, 200 * UM)
        rig.until(lambda: f"{reach(ahead)[1] / UM:.2f} um" in rig.status("controller: reference")[0])
        command_of(rig, 2, 30 * UM, 30 * UM)
        rig.until(lambda: "reachable again" in rig.status("controller: reference")[0])


def answered(rig, stamp_ns):
    return any(stamp == stamp_ns for stamp, _ in reversed(rig.heard["/vo2/command"]))


def test_wall_time_goes_on_while_a_law_is_designed_and_takes_it_over(fitted_model):
    with controller("time:=wall", "rate_hz:=10.0", "reference_hold:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        former = node._law
        after_listening(rig, 100)
        rig.say("/vo2/reference", 0, {"tip_deflection": 30 * UM})
        assert node.set_parameters_atomically(ros_parameters(fitted_model)).successful
        answer = node._on_redesign(Trigger.Request(), Trigger.Response())
        assert answer.success and "beside the loop" in answer.message
        answered_before, deadline = 0, time.monotonic() + 300.0  # of a machine that does other work too
        for k in itertools.count(START_MS // 100):
            if node._law is not former or time.monotonic() > deadline:
                break
            rig.say("/vo2/estimate", 100 * k * MS, estimate(30 * UM))
            # as a plant would: on with the next sample if this one, stale after a stall of the machine, has no answer
            next_s = time.monotonic() + 0.1
            rig.until(lambda k=k, next_s=next_s: answered(rig, 100 * k * MS) or time.monotonic() > next_s)
            answered_before += node._law is former and answered(rig, 100 * k * MS)
        assert node._law is not former
        # tuning takes a second of a processor, an answer a thousandth: samples did not wait for it
        assert answered_before > 10
        rig.until(lambda: "designed anew" in rig.status("controller: design")[0])


def test_wall_time_a_design_that_is_refused_is_told(fitted_model):
    with controller("time:=wall", "rate_hz:=100.0") as rig:
        node = rig.add(ControllerNode)
        node._table.set({"pid.kp": 1.0, "pid.ki": -1.0})
        node._on_redesign(Trigger.Request(), Trigger.Response())
        # no sample comes: the clock's ticks look for the outcome
        rig.until(lambda: "need gains of one sign" in rig.status("controller: design")[0], 60.0)
        assert "the former law stays" in rig.status("controller: design")[0]


def test_reference_follows_measurement_stamps_and_starts_again_when_set_anew():
    with controller() as rig:
        rig.hear("/vo2/reference", ("tip_deflection",))
        node = rig.add(ReferenceNode)
        for k in (0, 999, 1000):
            rig.say("/vo2/measurement", 5_000 * MS + k * MS, {"heater_current": 0.0})
        rig.until(lambda: len(rig.heard["/vo2/reference"]) == 3)
        assert [round(values[0] / UM) for _, values in rig.heard["/vo2/reference"]] == [20, 20, 35]
        node._table.set({"signal": "sine"})
        rig.say("/vo2/measurement", 6_001 * MS, {"heater_current": 0.0})
        rig.say("/vo2/measurement", 8_501 * MS, {"heater_current": 0.0})
        rig.until(lambda: len(rig.heard["/vo2/reference"]) == 5)
        assert [values[0] / UM for _, values in rig.heard["/vo2/reference"][3:]] == pytest.approx(
            [30.0, 45.0]
        )


def test_a_reference_for_a_device_without_a_tip_response_begins(tmp_path):
    device = tmp_path / "film.yaml"
    device.write_text(
        "schema: vo2-device/1\nid: film\nbody: {kind: none}\nsampling: {period: 1.0e-3}\n"
        "drive: {channel: heater_current, unit: A, limits: [0.0, 1.0e-2], operating: [0.0, 1.0e-2]}\n"
        "responses:\n  film_resistance: {unit: ohm, range: [1.0e2, 1.0e5]}\n"
    )
    with controller(f"preset:={device}", "signal:=none") as rig:
        node = rig.add(ReferenceNode)
        node._table.set({"signal": "csv"})
        rig.say("/vo2/measurement", 1_000 * MS, {"heater_current": 0.0})
        rig.until(lambda: "csv.file: found no name" in rig.status("reference: signal")[0])


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"limits.upper_a": 10.0}, "limits.upper_a: found 10 A, need 0 to 0.01278 A"),
        ({"operating_a": -0.001}, "operating_a: found -0.001 A, need 0 to 0.01278 A"),
        ({"pid.kp": 1e7}, "pid.kp: found 1e.07, need at most 2.24e.05"),
        ({"pid.ki": -1e9}, "pid.ki: found -1e.09, need at most 2.24e.08"),
        ({"pid.kd": 1e4}, "pid.kd: found 10000, need at most 224"),
    ],
)
def test_parameters_beyond_what_the_device_bears_are_refused_where_they_are_set_and_at_the_start(
    values, reason
):
    with controller() as rig:
        node = rig.add(ControllerNode)
        before = node._table.given()
        with pytest.raises(ValueError, match=reason):
            node._table.set(values)
        assert node._table.given() == before
    name, value = next(iter(values.items()))
    with controller(f"{name}:={value!r}") as rig, pytest.raises(ValueError, match=reason):
        rig.add(ControllerNode)


def test_wall_time_samples_that_piled_up_are_not_answered_and_the_integrator_waits():
    """A second of estimates far below the set-point arrives at once: without the rule the current goes to its end."""
    with controller("time:=wall", "rate_hz:=20.0", "reference_hold:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        after_listening(rig)
        last = [paced_command(rig, k, 30 * UM) for k in range(1, 8)][-1]
        rig.spin(1.0)
        rig.heard["/vo2/command"].clear()
        for k in range(8, 28):
            rig.say("/vo2/estimate", (START_MS + 50 * k) * MS, estimate(2 * UM))
        rig.until(lambda: "older than 3 periods" in rig.status("controller: stale")[0])
        rig.spin(0.3)
        assert max(values[0] for _, values in rig.heard["/vo2/command"]) < last + 3e-4


def test_wall_time_the_loop_waits_for_a_plant_that_follows():
    """A busy machine may let it go to the safe current meanwhile, and begin again from the lower end."""
    with controller("time:=wall", "rate_hz:=10.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)

        def sample(measured_a):
            stamp = time.monotonic_ns()
            rig.say("/vo2/measurement", stamp, {"heater_current": measured_a})
            rig.say("/vo2/estimate", stamp, estimate(2 * UM))
            rig.say("/vo2/reference", stamp, {"tip_deflection": 30 * UM})
            rig.spin(0.1)
            return rig.heard["/vo2/command"][-1:]

        for _ in range(20):
            sample(0.0)
        found = {values[0] for _, values in rig.heard["/vo2/command"]}
        assert 0.006 in found
        assert found <= {0.006, POINT.lower_a, 0.0}, "no integral of the error"
        rig.until(lambda: "does not follow" in rig.status("controller: input")[0])
        rig.until(lambda: sample(0.006) and "loop is closed" in rig.status("controller: input")[0])


def test_wall_time_a_driver_that_does_not_obey_is_told_and_opens_the_loop():
    with controller("time:=wall", "rate_hz:=10.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)

        def sample(measured_a=None):
            stamp = time.monotonic_ns()
            commands = rig.heard["/vo2/command"]
            flowing = commands[-1][1][0] if commands else 0.0
            rig.say(
                "/vo2/measurement", stamp, {"heater_current": flowing if measured_a is None else measured_a}
            )
            rig.say("/vo2/estimate", stamp, estimate(30 * UM))
            rig.say("/vo2/reference", stamp, {"tip_deflection": 30 * UM})
            rig.spin(0.1)
            return rig.status("controller: input")[0]

        rig.until(lambda: "closed" in sample())
        rig.until(lambda: "the measured current is 0.012 A where" in sample(0.012))
        rig.until(lambda: "safe current" in sample(0.012) and rig.heard["/vo2/command"][-1][1][0] == 0.0)
        rig.until(lambda: "closed" in sample())


def test_wall_time_a_controller_that_is_switched_off_leaves_the_safe_current():
    with controller("time:=wall", "rate_hz:=20.0", "reference_hold:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        after_listening(rig)
        assert [paced_command(rig, k, 30 * UM) for k in range(1, 8)][-1] > 0.0
        node._table.set({"enabled": False})
        rig.until(lambda: rig.heard["/vo2/command"][-1][1][0] == 0.0)
        count = len(rig.heard["/vo2/command"])
        rig.spin(0.3)
        assert len(rig.heard["/vo2/command"]) == count


def test_a_reference_that_is_switched_off_needs_no_valid_levels():
    with controller() as rig:
        rig.hear("/vo2/reference", ("tip_deflection",))
        node = rig.add(ReferenceNode)
        rig.say("/vo2/measurement", 1_000 * MS, {"heater_current": 0.0})
        rig.until(lambda: len(rig.heard["/vo2/reference"]) == 1)
        node._table.set({"steps.levels_m": [1.0]})
        rig.say("/vo2/measurement", 1_001 * MS, {"heater_current": 0.0})
        rig.until(lambda: "steps.levels_m: found 1 m" in rig.status("reference: signal")[0])
        node._table.set({"signal": "none"})
        rig.say("/vo2/measurement", 1_002 * MS, {"heater_current": 0.0})
        rig.until(lambda: "follows none" in rig.status("reference: signal")[0])
        assert len(rig.heard["/vo2/reference"]) == 2


def test_wall_time_a_second_controller_stands_by_until_the_first_is_silent():
    """The other one commands all the time, as nodes do, and is found after the first samples.

    A command that names its sender is the controller's.
    """
    with controller("time:=wall", "rate_hz:=5.0") as rig:
        rig.hear("/vo2/command", ("heater_current", "commander"))
        rig.add(ControllerNode)

        def sample():
            stamp = time.monotonic_ns()
            rig.say("/vo2/estimate", stamp, estimate(30 * UM))
            rig.say("/vo2/reference", stamp, {"tip_deflection": 30 * UM})
            rig.spin(0.2)
            return [name for _, (_, name) in rig.heard["/vo2/command"] if not math.isnan(name)]

        assert not any(sample() for _ in range(2))
        other = rig.node.create_timer(0.02, lambda: rig.say("/vo2/command", MS, {"heater_current": 0.005}))
        assert not any(sample() for _ in range(15))
        assert "standing by" in rig.status("controller: input")[0]
        rig.node.destroy_timer(other)
        rig.until(sample)


def test_wall_time_of_two_controllers_that_begin_together_one_commands():
    with controller("time:=wall", "rate_hz:=5.0") as rig:
        rig.hear("/vo2/command", ("heater_current", "commander"))
        rig.add(ControllerNode)
        rig.add(ControllerNode)
        while len(rig.heard["/vo2/command"]) < 15:
            stamp = time.monotonic_ns()
            rig.say("/vo2/estimate", stamp, estimate(30 * UM), listeners=2)
            rig.say("/vo2/reference", stamp, {"tip_deflection": 30 * UM}, listeners=2)
            rig.spin(0.2)
        assert len({commander for _, (_, commander) in rig.heard["/vo2/command"][5:]}) == 1


def test_samples_that_stay_away_are_told_in_lockstep_too_and_taken_back():
    with controller() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        command_of(rig, 1, 29 * UM)
        rig.until(lambda: "nothing on estimate for 1 s" in rig.status("controller: bonds")[0])
        command_of(rig, 2, 29 * UM)
        rig.until(lambda: "arrive on every topic again" in rig.status("controller: bonds")[0])
