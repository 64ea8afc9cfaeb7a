"""The compiled loop against the same parts stepped one by one in Python."""

from dataclasses import replace

import numpy as np
import pytest
from vo2_control.closed_loop import run_loop
from vo2_control.controller import CurrentLimits, LinearController
from vo2_control.discretise import discrete_law
from vo2_control.hinf import PUBLISHED_CONTROLLER
from vo2_control.pid import PUBLISHED_PELTIER_PID, PidGains, pid_controller
from vo2_models.device import truth
from vo2_models.self_sensing.polynomial import PolynomialSelfSensing

LIMITS = CurrentLimits(-1.2, 1.2)


@pytest.fixture(scope="module")
def device():
    return truth("peltier", seed=3, domains=500)


@pytest.fixture(scope="module")
def sensing(device):
    levels = np.linspace(0.05, -1.15, 60)
    sweep = device.simulate(np.concatenate([levels, levels[::-1]]), dt=250.0, noise=False)
    return PolynomialSelfSensing.fit(sweep["film_resistance"], sweep["true_tip_deflection"], degree=9)


def test_compiled_loop_equals_stepping_by_hand(device, sensing):
    law = replace(discrete_law(PUBLISHED_CONTROLLER, 0.125), operating_a=-0.7)
    reference = 1e-6 * np.repeat([5.0, 25.0, 10.0], 200)
    result = run_loop(device, sensing, LinearController(law, LIMITS), reference, seed=4)
    controller, stream, current = LinearController(law, LIMITS), device.stepper(seed=4), 0.0
    memory = sensing.initial_state()
    for k, wanted in enumerate(reference):
        resistance = stream.step(current)[1]
        estimate = float(sensing.update(resistance, memory).deflection)
        assert result.current_a[k] == pytest.approx(current, abs=1e-9)
        assert result.estimate_m[k] == pytest.approx(estimate, abs=1e-12)
        assert result.deflection_m[k] == pytest.approx(stream.true_deflection, abs=1e-12)
        current = controller.update(wanted, estimate)


def test_pid_on_the_true_deflection_settles_and_rejects_a_constant_disturbance(device):
    controller = pid_controller(PUBLISHED_PELTIER_PID, LIMITS, 0.125)
    reference = np.full(2400, 30e-6)
    for disturbance in (0.0, 0.1):
        result = run_loop(device, None, controller, reference, disturbance_a=np.full(2400, disturbance))
        assert np.abs(result.error_m[-200:]).max() < 0.7e-6
    assert not np.any(controller.state[:-1])  # the controller handed in is left as it is


def test_feedforward_is_added_before_the_limits(device):
    silent = pid_controller(PidGains(0.0, 0.0), LIMITS, 0.125)
    ahead = np.linspace(0.0, -2.0, 100)
    result = run_loop(device, None, silent, np.zeros(100), feedforward_a=ahead)
    np.testing.assert_allclose(result.current_a[1:], np.maximum(ahead[:-1], -1.2))


def test_refusals(device, sensing):
    with pytest.raises(ValueError, match="period"):
        run_loop(device, sensing, pid_controller(PidGains(1.0, 1.0), LIMITS, 0.1), np.zeros(3))
    with pytest.raises(ValueError, match="need polynomial or composite"):
        run_loop(device, object(), pid_controller(PidGains(1.0, 1.0), LIMITS, 0.125), np.zeros(3))
