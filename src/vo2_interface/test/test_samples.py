"""Samples on the wire: equal to the message classes, whatever the layout."""

import math
from array import array

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from vo2_interface.samples import (
    ClockWriter,
    SampleReader,
    SampleWriter,
    stamp_message,
)

NAMES = st.lists(st.text("abcdefgh_", min_size=1, max_size=24), unique=True, max_size=5)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)


def message(stamp_ns, names, values, device="integrated"):
    found = JointState()
    found.header.stamp = stamp_message(stamp_ns)
    found.header.frame_id = device
    found.name = list(names)
    found.position = array("d", values)
    return found


@settings(deadline=None)  # a sample takes microseconds, but a busy machine may take its time
@given(STAMPS, NAMES, st.text("xyz", max_size=9), st.data())
def test_what_is_written_is_what_the_message_class_reads(stamp_ns, names, device, data):
    values = data.draw(st.lists(st.floats(allow_nan=False), min_size=len(names), max_size=len(names)))
    written = SampleWriter(names, device).write(stamp_ns, values)
    expected = message(stamp_ns, names, values, device)
    assert deserialize_message(written, JointState) == expected


def test_padding_is_zero_so_that_equal_samples_are_equal_bytes():
    written = SampleWriter(("a", "bcdefg"), "x").write(0, (0.0, 0.0))
    assert set(written) == {0, 1, 2, 7, *b"xabcdefg"}


@settings(deadline=None)  # a sample takes microseconds, but a busy machine may take its time
@given(STAMPS, NAMES, NAMES, st.data())
def test_reader_finds_its_channels_in_any_layout(stamp_ns, names, wanted, data):
    values = data.draw(st.lists(st.floats(allow_nan=False), min_size=len(names), max_size=len(names)))
    reader = SampleReader(wanted)
    serialized = serialize_message(message(stamp_ns, names, values))
    for _ in range(2):  # the second time by the layout remembered
        found_ns, found = reader.read(serialized)
        assert found_ns == stamp_ns
        for name, value in zip(wanted, found, strict=True):
            if name in names:
                assert value == values[names.index(name)]
            else:
                assert math.isnan(value)
    assert reader.device == "integrated"
    assert all(reader.has(name) == (name in names) for name in wanted)


def test_reader_follows_a_change_of_layout():
    reader = SampleReader(("b",))
    assert reader.read(SampleWriter(("a", "b")).write(1, (1.0, 2.0))) == (1, (2.0,))
    assert reader.read(SampleWriter(("b", "a")).write(2, (3.0, 4.0))) == (2, (3.0,))
    assert reader.read(SampleWriter(("b",)).write(3, (5.0,))) == (3, (5.0,))
    assert math.isnan(reader.read(SampleWriter(("a",)).write(4, (6.0,)))[1][0])


@pytest.mark.parametrize("velocity", [[], [1.0, 2.0]])
def test_a_message_with_too_few_positions_or_with_velocities_is_read_slowly_but_rightly(velocity):
    odd = message(7, ("a", "b"), (1.0,))
    odd.velocity = array("d", velocity)
    stamp_ns, (a, b) = SampleReader(("a", "b")).read(serialize_message(odd))
    assert (stamp_ns, a) == (7, 1.0)
    assert math.isnan(b)


@settings(deadline=None)  # a sample takes microseconds, but a busy machine may take its time
@given(STAMPS)
def test_clock_bytes_are_those_of_the_message_class(stamp_ns):
    assert ClockWriter().write(stamp_ns) == serialize_message(Clock(clock=stamp_message(stamp_ns)))
