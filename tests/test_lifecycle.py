"""The managed life of the nodes that command, through the services that `ros2 lifecycle` calls."""

import time

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from std_srvs.srv import Trigger
from vo2_control.controller_node import ControllerNode
from vo2_control.feedforward_node import FeedforwardNode
from vo2_identification.identifier_node import IdentifierNode
from vo2_interface.testing import bench

MS = 1_000_000
UM = 1e-6


def managed(*parameters):
    arguments = ["--ros-args"]
    for parameter in parameters:
        arguments += ["-p", parameter]
    return bench(arguments)


def call(rig, kind, name, request):
    client = rig.node.create_client(kind, f"/vo2/{name}")
    rig.until(client.service_is_ready)
    rig.spin(0.1)
    answer = client.call_async(request)
    rig.until(answer.done)
    return answer.result()


def change(rig, node, label="", number=0):
    request = ChangeState.Request(transition=Transition(id=number, label=label))
    return call(rig, ChangeState, f"{node}/change_state", request).success


def state(rig, node):
    return call(rig, GetState, f"{node}/get_state", GetState.Request()).current_state.label


def sample(rig, k, seconds=0.05):
    """Say an estimate with its set-point."""
    values = {"tip_deflection": 29 * UM, "temperature_surrogate": 0.006, "tip_deflection_bound": UM}
    rig.say("/vo2/estimate", k * MS, values)
    rig.say("/vo2/reference", k * MS, {"tip_deflection": 30 * UM})
    rig.spin(seconds)
    return [stamp // MS for stamp, _ in rig.heard["/vo2/command"]]


def paced(rig):
    """Wall time: a sample of this moment, on a plant that follows, so that the loop closes."""
    commands = rig.heard["/vo2/command"]
    now = time.monotonic_ns() // MS
    rig.say("/vo2/measurement", now * MS, {"heater_current": commands[-1][1][0] if commands else 0.0})
    return sample(rig, now)


def until_it_commands(rig):
    began = time.monotonic()
    while not rig.heard["/vo2/command"] or rig.heard["/vo2/command"][-1][1][0] == 0.0:
        assert time.monotonic() - began < 20.0, rig.status("controller: input")
        paced(rig)


@pytest.mark.parametrize("kind", [ControllerNode, FeedforwardNode, IdentifierNode])
def test_the_whole_life_by_services(kind):
    with managed("autostart:=false") as rig:
        name = rig.add(kind).get_name()
        assert state(rig, name) == "unconfigured"
        life = [
            ("configure", "inactive"),
            ("activate", "active"),
            ("deactivate", "inactive"),
            ("cleanup", "unconfigured"),
            ("configure", "inactive"),
            ("activate", "active"),
            ("shutdown", "finalized"),
        ]
        for label, then in life:
            assert change(rig, name, label), label
            assert state(rig, name) == then


def test_today_s_commands_find_an_active_node():
    with managed() as rig:
        assert rig.add(ControllerNode).lifecycle_state == "active"
        assert state(rig, "controller") == "active"


def test_only_an_active_controller_commands_and_it_begins_anew_each_time():
    with managed("autostart:=false") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        assert sample(rig, 1) == []
        assert change(rig, "controller", "configure")
        assert sample(rig, 2) == []
        assert change(rig, "controller", "activate")
        assert sample(rig, 3) == [3]
        # the same sample once more, as a plant in lockstep repeats it
        assert sample(rig, 3) == [3, 3]
        assert change(rig, "controller", "deactivate")
        assert sample(rig, 4) == sample(rig, 4) == [3, 3]
        assert change(rig, "controller", "activate")
        # an earlier stamp is none of a sample that came late: the plant may have been started anew meanwhile
        assert sample(rig, 1) == [3, 3, 1]


def test_wall_time_an_active_node_that_is_deactivated_says_the_safe_current():
    with managed("time:=wall", "rate_hz:=5.0", "reference_hold:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(ControllerNode)
        until_it_commands(rig)
        assert change(rig, "controller", "deactivate")
        rig.spin(0.3)
        assert rig.heard["/vo2/command"][-1][1][0] == 0.0
        count = len(rig.heard["/vo2/command"])
        paced(rig)
        rig.spin(0.3)
        assert len(rig.heard["/vo2/command"]) == count


def test_an_unknown_transition_is_refused_with_one_line_each():
    with managed("autostart:=false") as rig:
        rig.add(ControllerNode)
        for wanted in (
            {"label": "fly"},
            {"number": 99},
            {"label": "activate"},
            {"label": "transition_success"},
        ):
            assert not change(rig, "controller", **wanted)
            name = str(next(iter(wanted.values())))
            rig.until(lambda name=name: f"found transition {name};" in rig.status("controller: lifecycle")[0])
            assert rig.status("controller: lifecycle")[0].endswith("need one of configure, shutdown")
        possible = call(
            rig,
            GetAvailableTransitions,
            "controller/get_available_transitions",
            GetAvailableTransitions.Request(),
        ).available_transitions
        assert {each.transition.label for each in possible} == {"configure", "shutdown"}
        assert change(rig, "controller", number=Transition.TRANSITION_CONFIGURE)


def test_parameters_that_make_no_controller_are_told_and_may_be_mended():
    with managed("autostart:=false", "pid.kp:=1.0", "pid.ki:=-1.0") as rig:
        node = rig.add(ControllerNode)
        assert not change(rig, "controller", "configure")
        rig.until(lambda: "need gains of one sign" in rig.status("controller: lifecycle")[0])
        assert state(rig, "controller") == "unconfigured"
        redesign = call(rig, Trigger, "controller/redesign", Trigger.Request())
        assert (redesign.success, redesign.message) == (False, "unconfigured: configure the node first")
        node._table.set({"pid.ki": 100.0})
        assert change(rig, "controller", "configure")


def test_a_fault_of_the_node_itself_leads_to_the_safe_current_and_it_may_be_started_again(capfd):
    with managed("time:=wall", "rate_hz:=5.0", "reference_hold:=true") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(ControllerNode)
        until_it_commands(rig)
        began = time.monotonic()
        while "broke down" not in rig.status("controller: lifecycle")[0]:
            assert time.monotonic() - began < 20.0, rig.status("controller: input")
            if node.lifecycle_state == "active":  # a design that is ready now would mend the fault
                node._law = node._supervisor._controller = None  # a fault that nobody foresaw
            paced(rig)
        assert rig.heard["/vo2/command"][-1][1][0] == 0.0
        assert state(rig, "controller") == "unconfigured"
        assert change(rig, "controller", "configure")
        assert change(rig, "controller", "activate")
        assert "AttributeError" in capfd.readouterr().err


def test_an_identifier_that_is_deactivated_leaves_the_device_safe_and_refuses_to_start():
    with managed("excitation.kind:=levels", "excitation.levels_a:=[0.004]", "fit:=false") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(IdentifierNode)
        assert call(rig, Trigger, "identifier/start", Trigger.Request()).success
        rig.say("/vo2/measurement", MS, {"heater_current": 0.004})
        rig.until(lambda: rig.heard["/vo2/command"])
        assert change(rig, "identifier", "deactivate")
        rig.until(lambda: rig.heard["/vo2/command"][-1] == (MS, (0.0,)))
        refused = call(rig, Trigger, "identifier/start", Trigger.Request())
        assert (refused.success, refused.message) == (False, "inactive: activate the node first")
