"""The emergency stop on a real graph: every node follows, whoever says it and whoever comes late."""

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import SetBool
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.emergency_stop import EmergencyStop
from vo2_interface.testing import bench


class Commander(Node):
    """A node that obeys."""

    def __init__(self, name):
        super().__init__(name, namespace="/vo2")
        self.stop = EmergencyStop(self, Diagnostics(self))


def call(rig, name, stop):
    client = rig.node.create_client(SetBool, f"/vo2/{name}/emergency_stop")
    rig.until(client.service_is_ready)
    rig.spin(0.2)
    answer = client.call_async(SetBool.Request(data=stop))
    rig.until(answer.done)
    assert answer.result().success
    return answer


def test_one_service_stops_all_and_another_releases_all():
    with bench() as rig:
        first, second = (rig.add(lambda name=name: Commander(name)) for name in ("first", "second"))
        rig.until(lambda: rig.node.count_subscribers("/vo2/emergency_stop") == 4)
        rig.spin(1.1)
        call(rig, "first", True)
        rig.until(lambda: first.stop.active and second.stop.active)
        rig.until(lambda: "stopped: safe current" in rig.status("second: emergency stop")[0])
        call(rig, "second", False)
        rig.until(lambda: not first.stop.active and not second.stop.active)
        late = rig.add(lambda: Commander("late"))
        rig.spin(1.0)
        assert not late.stop.active
        call(rig, "second", True)
        rig.until(lambda: first.stop.active and late.stop.active)
        # the word of `second` stands beside an older release of `first`
        latest = rig.add(lambda: Commander("latest"))
        rig.until(lambda: latest.stop.active)
        rig.spin(0.5)
        assert latest.stop.active


def test_a_stop_right_after_a_release_stands():
    with bench() as rig:
        node = rig.add(lambda: Commander("node"))
        call(rig, "node", True)
        client = rig.node.create_client(SetBool, "/vo2/node/emergency_stop")
        rig.until(client.service_is_ready)
        answers = [client.call_async(SetBool.Request(data=stop)) for stop in (False, True)]
        rig.until(lambda: all(answer.done() for answer in answers))
        rig.spin(0.3)
        assert node.stop.active


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
def test_a_stop_is_heard_from_a_volatile_publisher(reliability):
    with bench() as rig:
        node = rig.add(lambda: Commander("node"))
        publisher = rig.node.create_publisher(
            Bool, "/vo2/emergency_stop", QoSProfile(depth=1, reliability=reliability)
        )
        rig.until(lambda: publisher.get_subscription_count() == 1)
        rig.spin(0.2)
        publisher.publish(Bool(data=True))
        rig.until(lambda: node.stop.active)


def test_a_stop_that_reached_one_node_only_reaches_all_and_one_release_ends_it():
    """As by `ros2 topic pub --once`, which is gone once its first listener is found."""
    with bench() as rig:
        nodes = [rig.add(lambda name=name: Commander(name)) for name in ("first", "second", "third")]
        rig.until(lambda: rig.node.count_subscribers("/vo2/emergency_stop") == 6)
        rig.spin(1.1)
        nodes[1].stop._on_any_word(Bool(data=True))
        rig.until(lambda: all(node.stop.active for node in nodes))
        rig.spin(0.3)
        call(rig, "first", False)
        rig.until(lambda: not any(node.stop.active for node in nodes))
        rig.spin(1.0)
        assert not any(node.stop.active for node in nodes)
