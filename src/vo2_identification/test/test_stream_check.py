"""What is missing of a stream: publishers' numbers, gaps in stamps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vo2_identification.stream_check import StreamCheck, compare_beginnings

MS = 1_000_000
DAY = 86_402_000 * MS
"""A time of day more than a day after the stamps."""


@given(st.lists(st.booleans(), min_size=2, max_size=200), st.integers(1, 10**6))
def test_every_number_that_one_publisher_skips_after_the_first_heard_is_counted(arrives, first):
    check = StreamCheck()
    heard = [first + k for k, there in enumerate(arrives) if there]
    for number in heard:
        check.hear_number(number, 1)
    assert check.lost == (heard[-1] - heard[0] + 1 - len(heard) if heard else 0)


def test_two_publishers_one_that_restarts_and_one_that_goes_are_no_loss():
    check = StreamCheck()
    for k in range(50):
        check.hear_number(1000 + k, 2)
        check.hear_number(7 + k, 2)
    for k in range(50):  # the second begins anew
        check.hear_number(1050 + k, 2)
        check.hear_number(1 + k, 2)
    for k in range(50):  # and remains alone
        check.hear_number(51 + k, 1)
    assert check.lost == 0
    check.hear_number(104, 1)
    assert check.lost == 3


def test_gaps_in_stamps_are_counted_in_periods_and_placed():
    check = StreamCheck()
    left_out = {40, 41, 70}
    for k in range(100):
        if k not in left_out:
            check.hear_stamp(k * MS + (k % 3) * 1000)
    assert (check.gaps, check.missing) == (2, 3)
    assert "3 sample periods without a sample in 2 gaps, the first after stamp 0.039" in check.words()


def test_a_gap_among_the_first_samples_is_placed_too():
    check = StreamCheck()
    for k in [*range(5), *range(8, 60)]:
        check.hear_stamp(k * MS)
    assert (check.gaps, check.missing, check.first_gap_ns) == (1, 3, 4 * MS)


def test_a_publisher_that_is_known_late_or_joins_loses_nothing():
    """A second node on a topic that runs long: its first words come before discovery counts it, and when it has gone."""
    check = StreamCheck()
    for k in range(300):
        check.hear_number(8_600_000 + k, 1)
    for k in range(300):
        check.hear_number(8_600_300 + k, 1 if k < 50 else 2)
        check.hear_number(1 + k, 1 if k < 50 else 2)
    for k in range(300):
        check.hear_number(8_600_600 + k, 1)
    assert check.lost == 0
    # a slow one and four quick ones, and an idle one that joins without a word
    for k in range(300):
        check.hear_number(8_600_900 + k, 4)
        if k % 100 == 0:
            check.hear_number(20 + k // 100, 4)
    for k in range(400):
        check.hear_number(8_601_200 + k, 5)
    assert check.lost == 0
    check.hear_number(8_601_603, 5)
    assert check.lost == 3


def begun(stamps, number):
    """A check of samples with these stamps [ms], the first of them with this number of its publisher."""
    check = StreamCheck()
    for k, stamp in enumerate(stamps):
        check.hear_number(number + k, 1)
        check.hear_stamp(stamp * MS)
    return check


@pytest.mark.parametrize(
    ("command", "measurement", "now_ns", "lost", "told"),
    [
        ((1000, 1), (1001, 2), DAY, 1, True),  # the first measurement: sent, answered, not heard
        ((1000, 3), (1020, 40), DAY, 20, True),
        ((1000, 1), (1020, 1), DAY, 0, False),  # its first words: nothing was sent before
        ((1000, 1), (1000, 7), DAY, 0, False),  # repeats of the first sample
        ((1000, 5000), (1003, 9000), DAY, 0, True),  # a recorder that came later
        ((1000, 1), (1020, 40), 0, 0, True),  # wall time: the node that commands may have come later
    ],
)
def test_a_topic_that_begins_later_than_the_others_is_told_and_lost_in_lockstep(
    command, measurement, now_ns, lost, told
):
    checks = {
        "/vo2/command": begun(range(command[0], 1100), command[1]),
        "/vo2/measurement": begun(range(measurement[0], 1100), measurement[1]),
        "/vo2/estimate": StreamCheck(),
    }
    compare_beginnings(checks, now_ns)
    late = checks["/vo2/measurement"]
    assert (late.lost, checks["/vo2/command"].lost) == (lost, 0)
    assert ("later than /vo2/command" in late.words()) is told
    assert checks["/vo2/command"].words() == checks["/vo2/estimate"].words() == ""
