"""Tuning from a model: the sampled plant against a fine simulation, margins against brute force, the rule's promise."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_control.controller import CurrentLimits
from vo2_control.pid import PidGains, pid_controller, pid_law
from vo2_control.sampled_loop import ThermalLag, loop_margins
from vo2_control.tuning import local_slopes, tune_pid


@settings(max_examples=25, deadline=None)
@given(tau=st.floats(0.5, 5), theta=st.sampled_from([0.0, 0.3, 1.0, 1.7, 3.0]), seed=st.integers(0, 1000))
def test_sampled_lag_equals_continuous_response(tau, theta, seed):
    """Held inputs through K exp(-theta s)/(tau s + 1), summed from the step response of every change."""
    inputs = np.random.default_rng(seed).normal(size=12)
    plant = ThermalLag(2.0, tau, theta).sampled(1.0)
    x, got = np.zeros(plant.a.shape[0]), []
    for u in inputs:
        got.append(plant.c @ x)
        x = plant.a @ x + plant.b * u
    changes = np.diff(inputs, prepend=0.0)
    wanted = [
        sum(2.0 * changes[j] * (1 - math.exp(-max(k - j - theta, 0.0) / tau)) for j in range(k))
        for k in range(12)
    ]
    np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_margins_against_brute_force():
    """The loop must become unstable exactly at its gain margin."""
    plant = ThermalLag(3.0, 1.0, 0.25)
    gains = PidGains(0.8, 0.9)
    margins = loop_margins(pid_law(gains, 0.1), plant.sampled(0.1), points=20000)

    def stable(factor):
        return loop_margins(pid_law(PidGains(0.8 * factor, 0.9 * factor), 0.1), plant.sampled(0.1)).stable

    assert margins.stable and 1 < margins.gain_margin < 10
    assert stable(margins.gain_margin * 0.995) and not stable(margins.gain_margin * 1.005)
    # classical bounds that tie the three together
    assert margins.gain_margin >= margins.sensitivity_peak / (margins.sensitivity_peak - 1) * 0.999
    assert margins.phase_margin_deg >= np.degrees(2 * np.arcsin(0.5 / margins.sensitivity_peak)) * 0.99


@pytest.mark.parametrize("derivative", [False, True])
@pytest.mark.parametrize(
    ("gain", "tau", "theta", "period"),
    [(-295e-6, 25.0, 0.375, 0.125), (0.0254, 1.8e-3, 0.0, 1e-3), (1.0, 1.0, 1.0, 0.05)],
)
def test_tuned_loop_keeps_its_promise_and_is_not_timid(gain, tau, theta, period, derivative):
    tuned = tune_pid(ThermalLag(gain, tau, theta), period, max_sensitivity=1.6, derivative=derivative)
    assert tuned.gains.kp * gain > 0
    for factor in (0.8, 1.0, 1.2):
        margins = loop_margins(
            pid_law(tuned.gains, period), ThermalLag(gain, tau * factor, theta).sampled(period), points=4000
        )
        assert margins.stable and margins.sensitivity_peak <= 1.61
    assert tuned.worst.sensitivity_peak > 1.59


@pytest.mark.slow
def test_no_other_pi_within_the_limits_has_more_integral_gain():
    """Against a random search over the same constraints."""
    plant, period, limit = ThermalLag(-2.0, 1.0, 0.2), 0.05, 1.6
    tuned = tune_pid(plant, period, max_sensitivity=limit)
    rng = np.random.default_rng(1)
    corners = [ThermalLag(-2.0, f, 0.2).sampled(period) for f in (0.8, 1.0, 1.2)]
    best = 0.0
    for kp, ki in zip(rng.uniform(0, 3, 1500), rng.uniform(0, 3, 1500), strict=True):
        law = pid_law(PidGains(-kp, -ki), period)
        margins = [loop_margins(law, c, points=300) for c in corners]
        if all(m.stable and max(m.sensitivity_peak, m.complementary_peak) <= limit for m in margins):
            best = max(best, ki)
    assert 0.85 * abs(tuned.gains.ki) < best <= 1.01 * abs(tuned.gains.ki)


def test_tuned_pi_settles_after_a_step():
    tau, period, gain = 1.8e-3, 1e-3, 0.02
    tuned = tune_pid(ThermalLag(gain, tau), period)
    controller = pid_controller(tuned.gains, CurrentLimits(0.0, 0.01278), period)
    pole, y, response = math.exp(-period / tau), 0.0, []
    for _ in range(60):
        y = pole * y + gain * (1 - pole) * controller.update(40e-6, y)
        response.append(y / 40e-6)
    assert abs(response[-1] - 1) < 1e-3 and max(response) < 1.3


def test_local_slopes_of_a_known_curve():
    up = np.linspace(0.0, 2.0, 401)
    current = np.concatenate([up, up[::-1]])
    curve = np.concatenate([3 * up, 6 - 3 * (2 - up[::-1]) + 0.0])
    slopes = local_slopes(current, curve)
    assert slopes.typical == pytest.approx(3.0) and slopes.largest == pytest.approx(3.0)
    assert slopes.opposed_share == 0.0
    power = local_slopes(current, 5 * current**2, coordinate="heating_power")
    assert power.typical == pytest.approx(5.0, rel=1e-6)
    with pytest.raises(ValueError, match="prevailing sign"):
        local_slopes(up, (up - 1) ** 2)


def test_refusals_name_the_cause():
    with pytest.raises(ValueError, match="uncontrollable"):
        ThermalLag(0.0, 1.0)
    with pytest.raises(ValueError, match="one sign"):
        tune_pid(ThermalLag(1.0, 1.0), 0.1, slopes=[-0.2])
    with pytest.raises(ValueError, match="max_sensitivity"):
        tune_pid(ThermalLag(1.0, 1.0), 0.1, max_sensitivity=1.0)
    with pytest.raises(ValueError, match="sample period"):
        loop_margins(pid_law(PidGains(1.0, 1.0), 0.1), ThermalLag(1.0, 1.0).sampled(0.2))


def test_published_pi_gains_in_the_units_of_the_errata():
    """Kp in A/um is unstable at 1 kHz; Kp = 1.4 uA/um with KI = 2.03e-5 A/(um sample) is not."""
    steepest = ThermalLag(57.03e-6 / (8.49e-3 - 3.68e-3) * 2.5, 1.8e-3).sampled(1e-3)
    as_printed = loop_margins(pid_law(PidGains(1.4e-3 * 1e6, 2.03e-5 * 1e9), 1e-3), steepest)
    read_right = loop_margins(pid_law(PidGains(1.4e-6 * 1e6, 2.03e-5 * 1e9), 1e-3), steepest)
    assert not as_printed.stable and as_printed.spectral_radius > 2.7
    assert read_right.stable
