"""What the identifier does, as actions: feedback, result, cancelling, and why a goal is not taken."""

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from test_identifier_node import MS, arguments, listened, model_file, played, state  # noqa: F401  # a fixture among them
from vo2_identification.excitation_plan import informative_excitation
from vo2_identification.identifier_node import IdentifierNode
from vo2_identification.work_action import actions
from vo2_interface.testing import bench

pytestmark = pytest.mark.skipif(actions is None, reason="vo2_msgs is not built: no C compiler")
LEVELS = {"excitation__kind": "levels", "excitation__levels_a": "[0.004, 0.008]", "excitation__hold_s": "0.002",
          "excitation__cold_s": "0.001", "fit": "false"}  # fmt: skip


class Client:
    """An action client on the bench, and the feedback that came."""

    def __init__(self, rig, kind):
        self.rig, self.kind, self.feedback = rig, getattr(actions, kind), []
        self.client = ActionClient(rig.node, self.kind, f"/vo2/identifier/{kind.lower()}")
        rig.until(self.client.server_is_ready)

    def send(self):
        future = self.client.send_goal_async(
            self.kind.Goal(), feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        self.rig.until(future.done)
        return future.result()

    def result(self, goal, timeout_s=10.0):
        future = goal.get_result_async()
        self.rig.until(future.done, timeout_s=timeout_s)
        return future.result().status, future.result().result


def play(rig, samples):
    for k in range(samples):
        rig.say("/vo2/measurement", k * MS, {"heater_current": 0.001 * k, "film_resistance": 1e5})


def test_a_goal_excites_tells_how_far_it_is_and_ends_with_the_recording():
    with bench(arguments(**LEVELS)) as rig:
        rig.add(IdentifierNode)
        client = Client(rig, "Identify")
        goal = client.send()
        assert goal.accepted
        rig.until(lambda: state(rig) == "exciting")
        play(rig, 7)
        status, result = client.result(goal)
        assert status == GoalStatus.STATUS_SUCCEEDED
        assert result.message == "recorded 7 samples" and result.model_file == ""
        rig.until(lambda: client.feedback and client.feedback[-1].percent == 100)
        assert {each.state for each in client.feedback} == {"exciting"}


def test_a_goal_is_cancelled_and_the_next_one_is_taken():
    with bench(arguments(**LEVELS)) as rig:
        rig.add(IdentifierNode)
        client = Client(rig, "Identify")
        goal = client.send()
        rig.until(lambda: state(rig) == "exciting")
        cancelled = goal.cancel_goal_async()
        rig.until(cancelled.done)
        assert len(cancelled.result().goals_canceling) == 1
        status, result = client.result(goal)
        assert status == GoalStatus.STATUS_CANCELED and result.message == "cancelled while exciting"
        again = client.send()
        rig.until(lambda: state(rig) == "exciting")
        play(rig, 7)
        assert client.result(again)[0] == GoalStatus.STATUS_SUCCEEDED


def test_a_second_goal_is_told_that_the_first_is_at_work_and_does_not_disturb_it():
    with bench(arguments(**LEVELS)) as rig:
        rig.add(IdentifierNode)
        client = Client(rig, "Identify")
        first, second = client.send(), client.send()
        status, result = client.result(second)
        assert status == GoalStatus.STATUS_ABORTED and "busy" in result.message
        play(rig, 7)
        assert client.result(first)[0] == GoalStatus.STATUS_SUCCEEDED


def test_what_fails_ends_the_goal_with_the_reason():
    with bench(arguments(**LEVELS)) as rig:
        rig.add(IdentifierNode)
        client = Client(rig, "Identify")
        goal = client.send()
        rig.until(lambda: state(rig) == "exciting")
        rig.say("/vo2/measurement", 0, {"film_resistance": 1e5})
        status, result = client.result(goal)
        assert status == GoalStatus.STATUS_ABORTED and "heater_current" in result.message


def test_a_diagnosis_without_a_recording_says_what_is_missing():
    with bench(arguments()) as rig:
        rig.add(IdentifierNode)
        client = Client(rig, "Diagnose")
        status, result = client.result(client.send())
        assert status == GoalStatus.STATUS_ABORTED and "found no recording" in result.message
        assert result.verdict == "" and not result.effects


def test_a_recording_that_cannot_be_diagnosed_ends_the_goal_with_the_reason():
    given = arguments(excitation__kind="listen", fit="false", quiet_s="0.3", model__device="integrated")
    with bench(given) as rig:
        listened(rig, played(np.full(20, 5e-3), 1))
        client = Client(rig, "Diagnose")
        status, result = client.result(client.send(), timeout_s=60.0)
        assert status == GoalStatus.STATUS_ABORTED and "cannot be diagnosed" in result.message
        assert "20 samples" in client.feedback[0].text


@pytest.mark.slow
def test_a_concealed_effect_is_the_result_of_the_action(model_file):  # noqa: F811
    current = informative_excitation("integrated", 4.0, 1e-3, seed=4).sample(1e-3)
    changed = played(current, 3, {"creep": {"share": 0.06, "time_constant": 0.2}})
    given = arguments(excitation__kind="listen", fit="false", quiet_s="1.0")
    with bench([*given, "--params-file", str(model_file)]) as rig:
        listened(rig, changed)
        client = Client(rig, "Diagnose")
        cancelled = client.send()
        rig.until(lambda: client.feedback)
        rig.until(cancelled.cancel_goal_async().done)
        assert client.result(cancelled)[0] == GoalStatus.STATUS_CANCELED
        status, result = client.result(client.send(), timeout_s=300.0)
        assert status == GoalStatus.STATUS_SUCCEEDED
        assert result.verdict == "differs" and result.effects == ["creep"]
        assert result.probabilities[0] > 0.5 and "creep" in result.message
        percent = [each.percent for each in client.feedback]
        assert max(percent) > 50
