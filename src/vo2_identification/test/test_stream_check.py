"""What is missing of a stream: publishers' numbers, gaps in stamps."""

from hypothesis import given
from hypothesis import strategies as st
from vo2_identification.stream_check import StreamCheck

MS = 1_000_000


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
