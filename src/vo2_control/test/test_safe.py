"""The safe current: held at most three samples, said why, recovered without a bump."""

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from vo2_control.controller import CurrentLimits
from vo2_control.pid import PidGains, pid_controller
from vo2_control.safe import SafetySettings, Supervisor

PERIOD = 0.001
REACH = (2e-6, 58e-6)


def supervisor(**changes):
    controller = pid_controller(PidGains(50.0, 2e4), CurrentLimits(0.0, 0.012), PERIOD)
    arguments = {"reach_m": REACH, "range_m": (0.0, 60e-6)} | changes
    return Supervisor(controller, SafetySettings(PERIOD, **arguments))


def run(s, samples, start=0, estimate=25e-6):
    for k in range(start, start + samples):
        decision = s.sample(k * PERIOD, 30e-6, estimate)
    return decision


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 2.5e306, -1.0])
def test_bad_estimate_holds_three_samples_then_lets_go(bad):
    s = supervisor()
    held = run(s, 20).current_a
    assert held > 0
    for k in (20, 21, 22):
        decision = s.sample(k * PERIOD, 30e-6, bad)
        assert decision.current_a == held and decision.mode == "holding" and "estimate is" in decision.reason
    decision = s.sample(23 * PERIOD, 30e-6, bad)
    assert decision.current_a == 0.0 and decision.mode == "safe" and "safe current" in decision.reason


def test_comes_back_without_a_bump():
    s = supervisor()
    run(s, 20)
    for k in range(20, 60):
        s.sample(k * PERIOD, 30e-6, math.nan)
    assert s.current_a == 0.0
    first = s.sample(60 * PERIOD, 30e-6, 3e-6)
    assert first.mode == "tracking" and first.current_a == pytest.approx(0.0, abs=1e-12)
    second = s.sample(61 * PERIOD, 30e-6, 3e-6)
    assert 0 < second.current_a < 0.002


def test_short_gap_continues_as_if_nothing_had_happened():
    s, other = supervisor(), supervisor()
    run(s, 20)
    run(other, 20)
    s.sample(20 * PERIOD, 30e-6, math.nan)
    assert s.sample(21 * PERIOD, 30e-6, 25e-6).current_a == other.sample(20 * PERIOD, 30e-6, 25e-6).current_a


@pytest.mark.parametrize(("reference", "clipped"), [(80e-6, 58e-6), (-5e-6, 2e-6)])
def test_reference_out_of_reach_is_clipped_with_the_reason(reference, clipped):
    s, inside = supervisor(), supervisor()
    decision = s.sample(0.0, reference, 25e-6)
    assert decision.mode == "limited" and "outside the reachable" in decision.reason
    assert decision.current_a == inside.sample(0.0, clipped, 25e-6).current_a
    assert s.sample(PERIOD, 30e-6, 25e-6).reason == ""


def test_a_response_in_another_unit_closes_the_loop_up_to_ten_times_its_range():
    s = supervisor(reach_m=(0.0, 50.0), range_m=(0.0, 60.0), response_unit="N")
    assert s.sample(0.0, 30.0, 25.0).mode == "tracking"
    assert (
        s.sample(PERIOD, 55.0, 25.0).reason == "reference of 55 N is outside the reachable 0 to 50 N: clipped"
    )
    reasons = {s.sample(k * PERIOD, 30.0, 600.0 + k).reason for k in range(2, 9)}
    # one cause, one text while it is held and one after
    assert len(reasons) == 2 and all(r.startswith("estimate is beyond 600 N, 10 times") for r in reasons)
    assert s.sample(9 * PERIOD, math.nan, 25.0).reason == "reference is nan: safe current 0 A"


def test_wall_time_a_loop_left_alone_starts_anew_from_the_safe_current():
    s = supervisor(wall_time=True)
    run(s, 20)
    s.release(22 * PERIOD, followed=True)
    assert s.mode == "tracking"
    s.release(60 * PERIOD, followed=True)
    assert s.mode == "safe" and s.current_a == 0.0
    assert s.sample(60 * PERIOD, 30e-6, 3e-6).current_a == pytest.approx(0.0, abs=1e-12)


def test_the_integrator_waits_while_the_plant_does_not_follow():
    s = supervisor()
    s.begin_at(0.004)
    for k in range(500):
        s.release(k * PERIOD, followed=False)
        waiting = s.sample(k * PERIOD, 30e-6, 2e-6, followed=False)
        assert waiting.mode == "starting" and "does not follow" in waiting.reason
    assert s.sample(500 * PERIOD, 30e-6, 2e-6).current_a == pytest.approx(0.004, abs=1e-12)
    run(s, 200, 501)
    s.release(701 * PERIOD, followed=False)
    assert s.sample(701 * PERIOD, 30e-6, 2e-6, followed=False).current_a == 0.0


def test_redesign_while_running_is_bumpless():
    s = supervisor()
    before = run(s, 20).current_a
    s.replace_controller(
        pid_controller(PidGains(200.0, 1e3), CurrentLimits(0.0, 0.012), PERIOD), 30e-6, 25e-6
    )
    assert s.sample(20 * PERIOD, 30e-6, 25e-6).current_a == pytest.approx(before, abs=1e-12)


values = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(0, 60e-6))


@settings(max_examples=60, deadline=None)
@given(samples=st.lists(st.tuples(values, values), min_size=1, max_size=40))
@example(samples=[(0.0, 2.5e306)])
@example(samples=[(0.0, 0.0), (0.0, 2.5e306), (0.0, 0.0)])
@example(samples=[(1e300, 0.0), (math.inf, 0.0)])
def test_whatever_comes_the_current_is_finite_and_within_limits(samples):
    s = supervisor()
    for k, (reference, estimate) in enumerate(samples):
        decision = s.sample(k * PERIOD, reference, estimate)
        assert 0.0 <= decision.current_a <= 0.012
        assert (decision.mode == "tracking") == (decision.reason == "")


def test_bad_settings_are_named():
    with pytest.raises(ValueError, match="reach_m"):
        SafetySettings(PERIOD, reach_m=(3.0, 2.0))
    with pytest.raises(ValueError, match="hold_periods"):
        SafetySettings(PERIOD, hold_periods=-1)


def test_what_a_device_is_driven_by_is_told_in_its_unit():
    s = supervisor(unit="V", hold_periods=0)
    assert s.lost(0.0, "nothing there").reason == "nothing there: safe current 0 V"


def test_begins_at_a_current_that_flows_already_but_only_once():
    s = supervisor()
    s.begin_at(0.005)
    assert s.sample(0.0, 30e-6, 30e-6).current_a == pytest.approx(0.005, abs=1e-12)
    s.begin_at(0.002)
    assert s.sample(PERIOD, 30e-6, 30e-6).current_a == pytest.approx(0.005, abs=1e-9)


def test_lost_input_in_the_words_of_who_found_it():
    s = supervisor()
    held = run(s, 20).current_a
    decisions = [s.lost(k * PERIOD, "nothing on estimate") for k in range(20, 25)]
    assert [d.current_a for d in decisions] == [held, held, held, 0.0, 0.0]
    assert decisions[-1].reason == "nothing on estimate: safe current 0 A"


def test_feedforward_joins_without_a_bump():
    s = supervisor()
    s.begin_at(0.006)
    assert s.sample(0.0, 30e-6, 30e-6, feedforward_a=0.004).current_a == pytest.approx(0.006, abs=1e-12)
    assert s.sample(PERIOD, 30e-6, 30e-6, feedforward_a=0.005).current_a == pytest.approx(0.007, abs=1e-9)
