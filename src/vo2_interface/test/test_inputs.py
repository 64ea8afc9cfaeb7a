"""Inputs of the nodes: any quality of service, any bytes, on a real graph."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.emergency_stop import EmergencyStop
from vo2_interface.inputs import SampleInput
from vo2_interface.live.node import LiveNode
from vo2_interface.samples import MalformedSampleError, SampleReader, SampleWriter, message_stamp_ns
from vo2_interface.supervise import SuperviseNode
from vo2_interface.testing import bench
from vo2_interface.topics import EMERGENCY_STOP_QOS, READ_QOS

MS = 1_000_000
WRITER = SampleWriter(("heater_current", "film_resistance"), "integrated")
SENSOR = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


class Listener(Node):
    """A node with one input."""

    def __init__(self, *, latched=False):
        super().__init__("listener", namespace="/vo2")
        self.reader = SampleReader(("film_resistance",))
        self.heard = []
        self.input = SampleInput(self, "measurement", self.on_sample, Diagnostics(self), latched=latched)

    def on_sample(self, data):
        self.heard.append(self.reader.read(data))


def sample(k):
    return WRITER.write(k * MS, (1e-3, 1e5 + k))


def publish(rig, publisher, messages):
    for message in messages:
        publisher.publish(message)
        rig.spin(0.002)


@pytest.mark.parametrize("latched", [False, True])
def test_a_best_effort_publisher_is_heard_and_what_it_loses_is_counted(latched):
    with bench() as rig:
        listener = rig.add(lambda: Listener(latched=latched))
        publisher = rig.node.create_publisher(JointState, "/vo2/measurement", SENSOR)
        rig.until(lambda: publisher.get_subscription_count() == 1)
        rig.spin(0.3)
        publish(rig, publisher, [sample(k) for k in range(60) if k not in (40, 41, 50)])
        rig.until(lambda: len(listener.heard) == 57)
        rig.until(lambda: "2 samples of" in rig.status("input measurement")[0])
        assert any("offers best effort only" in text for _, text, _ in rig.statuses)
        publish(rig, publisher, [sample(64)])  # 60 to 63 are missing, and 50 from before
        rig.until(lambda: "7 samples of" in rig.status("input measurement")[0])


def test_a_timer_that_catches_up_makes_one_loss_at_most():
    with bench() as rig:
        listener = rig.add(Listener)
        publisher = rig.node.create_publisher(JointState, "/vo2/measurement", SENSOR)
        rig.until(lambda: publisher.get_subscription_count() == 1)
        rig.spin(0.3)
        stamps = [20 * k for k in range(80)]
        stamps[30] = stamps[31] - 1  # one tick late, the next in time
        publish(rig, publisher, [sample(k) for k in stamps])
        rig.until(lambda: len(listener.heard) == 80)
        rig.spin(0.1)
        told = [text for _, text, _ in rig.statuses if "missing by their stamps" in text]
        assert all(": 1 samples of" in text for text in told)


def test_reliability_can_be_overridden_by_parameter():
    name = "qos_overrides./vo2/measurement.subscription.reliability"
    with bench(["--ros-args", "-p", f"{name}:=best_effort"]) as rig:
        listener = rig.add(Listener)
        assert listener.get_parameter(name).value == "best_effort"
        rig.until(lambda: rig.node.get_subscriptions_info_by_topic("/vo2/measurement"))
        (info,) = rig.node.get_subscriptions_info_by_topic("/vo2/measurement")
        assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT


class Obeys(Node):
    """A node with an emergency stop."""

    def __init__(self):
        super().__init__("obeys", namespace="/vo2")
        EmergencyStop(self, Diagnostics(self))


@pytest.mark.parametrize(
    ("make", "topic", "arguments", "usual"),
    [
        (Obeys, "/vo2/emergency_stop", [], EMERGENCY_STOP_QOS),
        (LiveNode, "/vo2/emergency_stop", ["-p", "port:=0"], EMERGENCY_STOP_QOS),
        (SuperviseNode, "/diagnostics", ["-p", "run:=['vo2_interface live']"], READ_QOS),
    ],
    ids=["emergency stop", "live", "supervise"],
)
def test_every_input_can_be_overridden_and_no_other_is(make, topic, arguments, usual):
    setting = f"qos_overrides.{topic}.subscription.reliability:=best_effort"
    with bench(["--ros-args", "-p", setting, *arguments]) as rig:
        node = rig.add(make)
        first, *_ = [each for each in node.subscriptions if each.topic_name == topic]
        assert first.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        assert usual.reliability == ReliabilityPolicy.RELIABLE


def test_what_cannot_be_read_is_dropped_and_told_once_per_cause():
    negative = bytearray(sample(1))
    negative[4:8] = (-1).to_bytes(4, "little", signed=True)
    overflow = bytearray(sample(1))
    overflow[8:12] = (2_000_000_000).to_bytes(4, "little")
    bad = [sample(1)[:40], bytes(negative), bytes(overflow), sample(2)[:9]]
    with bench() as rig:
        listener = rig.add(Listener)
        publisher = rig.node.create_publisher(JointState, "/vo2/measurement", 100)
        rig.until(lambda: publisher.get_subscription_count() == 1)
        rig.spin(0.2)
        for _ in range(5):
            publish(rig, publisher, bad)
        publish(rig, publisher, [sample(3)])
        rig.until(lambda: listener.heard)
        assert listener.heard == [(3 * MS, (1e5 + 3,))]
        said = {text for name, text, _ in rig.statuses if name.endswith("input measurement")}
        assert len(said) == 3
        last = rig.status("input measurement")[0]
        for cause in ("cut short", "is negative", "more nanoseconds than a second"):
            assert cause in last


@given(st.binary(max_size=120) | st.integers(0, 2**32).map(lambda seed: damaged(seed)))
def test_any_bytes_are_a_sample_or_malformed(data):
    reader = SampleReader(("film_resistance",))
    reader.read(sample(1))
    for read in (reader.read, message_stamp_ns):
        try:
            read(data)
        except MalformedSampleError as error:
            assert len(str(error)) < 80


def damaged(seed):
    """A sample with a few bytes changed."""
    draw = random.Random(seed)
    data = bytearray(sample(draw.randrange(1000)))
    for _ in range(draw.randint(1, 4)):
        data[draw.randrange(len(data))] = draw.randrange(256)
    return bytes(data)
