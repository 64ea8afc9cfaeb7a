"""The reader against bags written by rosbags: storages, compressions, orders, names, disorder."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from bag_makers import Sample, bag_by_rosbags, measurements
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_identification.bags import BagError, read_bag, read_recording
from vo2_identification.bags.joint_state import JointStates, encode
from vo2_identification.bags.reading import commanded_current
from vo2_models.device.description import described
from vo2_models.identification.grid import on_grid
from vo2_models.recording import aligned, regular

KINDS = [
    ("mcap", "NONE"),
    ("mcap", "FILE"),
    ("mcap", "MESSAGE"),
    ("mcap", "STORAGE"),
    ("sqlite3", "NONE"),
    ("sqlite3", "FILE"),
    ("sqlite3", "MESSAGE"),
]


def kinds_of(problems):
    return [problem.kind for problem in problems if problem.kind != "missing_topic"]


@pytest.mark.parametrize(("storage", "compression"), KINDS)
@pytest.mark.parametrize("metadata", [True, False])
def test_every_storage_and_compression_gives_the_same_recording(tmp_path, storage, compression, metadata):
    path = bag_by_rosbags(
        tmp_path / "bag",
        measurements(300),
        storage=storage,
        compression=compression,
        chunk=70 * (storage == "mcap"),
    )
    if not metadata:
        (path / "metadata.yaml").unlink()
    recording, problems = read_recording(path)
    assert kinds_of(problems) == ([] if metadata else ["metadata"])
    np.testing.assert_array_equal(recording.time_s, np.arange(300) / 1000)
    np.testing.assert_array_equal(recording["heater_current"], 1e-3 * np.arange(300))
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - np.arange(300))
    assert recording.device == "integrated"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_single_file_is_read_as_its_bag_is(tmp_path, storage):
    path = bag_by_rosbags(tmp_path / "bag", measurements(50), storage=storage)
    (file,) = (one for one in path.iterdir() if one.suffix in {".mcap", ".db3"})
    from_file, problems = read_recording(file)
    assert kinds_of(problems) == []
    np.testing.assert_array_equal(from_file["film_resistance"], read_recording(path)[0]["film_resistance"])


def test_split_bags_without_metadata_are_read_in_numerical_order(tmp_path):
    samples = measurements(110)
    target = tmp_path / "bag"
    target.mkdir()
    for k in range(11):
        part = bag_by_rosbags(tmp_path / f"part{k}", samples[10 * k : 10 * k + 10])
        shutil.copy(next(part.glob("*.mcap")), target / f"bag_{k}.mcap")
    recording, problems = read_recording(target)
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - np.arange(110))
    assert kinds_of(problems) == ["metadata"]


def test_channels_in_any_order_unknown_ignored_absent_nan(tmp_path):
    topic = "/vo2/measurement"
    samples = [
        Sample(topic, 0, ("film_resistance", "heater_current"), (10.0, 0.1)),
        Sample(topic, 1_000_000, ("heater_current", "film_resistance", "humidity"), (0.2, 20.0, 5.0)),
        Sample(topic, 2_000_000, ("heater_current",), (0.3,)),
        Sample(topic, 3_000_000, ("heater_current", "film_resistance"), (0.4, 40.0)),
    ]
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert set(recording.channels) == {"heater_current", "film_resistance"}
    np.testing.assert_array_equal(recording["heater_current"], [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(recording["film_resistance"], [10.0, 20.0, np.nan, 40.0])
    (absent,) = (problem for problem in problems if problem.kind == "absent_channel")
    assert absent.index == 2
    assert absent.time_s == 0.002
    assert "film_resistance" in absent.text


def test_nan_and_infinity_are_kept_as_nan_and_reported_with_place(tmp_path):
    samples = measurements(10)
    for k in (3, 4):
        samples[k] = samples[k]._replace(values=(samples[k].values[0], np.nan))
    samples[7] = samples[7]._replace(values=(np.inf, samples[7].values[1]))
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert np.flatnonzero(np.isnan(recording["film_resistance"])).tolist() == [3, 4]
    assert np.flatnonzero(np.isnan(recording["heater_current"])).tolist() == [7]
    found = {(problem.index, problem.time_s) for problem in problems if problem.kind == "nan"}
    assert found == {(3, 0.003), (7, 0.007)}


def test_a_gap_is_reported_where_it_begins(tmp_path):
    samples = measurements(100)
    del samples[40:45]
    _, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    (gap,) = (problem for problem in problems if problem.kind == "gap")
    assert (gap.index, gap.time_s) == (39, 0.039)
    assert "0.006 s" in gap.text


def test_many_problems_of_one_kind_are_counted_not_listed(tmp_path):
    samples = [sample for k, sample in enumerate(measurements(400)) if k % 10 != 9]
    _, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert kinds_of(problems) == ["gap"] * 20 + ["more"]
    assert "19 more" in problems[-2].text or "19 more" in problems[-1].text


def test_stray_stamps_are_left_out_one_by_one(tmp_path):
    samples = measurements(200)
    samples[50] = samples[50]._replace(stamp_ns=10_500_000)
    samples[120] = samples[120]._replace(stamp_ns=9_000_000_000)  # a jump forward that never comes back
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert len(recording) == 198
    stray = [problem for problem in problems if problem.kind == "non_monotonic"]
    assert [problem.index for problem in stray] == [50, 120]
    assert stray[0].time_s == 0.0105


def test_a_clock_set_back_keeps_the_longest_run_and_names_the_others(tmp_path):
    samples = measurements(60) + measurements(140)
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert len(recording) == 140
    np.testing.assert_array_equal(recording["heater_current"], 1e-3 * np.arange(140))
    (restart,) = (problem for problem in problems if problem.kind == "restart")
    assert restart.index == 0
    assert "60 samples" in restart.text


def test_exact_repeats_are_no_problem_but_other_values_at_the_same_stamp_are(tmp_path):
    samples = measurements(20)
    repeated = samples[:11] + [samples[10]] * 3 + samples[11:]
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "a", repeated))
    assert len(recording) == 20
    assert kinds_of(problems) == []
    contradicting = [*samples[:11], samples[10]._replace(values=(0.5, 1.0)), *samples[11:]]
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "b", contradicting))
    assert len(recording) == 20
    assert kinds_of(problems) == ["non_monotonic"]


def test_commanded_current_governs_the_interval_that_ends_at_the_sample(tmp_path):
    samples = []
    for k, sample in enumerate(measurements(6)):
        samples.append(sample)
        if k != 3:
            samples.append(Sample("/vo2/command", sample.stamp_ns, ("heater_current",), (10.0 + k,)))
    recording, _ = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    # interval k ends at t_k and was begun by the command stamped t_{k-1}; after a missing one the last holds
    np.testing.assert_array_equal(recording["commanded_current"], [np.nan, 10.0, 11.0, 12.0, 12.0, 14.0])


def test_a_sample_that_comes_late_is_not_taken_for_one_after_the_next_command():
    rng = np.random.default_rng(3)
    instants = 5.0 + 0.01 * np.arange(500)
    read = instants + rng.uniform(-2.5e-3, 2.5e-3, 500)
    commands = np.arange(500.0)
    governing = np.concatenate([[np.nan], commands[:-1]])
    np.testing.assert_array_equal(commanded_current(instants, commands, read), governing)
    np.testing.assert_array_equal(
        commanded_current(read, commands, read), governing
    )  # stamped with its sample
    np.testing.assert_array_equal(commanded_current(read, commands, instants), governing)  # late themselves
    kept = rng.random(500) > 0.05
    np.testing.assert_array_equal(commanded_current(instants, commands, read[kept]), governing[kept])


def test_commands_of_samples_that_were_not_logged_are_kept(tmp_path):
    samples = []
    for k, sample in enumerate(measurements(12)):
        if k not in (3, 6, 7):
            samples.append(sample)
        if k != 6:
            samples.append(Sample("/vo2/command", sample.stamp_ns, ("heater_current",), (10.0 + k,)))
    recording, _ = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    step = recording.sample_period_s
    assert recording.unread is not None
    np.testing.assert_allclose((recording.unread[0] - recording.time_s[0]) / step, [3, 6, 7], atol=1e-6)
    np.testing.assert_array_equal(recording.unread[1], [12.0, 15.0, 15.0])
    whole = regular(recording)
    np.testing.assert_array_equal(
        whole["commanded_current"][1:], [10, 11, 12, 13, 14, 15, 15, 17, 18, 19, 20]
    )
    assert np.flatnonzero(np.isnan(whole["film_resistance"])).tolist() == [3, 6, 7]
    one_later = aligned(recording, -step)
    np.testing.assert_allclose(
        one_later["commanded_current"][:-1], [10, 11, 12, 14, 15, 18, 19, 20], atol=1e-9
    )
    assert one_later.unread is not None
    np.testing.assert_allclose(one_later.unread[1], [13.0, 15.0, 17.0], atol=1e-9)
    assert recording.slice(0, 4).unread[0].size == 1


def test_where_commands_have_ended_the_log_says_what_drives(tmp_path):
    """A rig goes to its safe value after three periods without a command, and the recording goes on."""
    samples = []
    for k, sample in enumerate(measurements(40)):
        drive = 0.5 if 1 <= k < 24 else 0.0
        samples.append(sample._replace(values=(drive, sample.values[1])))
        if k < 20:
            samples.append(Sample("/vo2/command", sample.stamp_ns, ("heater_current",), (0.5,)))
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert np.flatnonzero(np.isnan(recording["commanded_current"])).tolist() == [0, *range(24, 40)]
    (said,) = (problem for problem in problems if problem.kind == "uncommanded")
    assert said.text.startswith("16 samples come more than 4 periods after")
    assert on_grid(recording).current.tolist() == [0.0] + 23 * [0.5] + 16 * [0.0]
    moved = aligned(recording, recording.sample_period_s)
    assert on_grid(moved).current[25:].tolist() == 15 * [0.0]
    # whoever commands now and then only means to be held
    few = [sample for sample in samples if sample.topic != "/vo2/command"] + [
        Sample("/vo2/command", 0, ("heater_current",), (0.5,))
    ]
    held, problems = read_recording(bag_by_rosbags(tmp_path / "few", few))
    assert np.flatnonzero(np.isnan(held["commanded_current"])).tolist() == [0]
    assert "uncommanded" not in kinds_of(problems)


def test_what_the_graph_recorded_is_read_for_a_device_with_names_of_its_own(tmp_path):
    device = described(
        {
            "schema": "vo2-device/1",
            "id": "stack",
            "drive": {"channel": "drive_voltage", "unit": "V", "limits": [0.0, 60.0]},
            "responses": {"extension": {"unit": "m"}},
        },
        "stack",
    )
    recordings = []
    for name, drive, response in (
        ("graph", "heater_current", "tip_deflection"),
        ("own", "drive_voltage", "extension"),
    ):
        samples = []
        for k in range(30):
            stamp = k * 1_000_000
            samples.append(Sample("/vo2/measurement", stamp, (drive, response), (1.0 * k, 1e-6 * k), "stack"))
            samples.append(Sample("/vo2/command", stamp, (drive,), (1.0 * k,), "stack"))
        recordings.append(read_recording(bag_by_rosbags(tmp_path / name, samples), device=device)[0])
    for channel in ("heater_current", "tip_deflection", "commanded_current"):
        for recording in recordings:
            np.testing.assert_array_equal(recording[channel], recordings[1][channel])
    np.testing.assert_array_equal(recordings[0]["commanded_current"][1:], np.arange(29.0))


def test_another_namespace_is_found_and_said(tmp_path):
    samples = measurements(5, topic="/rig_b/measurement")
    recording, problems = read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert len(recording) == 5
    (other,) = (problem for problem in problems if problem.kind == "other_namespace")
    assert other.topic == "/rig_b/measurement"
    _, problems = read_recording(tmp_path / "bag", namespace="/rig_b")
    assert kinds_of(problems) == []


def test_all_roles_are_read_and_missing_ones_reported(tmp_path):
    samples = [
        Sample(f"/vo2/{role}", k * 1_000_000, ("tip_deflection",), (k * 1e-6,))
        for k in range(4)
        for role in ("estimate", "reference")
    ]
    recordings, problems = read_bag(bag_by_rosbags(tmp_path / "bag", samples))
    assert set(recordings) == {"estimate", "reference"}
    np.testing.assert_array_equal(recordings["estimate"]["tip_deflection"], 1e-6 * np.arange(4))
    assert {problem.topic for problem in problems} == {"/vo2/command", "/vo2/measurement"}


def test_a_bag_without_measurement_is_refused_in_one_line(tmp_path):
    samples = [Sample("/vo2/estimate", 0, ("tip_deflection",), (0.0,))]
    with pytest.raises(BagError, match="/vo2/measurement") as caught:
        read_recording(bag_by_rosbags(tmp_path / "bag", samples))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("what", ["nothing", "text", "empty folder", "mcap of text"])
def test_what_is_no_bag_is_refused_with_its_name(tmp_path, what):
    path = tmp_path / {"mcap of text": "x.mcap"}.get(what, "x")
    if what == "empty folder":
        path.mkdir()
    elif what != "nothing":
        path.write_text("hello, this is not a bag")
    with pytest.raises(BagError, match=r"x.*need"):
        read_recording(path)


def test_big_endian_messages_are_read_too(tmp_path):
    path = bag_by_rosbags(tmp_path / "bag", measurements(5), little_endian=False)
    recording, problems = read_recording(path)
    np.testing.assert_array_equal(recording["film_resistance"], 1e5 - np.arange(5))
    assert kinds_of(problems) == []


def test_a_malformed_message_is_reported_and_the_others_read():
    collected = JointStates(["a"])
    good = encode(np.array([1, 2], np.int64), ("a",), np.array([[1.0], [2.0]]), "x")
    for data in (good[0], good[1][:30], good[1]):
        collected.add(data)
    samples = collected.samples()
    assert samples.stamp_ns.tolist() == [1, 2]
    assert samples.values["a"].tolist() == [1.0, 2.0]
    assert [index for index, _ in samples.malformed] == [1]


names_strategy = st.lists(
    st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1, max_size=9),
    max_size=5,
    unique=True,
)


@settings(max_examples=60, deadline=None)
@given(
    names=names_strategy,
    frame=st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12),
    stamps=st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=1, max_size=6),
    data=st.data(),
)
def test_encoding_agrees_with_rosbags_and_decoding_inverts_it(names, frame, stamps, data):
    from bag_makers import joint_state

    values = np.array(
        [data.draw(st.lists(st.floats(), min_size=len(names), max_size=len(names))) for _ in stamps]
    ).reshape(len(stamps), len(names))
    encoded = encode(np.array(stamps, np.int64), names, values, frame)
    collected = JointStates(names)
    for message in encoded:
        collected.add(message)
    samples = collected.samples()
    assert samples.stamp_ns.tolist() == stamps
    assert samples.frames == {frame: len(stamps)}
    for column, name in enumerate(names):
        np.testing.assert_array_equal(samples.values[name], values[:, column])
    # rosbags leaves velocity at the same length as position here: compare up to the end of the positions
    witness = joint_state(Sample("", stamps[0], names, values[0], frame))
    assert witness.startswith(encoded[0][:-8])


def test_reading_leaves_no_file_behind(tmp_path, monkeypatch):
    path = bag_by_rosbags(tmp_path / "bag", measurements(30), compression="FILE")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    before = sorted(Path(path).iterdir())
    read_recording(path)
    assert sorted(Path(path).iterdir()) == before
    assert not list(scratch.iterdir())
