"""Bags that somebody made to harm: each is read in bounded memory and time, or refused in one line."""

from __future__ import annotations

import os
import sqlite3
import struct
import time
import tracemalloc
from contextlib import closing, contextmanager

import lz4.frame
import numpy as np
import pytest
from bag_makers import JOINT_STATE, Sample, bag_by_rosbags, joint_state, measurements
from vo2_identification.bags import BagError, BagWriter, read_recording, reading
from vo2_identification.bags.decompression import zstd
from vo2_identification.bags.joint_state import encode

SAMPLES = measurements(50)
MB = 1 << 20


@contextmanager
def bounded(*, most_mb=120.0, most_s=5.0):
    """Fail where the block takes more memory or processor time."""
    tracemalloc.start()
    began = time.process_time()
    try:
        yield
        took, peak = time.process_time() - began, tracemalloc.get_traced_memory()[1] / MB
    finally:
        tracemalloc.stop()
    assert took < most_s
    assert peak < most_mb


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value):
    return struct.pack("<I", len(value)) + value


def mcap(path, *records):
    path.write_bytes(b"\x89MCAP0\r\n" + b"".join(records) + record(0x02, bytes(20)) + b"\x89MCAP0\r\n")
    return path


def chunk(records, compression=b"", packed=None):
    head = struct.pack("<QQQI", 0, 0, len(records), 0) + text(compression)
    packed = records if packed is None else packed
    return record(0x04 + 2, head + struct.pack("<Q", len(packed)) + packed)


def topic_records(name=b"/vo2/measurement"):
    schema = record(0x03, struct.pack("<H", 1) + text(JOINT_STATE.encode()) + text(b"ros2msg") + text(b""))
    return schema + record(0x04, struct.pack("<HH", 1, 1) + text(name) + text(b"cdr") + struct.pack("<I", 0))


def message_record(data):
    return record(0x05, struct.pack("<HIQQ", 1, 0, 0, 0) + data)


def pack(data, compression):
    return zstd.compress(data) if compression == b"zstd" else lz4.frame.compress(data)


def test_an_alias_bomb_in_metadata_is_reported_in_a_short_line(tmp_path):
    bag = bag_by_rosbags(tmp_path / "bag", SAMPLES)
    lines = ["a: &a [" + ",".join("x" * 10) + "]"]
    lines += [f"{b}: &{b} [{','.join(['*' + a] * 10)}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
    (bag / "metadata.yaml").write_text("\n".join(lines) + "\nrosbag2_bagfile_information: *i\n")
    with bounded():
        recording, problems = read_recording(bag)
    assert len(recording) == 50
    (problem,) = (each for each in problems if each.kind == "metadata")
    assert "line 5: found more than 100000 values" in str(problem) and len(str(problem)) < 600


@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
def test_a_bomb_in_a_chunk_is_cut_and_what_is_around_it_is_read(tmp_path, compression):
    good = topic_records() + b"".join(message_record(joint_state(sample)) for sample in SAMPLES)
    bomb = record(0x7F, bytes(700 * MB))
    file = mcap(
        tmp_path / "bag_0.mcap",
        chunk(good, compression, pack(good, compression)),
        chunk(bomb, compression, pack(bomb, compression)),
        chunk(good, compression, pack(good, compression)),
    )
    del bomb
    assert file.stat().st_size < 4 * MB
    with bounded(most_mb=600):
        recording, problems = read_recording(file)
    assert len(recording) == 50  # the second time they are repeats
    assert any("MB, at most that is read" in str(problem) for problem in problems)


def test_a_bomb_as_a_compressed_file_is_cut(tmp_path):
    bag = bag_by_rosbags(tmp_path / "bag", SAMPLES, compression="FILE")
    (file,) = bag.glob("*.zstd")
    plain = zstd.decompress(file.read_bytes())
    file.write_bytes(zstd.compress(plain + bytes(900 * MB)))
    with bounded():
        recording, problems = read_recording(bag)
    assert len(recording) == 50
    assert any(problem.kind == "truncated" and "at most that is read" in problem.text for problem in problems)


def test_bombs_as_compressed_messages_are_reported(tmp_path):
    bomb = zstd.compress(bytes(300 * MB))
    file = mcap(
        tmp_path / "bag_0.mcap",
        chunk(topic_records() + 20 * message_record(bomb) + message_record(joint_state(SAMPLES[0]))),
    )
    with bounded():
        recording, problems = read_recording(file)
    assert len(recording) == 1
    assert any("message 0 of the file cannot be decompressed: it expands" in str(each) for each in problems)


@pytest.mark.parametrize("name", ["bag_0.mcap", "bag_0.db3", "bag_0.mcap.zstd", "metadata.yaml"])
def test_a_fifo_or_a_device_in_place_of_a_file_is_named_and_not_opened(tmp_path, name):
    bag = bag_by_rosbags(tmp_path / "bag", SAMPLES)
    for place in bag.iterdir():
        if name != "metadata.yaml" or place.name == name:
            place.unlink()
    os.mkfifo(bag / name)
    if name == "metadata.yaml":
        _, problems = read_recording(bag)
        assert any("metadata.yaml: found a FIFO" in str(problem) for problem in problems)
    else:
        with pytest.raises(ValueError, match=f"{name}: found a FIFO, need a regular file"):
            read_recording(bag)
        with pytest.raises(ValueError, match=f"{name}: found a FIFO"):
            read_recording(bag / name)
        (bag / name).unlink()
        (bag / name).symlink_to("/dev/zero")
        with pytest.raises(ValueError, match="found a device file"):
            read_recording(bag)


def test_a_record_that_announces_more_than_there_is_costs_nothing(tmp_path):
    for opcode in (0x03, 0x05, 0x06):
        file = mcap(tmp_path / "bag_0.mcap", chunk(topic_records()), struct.pack("<BQ", opcode, 1 << 62))
        with bounded(most_mb=20), pytest.raises(BagError, match="found no samples"):
            read_recording(file)


def test_a_layout_or_a_fault_of_its_own_in_every_message_does_not_slow_down_the_reading(tmp_path):
    names = [f"x{k:05d}" for k in range(20_000)]
    good = [joint_state(Sample("", k, (name,), (1.0,), f"d{k:05d}")) for k, name in enumerate(names)]
    bad = [bytes(4) + name.encode() for name in names]
    file = mcap(tmp_path / "bag_0.mcap", chunk(topic_records() + b"".join(map(message_record, good + bad))))
    began = time.process_time()
    recording, problems = read_recording(file)
    assert time.process_time() - began < 10.0
    assert len(recording) == 20_000
    assert any("19900 more of kind malformed" in str(problem) for problem in problems)


def test_names_in_huge_numbers_are_no_message(tmp_path):
    data = (
        b"\x00\x01"
        + bytes(10)
        + struct.pack("<I", 1)
        + bytes(4)
        + struct.pack("<I", 1 << 24)
        + bytes(64 * MB)
    )
    file = mcap(tmp_path / "bag_0.mcap", chunk(topic_records() + message_record(data)))
    with pytest.raises(BagError, match="announces 16777216 names"):
        read_recording(file)


@pytest.mark.parametrize(
    "tables",
    [
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(100) AS data FROM n",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER)",
    ],
)
def test_a_database_that_computes_its_messages_is_refused(tmp_path, tables):
    with closing(sqlite3.connect(tmp_path / "bag_0.db3")) as base:
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        base.execute("INSERT INTO topics VALUES(1, '/vo2/measurement', ?)", (JOINT_STATE,))
        base.execute(tables)
        base.commit()
    with bounded(), pytest.raises(BagError, match=r"need a \.db3 file of rosbag2"):
        read_recording(tmp_path / "bag_0.db3")


def test_rows_of_other_kinds_are_counted_and_the_messages_read(tmp_path):
    bag = bag_by_rosbags(tmp_path / "bag", SAMPLES, storage="sqlite3")
    (file,) = bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as base:
        base.execute("UPDATE messages SET data = 'text' WHERE id = 3")
        base.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 4")
        base.commit()
    recording, problems = read_recording(bag)
    assert len(recording) == 48
    assert any("2 rows are no messages" in str(problem) for problem in problems)


def test_file_names_that_only_look_like_numbers_are_sorted(tmp_path):
    bag = bag_by_rosbags(tmp_path / "bag", SAMPLES)
    (bag / "bag_\N{SUPERSCRIPT TWO}.mcap").write_bytes(b"")
    (bag / "metadata.yaml").unlink()
    assert len(read_recording(bag)[0]) == 50


def large_bag(path, *, megabytes, storage):
    """A bag of as many megabytes of a topic that nobody wants, and 20 000 samples."""
    wanted = encode(
        np.arange(20_000) * 1_000_000, ["heater_current", "noise"], np.zeros((20_000, 2)), "integrated"
    )
    bulk = bytes(MB // 4)
    with BagWriter(path, storage=storage, flush_period_s=np.inf) as bag:
        sample, other = (
            bag.add_topic("/vo2/measurement", JOINT_STATE),
            bag.add_topic("/camera", "std_msgs/msg/String"),
        )
        for k, data in enumerate(wanted):
            bag.write(sample, k * 1_000_000, data)
            if k % (20_000 // (4 * megabytes)) == 0:
                bag.write(other, k * 1_000_000, bulk)
    return path


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("megabytes", [64, pytest.param(2000, marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_size_of_a_bag(tmp_path, storage, megabytes):
    bag = large_bag(tmp_path / "bag", megabytes=megabytes, storage=storage)
    size = sum(each.stat().st_size for each in bag.iterdir()) / MB
    assert size > megabytes
    read_recording(bag)  # what is imported does not count
    tracemalloc.start()
    recording, _ = read_recording(bag)
    peak = tracemalloc.get_traced_memory()[1] / MB
    tracemalloc.stop()
    print(f"bag of {size:.0f} MB ({storage}), 20 000 samples wanted: {peak:.1f} MB of memory at most")
    assert len(recording) == 20_000
    assert peak < 25


def test_more_than_is_held_in_memory_is_refused_in_one_line(tmp_path, monkeypatch):
    """A bag may be of any size: it is read until more is held than is stated."""
    bag = bag_by_rosbags(tmp_path / "bag", measurements(300))
    held = 300 * (1 + len(measurements(1)[0].names))
    monkeypatch.setattr(reading, "_LOOK_EVERY", 50)
    monkeypatch.setattr(reading, "_MOST_VALUES", 100 * held)
    assert len(read_recording(bag)[0]) == 300
    monkeypatch.setattr(reading, "_MOST_VALUES", held // 2)
    with pytest.raises(
        BagError, match=r"bag: found .* million stamps and values after \d+ messages, need at"
    ) as told:
        read_recording(bag)
    assert len(str(told.value).splitlines()) == 1
