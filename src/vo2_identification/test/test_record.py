"""`record` on a real graph: nothing lost, whole after a kill, honest about a full disk."""

from __future__ import annotations

import resource
import signal
import time
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import PATIENCE_S, Graph, run, running, wait_until
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from vo2_identification.bags import read_bag, read_recording
from vo2_identification.recorder_node import Recorder
from vo2_interface.samples import SampleWriter
from vo2_interface.testing import bench
from vo2_interface.topics import LATCHED_QOS, SAMPLE_QOS

from vo2_identification import record

RECORD = "vo2_identification.record"
MEASURED = SampleWriter(("heater_current", "film_resistance"), "integrated")
COMMANDED = SampleWriter(("heater_current",), "integrated")
STEP_NS = 1_000_000


@pytest.fixture
def graph():
    opened = Graph()
    yield opened
    opened.close()


def sample(k):
    return MEASURED.write(k * STEP_NS, (1e-3 * k, 1e5 - k))


def publish_paced(publisher, messages, rate):
    for message in messages:
        publisher.publish(message)
        # never catching up in a burst: a publisher keeps 100 samples, more at once are lost by contract
        time.sleep(1 / rate)


def wait_for_recorder(process, *publishers):
    """Wait until both sides have met, as the recorder says, and return its lines: what comes before is not promised."""
    lines = []
    waiting = {publisher.topic_name for publisher in publishers}
    while waiting:
        line = process.stdout.readline()
        assert line, f"the recorder ended before it heard {waiting}"
        lines.append(line)
        if line.startswith(record.HEARS):
            waiting -= {topic.strip() for topic in line.removeprefix(record.HEARS).split(",")}
    wait_until(lambda: all(publisher.get_subscription_count() > 0 for publisher in publishers), "discovery")
    return lines


def counted(path):
    with Reader(path) as bag:
        return {connection.topic: connection.msgcount for connection in bag.connections}


@pytest.mark.parametrize("storage", ["mcap", pytest.param("sqlite3", marks=pytest.mark.slow)])
def test_all_samples_of_two_fast_topics_are_recorded_with_their_stamps(graph, tmp_path, storage):
    # what the contract keeps, 100 samples, a busy machine can lose on the way: nothing the recorder could do
    plenty = QoSProfile(depth=5000, reliability=SAMPLE_QOS.reliability, durability=SAMPLE_QOS.durability)
    measurement = graph.publisher(JointState, "/vo2/measurement", plenty)
    command = graph.publisher(JointState, "/vo2/command", plenty)
    total = 2000
    with running(
        RECORD, "--output", tmp_path / "bag", "--storage", storage, "--messages", 2 * total
    ) as process:
        wait_for_recorder(process, measurement, command)
        for k in range(total):
            measurement.publish(sample(k))
            command.publish(COMMANDED.write(k * STEP_NS, (1.0 + k,)))
            time.sleep(2e-4)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert str(tmp_path / "bag") in out
    assert f"Recorded {2 * total} messages" in out
    recording, problems = read_recording(tmp_path / "bag")
    assert problems == []
    np.testing.assert_array_equal(recording.time_s, np.arange(total) / 1000)
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - np.arange(total))
    np.testing.assert_array_equal(recording["commanded_current"][1:], 1.0 + np.arange(total - 1))
    with Reader(tmp_path / "bag") as bag:
        times = [when for connection, when, _ in bag.messages() if connection.topic == "/vo2/measurement"]
    assert times == [k * STEP_NS for k in range(total)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_killed_recorder_leaves_a_bag_up_to_the_last_second(graph, tmp_path, storage):
    measurement = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    with running(RECORD, "--output", tmp_path / "bag", "--storage", storage) as process:
        wait_for_recorder(process, measurement)
        publish_paced(measurement, [sample(k) for k in range(500)], 400)
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=5)
    recording, _ = read_recording(tmp_path / "bag")
    assert len(recording) >= 500 - 400  # 400 a second
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - np.arange(len(recording)))
    if storage == "mcap":
        # any reader takes it without a rescue; ours also finds what a flush had begun to write when the kill came
        assert 500 - 400 <= counted(tmp_path / "bag")["/vo2/measurement"] <= len(recording)


@pytest.mark.parametrize(
    ("how", "options", "files"),
    [
        (signal.SIGINT, ["--compression", "lz4"], 1),
        (signal.SIGTERM, ["--compression", "zstd", "-d", "0.03"], 4),
    ],
)
def test_ctrl_c_and_sigterm_close_a_complete_bag(graph, tmp_path, how, options, files):
    measurement = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    with running(RECORD, "--output", tmp_path / "bag", *options) as process:
        wait_for_recorder(process, measurement)
        publish_paced(measurement, [sample(k) for k in range(100)], 1000)
        process.send_signal(how)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert "Recorded 100 messages" in out
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == files
    recording, problems = read_recording(tmp_path / "bag")
    assert len(recording) == 100
    assert {problem.kind for problem in problems} == {"missing_topic"}


def test_a_full_disk_is_said_and_the_bag_closed_readable(graph, tmp_path):
    measurement = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)

    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (120_000, 120_000))

    with running(RECORD, "--output", tmp_path / "bag", before=small_disk) as process:
        wait_for_recorder(process, measurement)
        k = 0
        deadline = time.monotonic() + PATIENCE_S
        while process.poll() is None and time.monotonic() < deadline:
            measurement.publish(sample(k))
            k += 1
            time.sleep(0.001)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "closed and readable" in err
    assert len(err.strip().splitlines()) == 1
    recording, problems = read_recording(tmp_path / "bag")
    assert 200 < len(recording) < k
    assert {problem.kind for problem in problems} == {"missing_topic"}
    assert counted(tmp_path / "bag") == {"/vo2/measurement": len(recording)}


def test_a_disk_that_is_full_before_the_first_sample_leaves_no_stub(graph, tmp_path):
    measurement = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    with running(RECORD, "--output", tmp_path / "bag") as process:
        wait_for_recorder(process, measurement)
        (file,) = (tmp_path / "bag").glob("*.mcap")
        room = file.stat().st_size  # none beyond that of the empty bag
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (room, room))
        deadline = time.monotonic() + PATIENCE_S
        while process.poll() is None and time.monotonic() < deadline:
            measurement.publish(sample(0))
            time.sleep(0.01)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert f"record: {tmp_path / 'bag'}: cannot be written" in err and "nothing was recorded" in err
    assert len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_latched_references_odd_publishers_and_repeats(graph, tmp_path):
    reference = graph.publisher(JointState, "/vo2/reference", LATCHED_QOS)
    reference.publish(COMMANDED.write(0, (5.0,)))  # before the recorder is there
    sensor = QoSProfile(
        depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
    )
    odd = graph.publisher(JointState, "/vo2/measurement", sensor)
    with running(RECORD, "--output", tmp_path / "bag", "--messages", 11) as process:
        wait_for_recorder(process, reference, odd)
        for k in range(10):
            for _ in range(3):  # as a plant in lockstep repeats itself
                odd.publish(sample(k))
                time.sleep(0.005)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert counted(tmp_path / "bag") == {"/vo2/reference": 1, "/vo2/measurement": 10}
    with Reader(tmp_path / "bag") as bag:
        qos = {connection.topic: connection.ext.offered_qos_profiles[0] for connection in bag.connections}  # type: ignore[union-attr]
    assert qos["/vo2/reference"].durability is QosDurability.TRANSIENT_LOCAL
    assert qos["/vo2/measurement"].reliability is QosReliability.BEST_EFFORT
    assert qos["/vo2/measurement"].durability is QosDurability.VOLATILE


def test_messages_on_another_clock_are_filed_under_the_samples(graph, tmp_path):
    diagnostics = graph.publisher(DiagnosticArray, "/diagnostics", SAMPLE_QOS)
    measurement = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    clock = graph.publisher(Clock, "/clock", SAMPLE_QOS)
    with running(RECORD, "--output", tmp_path / "bag", "--messages", 4) as process:
        wait_for_recorder(process, diagnostics, measurement, clock)
        wall = DiagnosticArray()
        wall.header.stamp.sec = 1_700_000_000
        diagnostics.publish(wall)  # nobody knows the samples' time yet
        time.sleep(0.3)
        measurement.publish(sample(7))
        time.sleep(0.3)
        near = DiagnosticArray()
        near.header.stamp.nanosec = 9 * STEP_NS
        diagnostics.publish(near)
        tick = Clock()
        tick.clock.nanosec = 8 * STEP_NS
        clock.publish(serialize_message(tick))
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    with Reader(tmp_path / "bag") as bag:
        assert sorted((c.topic, when // STEP_NS) for c, when, _ in bag.messages()) == [
            ("/clock", 8),
            ("/diagnostics", 7),
            ("/diagnostics", 9),
            ("/vo2/measurement", 7),
        ]


def test_another_namespace_and_a_topic_whose_type_the_graph_knows(graph, tmp_path):
    measurement = graph.publisher(JointState, "/rig/measurement", SAMPLE_QOS)
    health = graph.publisher(DiagnosticArray, "/rig/health", SAMPLE_QOS)
    topics = ("--topics", "/rig/measurement", "/rig/health")
    options = ("--namespace", "/rig", "--output", tmp_path / "bag", "--messages", 2)
    with running(RECORD, *topics, *options) as process:
        told = wait_for_recorder(process, measurement, health)
        measurement.publish(sample(1))
        health.publish(DiagnosticArray())
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert told[0].startswith("Recording ") and told[1].startswith("Hears /rig/")
    assert counted(tmp_path / "bag") == {"/rig/measurement": 1, "/rig/health": 1}
    recordings, _ = read_bag(tmp_path / "bag", namespace="/rig")
    assert len(recordings["measurement"]) == 1


def test_a_duration_ends_it_and_silence_is_said(tmp_path):
    began = time.monotonic()
    ended = run(RECORD, "--output", tmp_path / "bag", "--duration", 0.5)
    assert time.monotonic() - began < PATIENCE_S / 2
    assert ended.returncode == 0
    assert "no message came on /vo2/command, /vo2/measurement" in ended.stderr
    assert f"Recorded 0 messages (none). The bag: {tmp_path / 'bag'}" in ended.stdout
    assert counted(tmp_path / "bag") == {}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--output", "{new}", "--namespace", "bad ns"], "--namespace: Invalid namespace"),
        (["--output", "{there}"], "exists already"),
        (["--output", "{there}/file/bag"], "cannot be created"),
        (["--output", "{new}", "--duration", "-1"], "--duration"),
        (["--output", "{new}", "--messages", "0"], "--messages"),
        (["--output", "{new}", "--speed", "1"], "--speed"),
        (["--output", "{new}", "-b", "0"], "--max-bag-size"),
        (["--output", "{new}", "--storage", "sqlite3", "-d", "5"], "need mcap"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, capsys, arguments, named):
    (tmp_path / "file").write_text("")
    filled = [one.format(there=tmp_path, new=tmp_path / "new") for one in arguments]
    assert record.main(filled) == 2
    said = capsys.readouterr().err
    assert named in said
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "new").exists()


def test_ctrl_c_while_it_loads_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "_record", interrupted)
    assert record.main(["--output", str(tmp_path / "bag")]) == 130
    assert capsys.readouterr().err == "record: interrupted while it loaded: nothing is recorded\n"
    assert not (tmp_path / "bag").exists()


def test_help_is_sentences(capsys):
    with pytest.raises(SystemExit, match="0"):
        record.main(["--help"])
    said = capsys.readouterr().out
    for option in ("--output", "--topics", "--duration", "--messages", "--storage", "--namespace"):
        assert option in said


def test_what_came_before_the_stop_is_in_the_bag_though_the_recorder_lags_behind(graph, tmp_path):
    # a recorder that got no processor time for a while: all of it is in its queue when it is asked to stop
    total = 15_000
    plenty = QoSProfile(depth=total, reliability=SAMPLE_QOS.reliability, durability=SAMPLE_QOS.durability)
    publisher = graph.publisher(JointState, "/vo2/measurement", plenty)
    with running(RECORD, "--output", tmp_path / "bag", "--topics", "/vo2/measurement") as process:
        wait_for_recorder(process, publisher)
        process.send_signal(signal.SIGSTOP)
        given_up = (
            time.monotonic() + 10
        )  # well before a publisher does, after 20 s: it waits where the socket is full
        sent = 0
        while sent < total and time.monotonic() < given_up:
            publisher.publish(sample(sent))
            sent += 1
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGCONT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert counted(tmp_path / "bag") == {"/vo2/measurement": sent}


class _Stalling:
    """A recorder that stands still while it looks for topics, is asked to stop meanwhile, and is sent the rest late."""

    failure, met, count, lost, without_sample = None, frozenset(), 0, 0, 0
    bag = SimpleNamespace(flush_period_s=0.0)

    def __init__(self, stop):
        self.stop, self.due, self.heard = stop, np.inf, False

    def idle(self):
        time.sleep(0.25)
        self.due = time.monotonic() + 1.2
        self.stop.is_set = True

    def take(self, *, before_ns=None, most=None):
        self.heard |= time.monotonic() >= self.due
        return False


def test_a_stall_in_which_the_stop_comes_is_waited_for_wherever_it_was():
    stop = SimpleNamespace(is_set=False)
    recorder = _Stalling(stop)
    options = SimpleNamespace(messages=None, duration=None)
    stood_still_s = record._take_all(recorder, options, stop, lambda *told: None)
    assert recorder.heard and 0.25 <= stood_still_s < 2.0


@pytest.mark.slow
def test_a_recorder_that_stood_still_for_longer_than_publishers_wait_says_so(graph, tmp_path):
    publisher = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    with running(RECORD, "--output", tmp_path / "bag", "--topics", "/vo2/measurement") as process:
        wait_for_recorder(process, publisher)
        publish_paced(publisher, [sample(k) for k in range(50)], 500)
        time.sleep(0.5)
        process.send_signal(signal.SIGSTOP)
        wait_until(lambda: publisher.get_subscription_count() == 0, "the publisher's giving up", timeout_s=60)
        publish_paced(publisher, [sample(k) for k in range(50, 60)], 500)
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGCONT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "record: stood still for " in err
    assert counted(tmp_path / "bag") == {"/vo2/measurement": 50}


def test_what_does_not_arrive_is_counted_told_and_ends_with_status_1(graph, tmp_path):
    # best effort with a short queue, and a recorder that stands still: its own queue cannot help
    sensor = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = graph.publisher(JointState, "/vo2/measurement", sensor)
    arguments = ("--output", tmp_path / "bag", "--topics", "/vo2/measurement")
    with running(RECORD, *arguments) as process:
        wait_for_recorder(process, publisher)
        publish_paced(publisher, [sample(k) for k in range(50)], 500)
        process.send_signal(signal.SIGSTOP)
        # at once: paced, they took 20 s beside other work, and after 16 s the publisher has given the recorder up
        for k in range(50, 20_050):
            publisher.publish(sample(k))
        process.send_signal(signal.SIGCONT)
        time.sleep(0.5)
        publish_paced(publisher, [sample(k) for k in range(20_050, 20_100)], 500)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    kept = counted(tmp_path / "bag")["/vo2/measurement"]
    assert kept < 20_100
    assert process.returncode == 1, err
    assert f"/vo2/measurement: {20_100 - kept} messages were sent and did not arrive" in err
    assert f"the bag lacks {20_100 - kept} messages, more than --lost-limit 0" in err
    recording, _ = read_recording(tmp_path / "bag")
    assert f"{20_100 - kept} sample periods without a sample" in err
    assert len(recording) == kept


def test_periods_that_a_source_left_out_are_told_and_too_many_end_with_status_1(graph, tmp_path):
    publisher = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    for name, limit, status in (("many", 5, 1), ("allowed", 30, 0)):
        arguments = ("--output", tmp_path / name, "--topics", "/vo2/measurement", "--gap-limit", limit)
        with running(RECORD, *arguments) as process:
            wait_for_recorder(process, publisher)
            publish_paced(publisher, [sample(k) for k in range(600) if k % 5], 500)
            time.sleep(0.6)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == status, err
        assert "sample periods without a sample so far" in err
        assert ("% of a topic's sample periods have no sample, more than --gap-limit 5" in err) is bool(
            status
        )


@pytest.mark.parametrize(("start_ns", "status"), [(0, 1), (time.time_ns(), 0)], ids=["lockstep", "wall"])
def test_a_topic_whose_first_samples_are_absent_is_told_and_in_lockstep_ends_with_status_1(
    graph, tmp_path, start_ns, status
):
    measurement = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    command = graph.publisher(JointState, "/vo2/command", SAMPLE_QOS)
    measured = [MEASURED.write(start_ns + k * STEP_NS, (1e-3, 1e5)) for k in range(1, 40)]
    for each in measured[:3]:
        measurement.publish(each)  # before the recorder is there
    with running(RECORD, "--output", tmp_path / "bag", "--messages", 36 + 39) as process:
        wait_for_recorder(process, measurement, command)
        for k in range(1, 40):
            command.publish(COMMANDED.write(start_ns + k * STEP_NS, (1.0,)))
        publish_paced(measurement, measured[3:], 500)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status, err
    assert "/vo2/measurement: " in err
    assert "begins 0.003000 s later than /vo2/command: 3 sample periods before are not in the bag" in err
    assert ("the bag lacks 3 messages, more than --lost-limit 0" in err) is bool(status)


def test_malformed_messages_are_left_out_and_counted(graph, tmp_path):
    publisher = graph.publisher(JointState, "/vo2/measurement", SAMPLE_QOS)
    negative, overflow = bytearray(sample(1)), bytearray(sample(1))
    negative[4:8] = (-1).to_bytes(4, "little", signed=True)
    overflow[8:12] = (2_000_000_000).to_bytes(4, "little")
    with running(RECORD, "--output", tmp_path / "bag") as process:
        wait_for_recorder(process, publisher)
        messages = [sample(1), bytes(negative), bytes(overflow), bytes(overflow), sample(1)[:9], sample(2)]
        publish_paced(publisher, messages, 100)
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert counted(tmp_path / "bag") == {"/vo2/measurement": 2}
    assert "/vo2/measurement: 1 left out: its stamp is negative" in err
    assert "/vo2/measurement: 2 left out: its stamp has more nanoseconds than a second" in err
    assert "/vo2/measurement: 1 left out: it is cut short" in err


@pytest.mark.parametrize("chosen", [pytest.param(("-a",), marks=pytest.mark.slow), ("--regex", "^/rig/m")])
def test_topics_are_taken_as_they_appear(graph, tmp_path, chosen):
    with running(RECORD, "--output", tmp_path / "bag", *chosen) as process:
        time.sleep(1.0)
        measurement = graph.publisher(JointState, "/rig/measurement", LATCHED_QOS)
        health = graph.publisher(DiagnosticArray, "/rig/health", LATCHED_QOS)
        measurement.publish(sample(1))
        health.publish(DiagnosticArray())
        wait_until(lambda: measurement.get_subscription_count() > 0, "discovery")
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    found = counted(tmp_path / "bag")
    assert found["/rig/measurement"] == 1
    assert ("/rig/health" in found) == (chosen == ("-a",))


def test_the_namespace_of_ros_arguments_chooses_the_loop(graph, tmp_path):
    measurement = graph.publisher(JointState, "/rig/measurement", SAMPLE_QOS)
    options = ("--output", tmp_path / "bag", "--messages", 1, "--ros-args", "-r", "__ns:=/rig")
    with running(RECORD, *options) as process:
        wait_for_recorder(process, measurement)
        measurement.publish(sample(1))
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert counted(tmp_path / "bag") == {"/rig/measurement": 1}


def test_what_a_recorder_asks_for_can_be_overridden_and_then_stands():
    nothing = SimpleNamespace(flush_if_due=lambda: None)
    setting = "qos_overrides./vo2/measurement.subscription.reliability:=best_effort"
    with bench(["--ros-args", "-p", setting]) as rig:
        rig.node.create_publisher(JointState, "/vo2/measurement", LATCHED_QOS)
        recorder = rig.add(lambda: Recorder(nothing))
        rig.until(lambda: recorder.count_publishers("/vo2/measurement") == 1)
        recorder.idle()
        found = {each.topic_name: each.qos_profile for each in recorder.subscriptions}
    assert found["/vo2/measurement"].reliability == ReliabilityPolicy.BEST_EFFORT
    assert found["/vo2/measurement"].durability == DurabilityPolicy.VOLATILE
    assert found["/vo2/estimate"].reliability == ReliabilityPolicy.RELIABLE
