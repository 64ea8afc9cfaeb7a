"""`replay` on a real graph: every message, in rhythm, with its quality of service."""

from __future__ import annotations

import itertools
import os
import pty
import signal
import sys
import time

import numpy as np
import pytest
from bag_makers import JOINT_STATE, bag_by_rosbags, measurements
from graph import PATIENCE_S, Graph, environment, running
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from vo2_identification.bags import BagError, BagWriter, write_bag
from vo2_identification.bags.joint_state import encode
from vo2_identification.bags.playback import outline, schedule
from vo2_interface.topics import LATCHED_QOS, READ_QOS
from vo2_models.recording import Recording

from vo2_identification import replay

REPLAY = "vo2_identification.replay"


@pytest.fixture
def graph():
    opened = Graph()
    yield opened
    opened.close()


def stamps(messages):
    return [message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec for message in messages]


def recording_of(n, period_s=0.001):
    channels = {"heater_current": np.arange(n) * 1e-3, "film_resistance": 1e5 - np.arange(n)}
    return Recording(np.arange(n) * round(period_s * 1e9) / 1e9, channels, "integrated")


def test_every_message_arrives_unchanged_in_rhythm(graph, tmp_path):
    bag = write_bag(tmp_path / "bag", recording_of(1000), storage="sqlite3")
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    with running(REPLAY, bag, "--rate", 0.5, "--wait", 10) as process:
        graph.spin_until(lambda: len(heard) >= 1, "the first message")
        began = time.monotonic()
        graph.spin_until(lambda: len(heard) >= 1000, "the last message")
        took = time.monotonic() - began
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert stamps(heard) == [k * 1_000_000 for k in range(1000)]
    assert [list(message.position) for message in heard] == [[1e-3 * k, 1e5 - k] for k in range(1000)]
    assert heard[0].header.frame_id == "integrated"
    assert 1.8 < took < 6.0  # 1 s at half the speed; a loaded machine may be slower
    assert "Replayed 1000 messages of /vo2/measurement" in out
    assert str(bag) in out


class Met:
    """A publisher that meets three subscribers one after the other."""

    def __init__(self):
        self.began = time.monotonic()

    def get_subscription_count(self):
        return min(3, 1 + int((time.monotonic() - self.began) / 0.2))


def test_it_begins_when_no_more_subscribers_come(capsys):
    met = Met()
    assert replay._wait_for_subscribers({"/vo2/measurement": met}, 30.0, lambda: False) == []
    assert time.monotonic() - met.began > 0.4 + replay._SETTLE_S
    assert "Playing /vo2/measurement to 3 subscribers" in capsys.readouterr().out
    assert replay._wait_for_subscribers({"/vo2/measurement": Met()}, 0.0, lambda: False) == []


def test_a_loop_moves_stamps_on_and_says_so(graph, tmp_path):
    bag = write_bag(tmp_path / "bag", recording_of(50, period_s=0.002))
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    with running(REPLAY, bag, "--loop", 3, "--wait", 10) as process:
        graph.spin_until(lambda: len(heard) >= 150, "three passes")
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert stamps(heard) == [k * 2_000_000 for k in range(150)]
    assert [message.position[1] for message in heard] == [1e5 - k % 50 for k in range(150)]
    assert "Looping: each pass moves the stamps on by 0.1 s" in out


def test_offset_duration_topics_and_clock(graph, tmp_path):
    loop = {"measurement": recording_of(100, 0.01), "estimate": recording_of(100, 0.01)}
    bag = write_bag(tmp_path / "bag", loop)
    clocks = graph.collect(Clock, "/clock", READ_QOS)
    measured = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    estimated = graph.collect(JointState, "/vo2/estimate", READ_QOS)
    part = ("--offset", 0.5, "--duration", 0.3, "--rate", 0.3, "--topics", "/vo2/measurement", "--clock", 200)
    with running(REPLAY, bag, *part, "--wait", 10) as process:
        graph.spin_until(lambda: len(measured) >= 30, "the messages")
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert stamps(measured) == [k * 10_000_000 for k in range(50, 80)]
    assert estimated == []
    told = [message.clock.sec + message.clock.nanosec * 1e-9 for message in clocks]
    assert len(told) > 20
    assert told == sorted(set(told))
    assert 0.49 <= told[0] <= 0.6
    assert told[-1] <= 0.79 + 1e-9
    assert "Replayed 30 messages" in out


def test_a_late_subscriber_gets_the_reference_from_before_the_offset(graph, tmp_path):
    bag = write_bag(tmp_path / "bag", {"measurement": recording_of(100, 0.01), "reference": recording_of(1)})
    measured = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    with running(REPLAY, bag, "--offset", 0.5, "--wait", 1, "--loop") as process:
        graph.spin_until(lambda: len(measured) >= 1, "the first message")
        late = graph.collect(JointState, "/vo2/reference", LATCHED_QOS)
        graph.spin_until(lambda: len(late) == 1, "the latched reference")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert stamps(late) == [0]
    assert "nobody listens to /vo2/reference" in err


def test_ctrl_c_ends_it_with_a_word(graph, tmp_path):
    bag = write_bag(tmp_path / "bag", recording_of(10, period_s=0.05))
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    with running(REPLAY, bag, "--loop", "--wait", 10) as process:
        graph.spin_until(lambda: len(heard) > 12, "a second pass")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert "Stopped after" in out


def test_a_damaged_bag_is_played_as_far_as_it_goes(graph, tmp_path):
    bag = bag_by_rosbags(tmp_path / "bag", measurements(400), chunk=100)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    with running(REPLAY, bag, "--wait", 10) as process:
        graph.spin_until(lambda: process.poll() is not None, "the end")
        out, err = process.communicate(timeout=PATIENCE_S)
    graph.spin_until(lambda: f"Replayed {len(heard)} messages" in out, "the last message")
    assert "without a footer" in err
    assert stamps(heard) == [k * 1_000_000 for k in range(len(heard))]
    assert len(heard) > 150


def test_the_schedule_of_passes_offsets_and_lengths(tmp_path):
    bag = write_bag(tmp_path / "bag", recording_of(10, 0.1))
    held = outline(bag)
    assert (held.first_ns, held.last_ns, held.pass_ns) == (0, 900_000_000, 1_000_000_000)
    once = [due.due_s for due in schedule(bag, held)]
    np.testing.assert_allclose(once, np.arange(10) / 10, atol=1e-12)
    # a later pass starts at the offset too, one period after the end of the one before
    part = list(schedule(bag, held, offset_s=0.65, passes=2))
    np.testing.assert_allclose([due.due_s for due in part], [0.05, 0.15, 0.25, 0.40, 0.50, 0.60], atol=1e-12)
    assert [due.time_ns // 100_000_000 for due in part] == [7, 8, 9, 17, 18, 19]
    short = [due.due_s for due in schedule(bag, held, offset_s=0.2, duration_s=0.3)]
    np.testing.assert_allclose(short, [0.0, 0.1, 0.2], atol=1e-12)


def stock_bag(path, *, stamps_s):
    """A bag of a run in simulated time as `ros2 bag record` writes it: log times of the wall, stamps of the run."""
    with BagWriter(path) as bag:
        topic = bag.add_topic("/vo2/measurement", JOINT_STATE)
        clock = bag.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        times = np.rint(np.array(stamps_s) * 1e9).astype(np.int64)
        for k, message in enumerate(
            encode(times, ["heater_current"], np.zeros((times.size, 1)), "integrated")
        ):
            bag.write(topic, 1_760_000_000_000_000_000 + 1_000_000 * k, message)
            bag.write(clock, 1_760_000_000_000_000_000 + 1_000_000 * k, message[:12])
    return path


def test_a_bag_of_simulated_time_with_log_times_of_the_wall_is_played(graph, tmp_path):
    # ten times as fast as the wall
    bag = stock_bag(tmp_path / "bag", stamps_s=np.arange(50) / 100)
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    with running(REPLAY, bag, "--loop", 2, "--wait", 10, "--topics", "/vo2/measurement") as process:
        graph.spin_until(lambda: len(heard) >= 100, "two passes")
        _, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    told = stamps(heard)
    assert told[:50] == [10_000_000 * k for k in range(50)]
    assert all(later > earlier for earlier, later in itertools.pairwise(told))


def test_stamps_of_two_clocks_do_not_stretch_a_pass(tmp_path):
    held = outline(stock_bag(tmp_path / "bag", stamps_s=[0.0, 0.01, 1_760_000_000.0]))
    assert held.pass_ns == 3_000_000


def test_a_stamp_that_cannot_be_moved_on_ends_with_a_line(tmp_path):
    bag = stock_bag(tmp_path / "bag", stamps_s=[2.0**31 - 1.0, 2.0**31 - 0.5])
    with pytest.raises(BagError, match=r"cannot be moved on .* play the bag fewer times"):
        list(schedule(bag, outline(bag), passes=3))


def split_bag(path):
    """A bag of three compressed files, 2.5 s long."""
    with BagWriter(path, compression="zstd", split_s=1.0) as bag:
        number = bag.add_topic("/vo2/measurement", JOINT_STATE)
        for k in range(250):
            stamp = 10_000_000 * (k + 1)
            bag.write(number, stamp, encode([stamp], ["heater_current"], np.array([[1e-3]]), "x")[0])
    assert len(list(path.glob("*.mcap"))) == 3
    return path


def ask(graph, kind, name, request):
    client = graph.node.create_client(kind, f"/replay/{name}")
    graph.spin_until(client.service_is_ready, "the service")
    answer = client.call_async(request)
    graph.spin_until(answer.done, "the answer")
    return answer.result()


def pass_time(graph, seconds):
    end = time.monotonic() + seconds
    graph.spin_until(lambda: time.monotonic() > end, "time")


def test_a_split_bag_is_paused_stepped_and_resumed_by_service(graph, tmp_path):
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    clocks = graph.collect(Clock, "/clock", READ_QOS)
    bag = split_bag(tmp_path / "bag")
    with running(REPLAY, bag, "--wait", 10, "--start-paused", "--clock", 50) as process:
        assert ask(graph, Trigger, "step", Trigger.Request()).success
        graph.spin_until(lambda: len(heard) == 1, "one message")
        for _ in range(2):
            ask(graph, Trigger, "step", Trigger.Request())
        graph.spin_until(lambda: len(heard) == 3, "two more")
        assert ask(graph, SetBool, "pause", SetBool.Request(data=False)).success
        graph.spin_until(lambda: len(heard) > 20, "it goes on")
        refused = ask(graph, Trigger, "step", Trigger.Request())
        assert (refused.success, refused.message[:26]) == (False, "the replay is not paused: ")
        assert ask(graph, SetBool, "pause", SetBool.Request(data=True)).success
        pass_time(graph, 0.3)  # what was on its way
        count = len(heard)
        pass_time(graph, 0.5)
        assert len(heard) == count
        ask(graph, SetBool, "pause", SetBool.Request(data=False))
        graph.spin_until(lambda: len(heard) == 250, "the end")
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert "longer than planned" not in out or "Replayed 250" in out
    assert stamps(heard) == [10_000_000 * (k + 1) for k in range(250)]
    told = [clock.clock.sec * 1_000_000_000 + clock.clock.nanosec for clock in clocks]
    assert told == sorted(told)
    assert told[-1] <= 2_500_000_000


def test_keys_pause_and_step(graph, tmp_path):
    heard = graph.collect(JointState, "/vo2/measurement", READ_QOS)
    bag = split_bag(tmp_path / "bag")
    program = f"import sys; from {REPLAY} import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, str(bag), "--wait", "10", "--start-paused"]
    child, terminal = pty.fork()
    if child == 0:
        os.execve(sys.executable, command, environment())
    try:
        said = b""
        while b"space pauses" not in said:
            said += os.read(terminal, 1024)
        os.write(terminal, b"s")
        graph.spin_until(lambda: len(heard) == 1, "one message")
        os.write(terminal, b"\x1b[C")
        graph.spin_until(lambda: len(heard) == 2, "another")
        os.write(terminal, b" ")
        graph.spin_until(lambda: len(heard) == 250, "the end")
    finally:
        os.kill(child, signal.SIGTERM)
        os.waitpid(child, 0)
        os.close(terminal)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["{bag}", "--duration", "inf"], "--duration"),
        (["{none}"], "found nothing there"),
        (["{bag}", "--topics", "/vo2/nonsense"], "/vo2/measurement"),
        (["{bag}", "--offset", "99"], "0.009 s long"),
        (["{bag}", "--rate", "0"], "--rate"),
        (["{bag}", "--loop", "0"], "--loop"),
        (["{bag}", "--wait", "-1"], "--wait"),
        (["{bag}", "--speed", "1"], "--speed"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, capsys, arguments, named):
    bag = write_bag(tmp_path / "bag", recording_of(10))
    assert replay.main([one.format(bag=bag, none=tmp_path / "none") for one in arguments]) == 2
    said = capsys.readouterr().err
    assert named in said
    assert len(said.strip().splitlines()) == 1


def test_help_is_sentences(capsys):
    with pytest.raises(SystemExit, match="0"):
        replay.main(["--help"])
    said = capsys.readouterr().out
    for option in ("--rate", "--loop", "--offset", "--duration", "--topics", "--clock", "--wait"):
        assert option in said
