"""What is written: read back bit for bit, by rosbags too, whole at any time, honest about a full disk."""

from __future__ import annotations

import resource
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_makers import STORE
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from vo2_identification.bags import BagError, BagWriter, read_bag, read_recording, write_bag
from vo2_identification.bags.joint_state import encode
from vo2_models.recording import Recording

JOINT_STATE = "sensor_msgs/msg/JointState"
STORAGES = ["mcap", "sqlite3"]


def recording_of(n, seed=0):
    rng = np.random.default_rng(seed)
    channels = {
        "heater_current": rng.uniform(3e-3, 9e-3, n),
        "film_resistance": 10 ** rng.uniform(4, 5.3, n),
        "tip_deflection": rng.uniform(0, 6e-5, n),
        "commanded_current": np.concatenate(([np.nan], rng.uniform(3e-3, 9e-3, n - 1))),
    }
    return Recording(np.arange(n) / 1000, channels, "integrated")


def read_by_rosbags(path):
    with Reader(path) as bag:
        return [
            (connection.topic, time, STORE.deserialize_cdr(data, connection.msgtype))
            for connection, time, data in bag.messages()
        ]


@pytest.mark.parametrize("storage", STORAGES)
def test_what_was_written_is_read_bit_for_bit(tmp_path, storage):
    written = recording_of(5000)
    read, problems = read_recording(write_bag(tmp_path / "bag", written, storage=storage))
    assert problems == []
    assert read.device == "integrated"
    np.testing.assert_array_equal(read.time_s, written.time_s)
    assert set(read.channels) == set(written.channels)
    for name in written.channels:
        np.testing.assert_array_equal(read[name], written[name])


@pytest.mark.parametrize("storage", STORAGES)
def test_rosbags_reads_values_qos_types_and_hashes(tmp_path, storage):
    written = recording_of(9000)  # more than one chunk
    path = write_bag(
        tmp_path / "bag", {"measurement": written, "reference": written.slice(0, 3)}, storage=storage
    )
    messages = read_by_rosbags(path)
    measured = [(time, message) for topic, time, message in messages if topic == "/vo2/measurement"]
    assert len(measured) == 9000
    assert [time for time, _ in measured] == [k * 1_000_000 for k in range(9000)]
    for name in ("heater_current", "film_resistance", "tip_deflection"):
        column = measured[0][1].name.index(name)
        np.testing.assert_array_equal([message.position[column] for _, message in measured], written[name])
    assert measured[1234][1].header.frame_id == "integrated"
    assert measured[1234][1].header.stamp.nanosec == 234_000_000
    with Reader(path) as bag:
        assert bag.message_count == 9000 + 3 + 8999
        assert bag.duration == 8_999_000_001
        topics = {connection.topic: connection for connection in bag.connections}
        assert set(topics) == {"/vo2/measurement", "/vo2/reference", "/vo2/command"}
        for topic, connection in topics.items():
            assert connection.msgtype == JOINT_STATE
            assert connection.digest == STORE.hash_rihs01(JOINT_STATE)
            assert "string[] name" in connection.msgdef.data
            assert "MSG: std_msgs/Header" in connection.msgdef.data
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.reliability is QosReliability.RELIABLE
            assert qos.depth == 100
            latched = topic == "/vo2/reference"
            assert qos.durability is (QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE)


@pytest.mark.parametrize("storage", STORAGES)
def test_the_storage_file_alone_is_complete_for_rosbags(tmp_path, storage):
    path = write_bag(tmp_path / "bag", recording_of(20), storage=storage)
    (file,) = (one for one in path.iterdir() if one.name != "metadata.yaml")
    with Reader(file) as bag:
        assert bag.message_count == 20 + 19
        assert {connection.topic for connection in bag.connections} == {"/vo2/measurement", "/vo2/command"}


@pytest.mark.parametrize("storage", STORAGES)
def test_the_same_recordings_make_the_same_files_byte_for_byte(tmp_path, storage):
    contents = []
    for parent in ("a", "b"):
        path = write_bag(tmp_path / parent / "bag", recording_of(12000), storage=storage)
        contents.append({one.name: one.read_bytes() for one in path.iterdir()})
    assert contents[0] == contents[1]


def test_messages_of_one_stamp_stand_in_the_order_of_the_loop(tmp_path):
    loop = {role: recording_of(3) for role in ("command", "estimate", "measurement", "reference")}
    topics = [topic for topic, _, _ in read_by_rosbags(write_bag(tmp_path / "bag", loop))]
    assert topics[:4] == ["/vo2/reference", "/vo2/measurement", "/vo2/estimate", "/vo2/command"]


@pytest.mark.parametrize("storage", STORAGES)
def test_the_bag_is_whole_after_every_flush(tmp_path, storage):
    bag = BagWriter(tmp_path / "bag", storage=storage, flush_period_s=1e9)
    topic = bag.add_topic("/vo2/measurement", JOINT_STATE)
    messages = [
        message for _, _, message in read_by_rosbags(write_bag(tmp_path / "source", recording_of(40)))
    ]
    raw = [bytes(STORE.serialize_cdr(message, JOINT_STATE)) for message in messages[::2]]
    for k in range(30):
        bag.write(topic, k * 1_000_000, raw[k])
        if k % 10 == 9:
            bag.flush()
            # the process could be killed here: its files, as they are, are a bag that needs no rescue
            copy = shutil.copytree(tmp_path / "bag", tmp_path / f"copy{k}")
            assert len(read_by_rosbags(copy)) == k + 1
            recording, problems = read_recording(copy)
            assert len(recording) == k + 1
            assert [p.kind for p in problems if p.kind != "missing_topic"] == []
            information = yaml.safe_load((copy / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
            assert information["message_count"] == k + 1
    bag.close()
    bag.close()


def test_a_bag_is_readable_from_its_first_moment(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 0
    bag.close()
    assert read_bag(tmp_path / "bag")[0] == {}


def test_old_messages_reach_the_disk_without_being_asked(tmp_path):
    bag = BagWriter(tmp_path / "bag", flush_period_s=0.0)
    topic = bag.add_topic("/vo2/measurement", JOINT_STATE)
    bag.write(topic, 0, b"\x00\x01\x00\x00" + bytes(40))
    assert bag.count == 1
    bag.close()


@contextmanager
def file_size_limit(size):
    # stands in for a full disk: the kernel refuses to let any file of this process grow beyond
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("storage", STORAGES)
def test_a_full_disk_is_said_and_leaves_a_readable_bag(tmp_path, storage):
    raw = encoded_measurement()
    bag = BagWriter(tmp_path / "bag", storage=storage, flush_period_s=1e9)
    topic = bag.add_topic("/vo2/measurement", JOINT_STATE)
    written = 0
    with file_size_limit(150_000), pytest.raises(OSError):
        for _ in range(100):
            for _ in range(50):
                bag.write(topic, written * 1_000_000, raw)
                written += 1
            bag.flush()
    on_disk = bag.count
    assert 100 < on_disk < written
    assert on_disk % 50 == 0
    bag.close()
    assert len(read_by_rosbags(tmp_path / "bag")) == on_disk
    recording_problems = read_bag(tmp_path / "bag")[1]
    assert not [p for p in recording_problems if p.kind in {"truncated", "corrupt", "metadata"}]


def encoded_measurement():
    from vo2_identification.bags.joint_state import encode

    return encode(np.zeros(1, np.int64), ("heater_current",), np.zeros((1, 1)), "integrated")[0]


@pytest.mark.parametrize("storage", STORAGES)
def test_what_cannot_be_written_is_refused_with_the_remedy(tmp_path, storage):
    (tmp_path / "there").mkdir()
    (tmp_path / "file").write_text("x")
    with pytest.raises(BagError, match="there: exists already"):
        BagWriter(tmp_path / "there", storage=storage)
    with pytest.raises(BagError, match="cannot be created"):
        BagWriter(tmp_path / "file" / "bag", storage=storage)
    with pytest.raises(BagError, match="mcap or sqlite3"):
        BagWriter(tmp_path / "new", storage="rosbag1")
    with pytest.raises(BagError, match="nonsense"):
        write_bag(tmp_path / "new", {"nonsense": recording_of(3)}, storage=storage)
    assert not Path(tmp_path / "new").exists()


@settings(max_examples=25, deadline=None)
@given(
    steps=st.lists(st.integers(1, 10**10), min_size=1, max_size=30),
    seed=st.integers(0, 2**32 - 1),
    storage=st.sampled_from(STORAGES),
)
def test_any_increasing_stamps_and_values_survive(tmp_path_factory, steps, seed, storage):
    time_s = np.cumsum(steps) / 1e9
    values = np.random.default_rng(seed).standard_normal(len(steps)) * 10.0 ** (seed % 30 - 15)
    written = Recording(time_s, {"film_resistance": values}, "rig")
    path = write_bag(tmp_path_factory.mktemp("any") / "bag", written, storage=storage)
    read, _ = read_recording(path)
    np.testing.assert_array_equal(read.time_s, time_s)
    np.testing.assert_array_equal(read["film_resistance"], values)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("split", [{"split_bytes": 100_000}, {"split_s": 2.0}, {}])
def test_a_split_and_compressed_bag_is_one_bag_for_every_reader(tmp_path, compression, split):
    samples = [
        encode([k * 1_000_000], ["heater_current"], np.array([[k * 1e-6]]), "x")[0] for k in range(5000)
    ]
    with BagWriter(tmp_path / "bag", compression=compression, **split) as bag:
        numbers = [bag.add_topic(topic, JOINT_STATE) for topic in ("/vo2/measurement", "/vo2/command")]
        for k, data in enumerate(samples):
            bag.write(numbers[k % 2], k * 1_000_000, data)
        assert bag.counts == {"/vo2/measurement": 2500, "/vo2/command": 2500} or bag.count < 5000
    assert bag.count == 5000
    files = sorted(tmp_path.glob("bag/*.mcap"))
    assert [file.name for file in files] == [f"bag_{k}.mcap" for k in range(len(files))]
    expected = {"split_bytes": range(2, 12), "split_s": [3]}.get(next(iter(split), ""), [1])
    assert len(files) in expected
    if split.get("split_bytes") and compression == "none":
        assert max(file.stat().st_size for file in files) < 1.1 * split["split_bytes"]
    if compression != "none" and not split:
        # 47 bytes a message are its head and its entry in the index
        assert files[0].stat().st_size < 0.6 * sum(len(data) + 47 for data in samples)
    by_rosbags = read_by_rosbags(tmp_path / "bag")
    assert [time for _, time, _ in by_rosbags] == [k * 1_000_000 for k in range(5000)]
    assert [message.position[0] for _, _, message in by_rosbags] == [k * 1e-6 for k in range(5000)]
    ours, problems = read_bag(tmp_path / "bag")
    assert {problem.kind for problem in problems} == {"missing_topic"}
    assert [len(ours[role]) for role in ("measurement", "command")] == [2500, 2500]
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["message_count"] == 5000
    assert sum(file["message_count"] for file in information["files"]) == 5000


def test_what_sqlite_cannot_do_is_one_line_and_leaves_nothing(tmp_path):
    with pytest.raises(BagError, match="found sqlite3, need mcap"):
        BagWriter(tmp_path / "bag", storage="sqlite3", compression="zstd")
    assert not (tmp_path / "bag").exists()
