"""Stamps: late ones are told from a source that started anew, ages without a common clock."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from vo2_interface.lockstep import SampleAge, StampOrder

from vo2_interface import lockstep

MS = 1_000_000


def judged(order, stamp_ns):
    found = order.judge(stamp_ns)
    if found in ("new", "restart"):
        order.accept(stamp_ns)
    return found


# a processor that does other work makes inputs slowly: that says nothing of them
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.permutations(range(30)), st.lists(st.integers(0, 29), max_size=5))
def test_whatever_is_lost_doubled_or_reordered_what_counts_only_grows(order_of_arrival, copies):
    order, taken = StampOrder(), []
    for k in [*order_of_arrival[:13], *copies, 30]:
        if judged(order, k * MS) == "new":
            taken.append(k)
    assert taken == sorted(set(taken)) and taken[-1] == 30


def test_a_source_that_shows_only_older_stamps_has_started_anew(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(lockstep.time, "monotonic", lambda: clock[0])
    order = StampOrder()
    assert [judged(order, k * MS) for k in (1000, 1000, 10, 1001)] == ["new", "repeat", "late", "new"]
    found = []
    for _ in range(4):
        found.append(judged(order, MS))
        clock[0] += 0.2
    assert found == ["late", "late", "restart", "repeat"]
    # a bag that is played fast does not take that long
    order = StampOrder()
    judged(order, 1000 * MS)
    assert [judged(order, k * MS) for k in range(25)].index("restart") == 19


@pytest.mark.parametrize("offset_s", [0.0, 1.8e9, -5e3])
def test_the_age_is_what_a_sample_took_longer_than_the_fastest(offset_s):
    age = SampleAge()
    delays = [0.004, 0.001, 0.001, 0.5]
    found = []
    for k, delay in enumerate(delays):
        stamp_ns = round((offset_s + k) * 1e9)
        age.hear(stamp_ns, k + delay)
        found.append(age.age_s(stamp_ns, k + delay))
    assert found == pytest.approx([0.0, 0.0, 0.0, 0.499], abs=1e-3)
    assert age.stamp_s(10.0) == pytest.approx(offset_s + 10.0, abs=1e-2)
