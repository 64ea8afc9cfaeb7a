"""PI and PID: against the textbook recursions, and their behaviour at limits, starts and faults."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_control.controller import CurrentLimits, LinearController, LinearLaw
from vo2_control.pid import (
    PID_PARAMETERS,
    PUBLISHED_PELTIER_PID,
    PidGains,
    pid_controller,
    pid_from_parameters,
)

WIDE = CurrentLimits(-1e9, 1e9)
PERIOD = 0.01


def textbook_pid(gains: PidGains, references, estimates, period):
    """Velocity-free positional PID by backward differences, written from the definition."""
    integral, derivative, previous = 0.0, 0.0, 0.0
    out = []
    for r, y in zip(references, estimates, strict=True):
        integral += gains.ki * period * (r - y)
        z = gains.reference_derivative_weight * r - y
        derivative = (gains.derivative_filter_s * derivative + gains.kd * (z - previous)) / (
            gains.derivative_filter_s + period
        )
        previous = z
        out.append(gains.kp * (gains.reference_weight * r - y) + integral + derivative)
    return np.array(out)


@settings(max_examples=50, deadline=None)
@given(
    kp=st.floats(0, 10),
    ki=st.floats(0, 10),
    kd=st.floats(0, 1),
    tf=st.floats(0, 0.1),
    b=st.floats(0, 1),
    c=st.floats(0, 1),
    seed=st.integers(0, 2**31),
)
def test_unlimited_law_equals_textbook_recursion(kp, ki, kd, tf, b, c, seed):
    gains = PidGains(kp, ki, kd, tf, b, c)
    rng = np.random.default_rng(seed)
    references, estimates = rng.normal(size=(2, 40))
    controller = pid_controller(gains, WIDE, PERIOD)
    got = [controller.update(r, y) for r, y in zip(references, estimates, strict=True)]
    wanted = textbook_pid(gains, references, estimates, PERIOD)
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9 * (1 + np.abs(wanted).max()))


def test_output_respects_range_and_rate():
    controller = pid_controller(PidGains(5.0, 20.0, 0.1, 0.01), CurrentLimits(-0.2, 0.7, 3.0), PERIOD)
    rng = np.random.default_rng(3)
    current = np.array([controller.update(*rng.normal(size=2)) for _ in range(2000)])
    assert current.min() >= -0.2 and current.max() <= 0.7
    assert current.min() < -0.19 and current.max() > 0.69
    assert np.abs(np.diff(current)).max() <= 3.0 * PERIOD + 1e-12


def closed_loop(gains, limits, reference, samples, gain=1.0, tau=0.1):
    controller = pid_controller(gains, limits, PERIOD)
    pole = math.exp(-PERIOD / tau)
    y, history = 0.0, []
    for k in range(samples):
        u = controller.update(reference(k), y)
        y = pole * y + gain * (1 - pole) * u
        history.append((y, u))
    return np.array(history).T


def test_saturated_integrator_unwinds():
    """After a long unreachable reference, the way back takes no longer than the plant needs."""
    gains = PidGains(kp=2.0, ki=20.0)
    y, _ = closed_loop(gains, CurrentLimits(0.0, 1.0), lambda k: 2.0 if k < 500 else 0.5, 600)
    slow, _ = closed_loop(
        PidGains(kp=2.0, ki=20.0, tracking_time_s=1e9),
        CurrentLimits(0.0, 1.0),
        lambda k: 2.0 if k < 500 else 0.5,
        600,
    )
    assert abs(y[550] - 0.5) < 0.02
    assert abs(slow[550] - 0.5) > 0.3  # what happens without anti-windup


@settings(max_examples=30, deadline=None)
@given(
    current=st.floats(0.0, 0.01),
    reference=st.floats(0, 60e-6),
    estimate=st.floats(0, 60e-6),
    coordinate=st.sampled_from(["current", "heating_power"]),
)
def test_reset_is_bumpless(current, reference, estimate, coordinate):
    controller = pid_controller(
        PidGains(100.0, 1e4, 0.01, 0.002, coordinate=coordinate), CurrentLimits(0.0, 0.012), 0.001
    )
    controller.update(1.0, -1.0)
    controller.reset(current, reference, estimate)
    # 1e-8 A: at 0 A the root of the rounding of kp r, sqrt(1e-16 * 5e-3)
    assert controller.update(reference, estimate) == pytest.approx(current, abs=1e-8)
    if abs(reference - estimate) < 1e-12:
        assert controller.update(reference, estimate) == pytest.approx(current, abs=1e-6)


def test_change_of_gains_while_running_is_bumpless():
    limits = CurrentLimits(0.0, 10.0)
    first = pid_controller(PidGains(2.0, 20.0), limits, PERIOD)
    for _ in range(20):
        current = first.update(1.0, 0.7)
    second = pid_controller(PidGains(5.0, 3.0, 0.1, 0.05), limits, PERIOD)
    second.reset(current, 1.0, 0.7)
    assert second.update(1.0, 0.7) == pytest.approx(current)


def test_state_copies_and_restores():
    controller = pid_controller(PidGains(2.0, 20.0, 0.1, 0.05), WIDE, PERIOD)
    for k in range(10):
        controller.update(1.0, 0.1 * k)
    saved = controller.state
    first = [controller.update(1.0, y) for y in (0.3, 0.2, 0.5)]
    controller.state = saved
    assert [controller.update(1.0, y) for y in (0.3, 0.2, 0.5)] == first
    saved[:] = 7.0
    assert not np.any(controller.state == 7.0)


def test_heating_power_makes_the_current_the_root():
    gains = PidGains(kp=1.0, ki=0.0, coordinate="heating_power")
    controller = pid_controller(gains, CurrentLimits(0.0, 10.0), PERIOD)
    assert controller.update(9.0, 0.0) == pytest.approx(3.0)
    assert controller.update(-9.0, 0.0) == 0.0
    with pytest.raises(ValueError, match="heating power has no sign"):
        pid_controller(gains, CurrentLimits(-1.0, 1.0), PERIOD)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_signal_that_is_not_finite_is_refused_and_leaves_memory(bad):
    controller = pid_controller(PidGains(2.0, 20.0), WIDE, PERIOD)
    controller.update(1.0, 0.5)
    before = controller.state
    for signals in ((bad, 0.0), (0.0, bad)):
        with pytest.raises(ValueError, match="need finite"):
            controller.update(*signals)
    np.testing.assert_array_equal(controller.state, before)


def test_bad_gains_and_limits_are_named():
    with pytest.raises(ValueError, match="one sign"):
        PidGains(1.0, -1.0)
    with pytest.raises(ValueError, match="derivative_filter_s"):
        PidGains(1.0, 1.0, 1.0, -0.1)
    with pytest.raises(ValueError, match="less than upper"):
        CurrentLimits(1.0, 0.5)
    with pytest.raises(ValueError, match="rate_a_per_s"):
        CurrentLimits(0.0, 0.5, math.nan)
    with pytest.raises(ValueError, match="conditioning"):
        LinearLaw(np.eye(2), np.ones((2, 2)), np.ones(2), np.ones(2), np.ones(3), 0.1)


def test_parameters_round_trip():
    values = {p.name: p.default for p in PID_PARAMETERS} | {"pid.kp": 3.0, "pid.coordinate": "heating_power"}
    gains = pid_from_parameters(values)
    assert gains.kp == 3.0 and gains.coordinate == "heating_power" and gains.tracking_time_s is None
    with pytest.raises(ValueError, match=r"pid\.coordinate"):
        pid_from_parameters({"pid.coordinate": "voltage"})


def test_published_peltier_pid_is_stable_on_the_published_plant():
    """Section 8.3.2 asks less than 2 % overshoot and 10 s settling of the nominal linear model."""
    controller = pid_controller(PUBLISHED_PELTIER_PID, CurrentLimits(-10, 10), 0.125)
    pole, temperature, y = math.exp(-0.125 / 25), 0.0, 0.0
    queue, history = [0.0] * 3, []
    for _ in range(480):
        queue.append(controller.update(10e-6, y))
        temperature = pole * temperature - 50 * (1 - pole) * queue.pop(0)
        y = 5.9e-6 * temperature
        history.append(y)
    response = np.array(history) / 10e-6
    assert abs(response[-1] - 1) < 0.02
    assert response.max() < 1.2
    assert isinstance(controller, LinearController)
