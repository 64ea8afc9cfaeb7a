"""Bags that were cut short, overwritten or lost a part: what can be read is read, the rest is named."""

from __future__ import annotations

import sqlite3

import numpy as np
import pytest
from bag_makers import bag_by_rosbags, measurements
from vo2_identification.bags import BagError, read_recording

SAMPLES = measurements(400)


def mcap_of(path, **options):
    (file,) = bag_by_rosbags(path, SAMPLES, **options).glob("*.mcap*")
    return file


def expect_first(recording, count):
    """The recording holds exactly the first `count` samples, undamaged."""
    assert len(recording) == count
    np.testing.assert_array_equal(recording.time_s, np.arange(count) / 1000)
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - np.arange(count))


def chunks_of(file):
    """Return (offset, length) of every chunk record: its length stands behind its type."""
    data, position, found = file.read_bytes(), 8, []
    while data[position] != 0x0F:
        length = 9 + int.from_bytes(data[position + 1 : position + 9], "little")
        if data[position] == 0x06:
            found.append((position, length))
        position += length
    return found


@pytest.mark.parametrize("compression", ["NONE", "STORAGE"])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_a_truncated_mcap_is_read_up_to_the_cut(tmp_path, compression, share):
    file = mcap_of(tmp_path / "bag", compression=compression, chunk=100)
    start, length = chunks_of(file)[2]
    file.write_bytes(file.read_bytes()[: start + int(share * length)])
    recording, problems = read_recording(file.parent)
    (cut,) = (problem for problem in problems if problem.kind == "truncated")
    assert (cut.topic, cut.index) == (file.name, start)
    assert f"{len(recording)} messages" in cut.text
    # a compressed block opens only as a whole: then the chunks before the cut are what is left
    expected = 200 + (int(100 * share) if compression == "NONE" else 0)
    assert expected - 2 <= len(recording) <= expected
    expect_first(recording, len(recording))


def test_every_length_of_a_small_file_is_survived(tmp_path):
    file = mcap_of(tmp_path / "bag", chunk=150)
    whole = file.read_bytes()
    counts = []
    for size in range(0, len(whole), 997):
        file.write_bytes(whole[:size])
        try:
            recording, problems = read_recording(file)
        except BagError as error:
            assert size < 2000, error  # no message yet
            continue
        assert [problem.kind for problem in problems if problem.kind == "truncated"]
        expect_first(recording, len(recording))
        counts.append(len(recording))
    assert counts == sorted(counts)
    assert counts[-1] == 400


def test_a_missing_index_alone_loses_no_message(tmp_path):
    file = mcap_of(tmp_path / "bag", chunk=100)
    file.write_bytes(file.read_bytes()[:-40])
    recording, problems = read_recording(file)
    expect_first(recording, 400)
    assert [problem.kind for problem in problems if problem.kind != "missing_topic"] == ["truncated"]


def test_zeros_after_a_power_cut_end_the_reading(tmp_path):
    file = mcap_of(tmp_path / "bag", chunk=100)
    start, length = chunks_of(file)[2]
    whole = file.read_bytes()
    valid = start + length // 2
    file.write_bytes(whole[:valid] + bytes(len(whole) - valid))
    recording, problems = read_recording(file)
    assert 248 <= len(recording) <= 250
    expect_first(recording, len(recording))
    assert any(problem.kind == "truncated" for problem in problems)


def test_a_damaged_compressed_chunk_costs_only_itself(tmp_path):
    file = mcap_of(tmp_path / "bag", compression="STORAGE", chunk=100)
    start, length = chunks_of(file)[1]
    whole = bytearray(file.read_bytes())
    whole[start + length // 2 : start + length // 2 + 60] = bytes(60)
    file.write_bytes(whole)
    recording, problems = read_recording(file)
    (corrupt,) = (problem for problem in problems if problem.kind == "corrupt")
    assert start < corrupt.index < start + length
    kept = np.rint(recording.time_s * 1000).astype(int).tolist()
    assert kept == [*range(100), *range(200, 400)]


def test_a_checksum_that_does_not_match_leaves_the_chunk_out(tmp_path):
    file = mcap_of(tmp_path / "bag", chunk=100)
    whole = bytearray(file.read_bytes())
    checksum = chunks_of(file)[0][0] + 9 + 24
    whole[checksum : checksum + 4] = b"\x01\x02\x03\x04"
    file.write_bytes(whole)
    with pytest.raises(BagError, match="checksum"):
        # rosbags announces the topic in the first chunk: without it nothing can be read, and that is said
        read_recording(file)


def test_a_file_compressed_bag_cut_short_is_read_up_to_the_cut(tmp_path):
    path = bag_by_rosbags(tmp_path / "bag", measurements(4000), compression="FILE")
    (file,) = path.glob("*.zstd")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) * 3 // 4])
    recording, problems = read_recording(path)
    assert {problem.topic for problem in problems if problem.kind == "truncated"} >= {file.name}
    assert 1000 < len(recording) < 4000
    expect_first(recording, len(recording))


@pytest.mark.parametrize("text", ["", "no: yaml: at: all", "rosbag2_bagfile_information: {}", "- 1"])
def test_useless_metadata_is_reported_and_the_files_read(tmp_path, text):
    path = bag_by_rosbags(tmp_path / "bag", SAMPLES)
    (path / "metadata.yaml").write_text(text)
    recording, problems = read_recording(path)
    expect_first(recording, 400)
    assert [problem.kind for problem in problems if problem.kind != "missing_topic"] == ["metadata"]


def test_a_file_of_a_split_bag_that_is_gone_is_named(tmp_path):
    path = bag_by_rosbags(tmp_path / "bag", SAMPLES)
    metadata = (path / "metadata.yaml").read_text()
    listed = "relative_file_paths:\n  - bag.mcap"
    assert listed in metadata
    (path / "metadata.yaml").write_text(metadata.replace(listed, listed + "\n  - bag_1.mcap"))
    recording, problems = read_recording(path)
    expect_first(recording, 400)
    assert [(p.kind, p.topic) for p in problems if p.kind != "missing_topic"] == [
        ("missing_file", "bag_1.mcap")
    ]


def test_a_truncated_sqlite_bag_gives_what_is_left(tmp_path):
    path = bag_by_rosbags(tmp_path / "bag", measurements(3000), storage="sqlite3")
    (file,) = path.glob("*.db3")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    recording, problems = read_recording(path)
    assert any(problem.kind == "truncated" for problem in problems)
    # the page that the cut goes through may lose rows before those of a page that came whole
    assert 1000 < len(recording) < 3000
    number = np.rint(recording.time_s * 1000)
    np.testing.assert_array_equal(number[:1000], np.arange(1000))
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - number)


@pytest.mark.parametrize("mode", ["WAL", "DELETE"])
def test_a_killed_sqlite_recorder_loses_only_its_open_transaction(tmp_path, mode):
    path = bag_by_rosbags(tmp_path / "bag", SAMPLES, storage="sqlite3")
    (file,) = path.glob("*.db3")
    killed = tmp_path / "killed"
    killed.mkdir()
    with sqlite3.connect(file) as database:
        database.execute(f"PRAGMA journal_mode={mode}")
        database.execute("PRAGMA cache_size=2")  # so that the open transaction spills into the file
        database.execute("DELETE FROM messages WHERE id > 300")
        database.commit()
        # open and never finished, as a killed process leaves it
        database.execute("UPDATE messages SET data = zeroblob(200)")
        for one in path.iterdir():
            (killed / one.name).write_bytes(one.read_bytes())
        database.rollback()
    names = {one.suffix for one in killed.iterdir()}
    assert names & {".db3-wal", ".db3-journal"}
    recording, problems = read_recording(killed)
    expect_first(recording, 300)
    assert any(problem.kind == "truncated" for problem in problems)
    assert names == {one.suffix for one in killed.iterdir()}  # the bag itself is not touched
