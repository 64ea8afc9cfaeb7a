"""Gains from a model file: units, sign, and what the gains do on a device that is not the model."""

from dataclasses import replace

import numpy as np
import pytest
from vo2_control.closed_loop import run_loop
from vo2_control.controller import CurrentLimits
from vo2_control.model_tuning import STILL, held_swing, loop_slopes, thermal_lag, tuned_from_model
from vo2_control.pid import PidGains, pid_controller
from vo2_models.device import truth
from vo2_models.device.model import DeviceModel

from vo2_control import model_tuning


def test_slopes_of_a_tanh_loop_are_the_analytic_ones(crude_model):
    slopes = loop_slopes(crude_model("peltier").simulation)
    # steepest: weight * slope per kelvin, times -50 K/A
    steepest = 35e-6 * 0.8 / 2.5 * -50
    assert slopes.largest == pytest.approx(steepest, rel=0.05)
    assert abs(slopes.typical) < abs(slopes.largest)


@pytest.mark.parametrize(
    ("device", "period", "limits", "hold", "allowed_m"),
    # the slow device still hunts across its loop's width after 150 s
    [("integrated", 1e-3, (0.0, 0.01278), 400, 0.4e-6), ("peltier", 0.125, (-1.2, 1.2), 1200, 2e-6)],
)
def test_gains_from_a_crude_model_track_steps_on_the_device(
    crude_model, device, period, limits, hold, allowed_m
):
    tuned = tuned_from_model(crude_model(device).to_parameters(), period)
    assert tuned.worst.stable and tuned.worst.sensitivity_peak <= 1.61
    controller = pid_controller(tuned.gains, CurrentLimits(*limits), period)
    reference = np.repeat([15e-6, 30e-6, 45e-6, 35e-6], hold)
    result = run_loop(truth(device, seed=1, domains=1000), None, controller, reference)
    settled = np.abs(result.error_m.reshape(-1, hold)[1:, -200:])
    assert settled.mean() < allowed_m


@pytest.mark.slow
def test_a_law_that_cycles_around_the_width_of_the_loop_is_not_taken_nor_one_that_is_all_there_is(
    crude_model, monkeypatch
):
    parameters = crude_model("peltier").to_parameters()
    swing = held_swing(crude_model("peltier").simulation, 0.125)
    limits = CurrentLimits(-1.2, 1.2)
    # of less tracking error, by which it was once chosen
    cycling = PidGains(-37198.0, -3755.3, -1525.7, derivative_filter_s=0.109)
    assert swing(pid_controller(cycling, limits, 0.125)) > STILL
    tuned = tuned_from_model(parameters, 0.125, derivative=True)
    assert swing(pid_controller(tuned.gains, limits, 0.125)) <= STILL
    monkeypatch.setattr(model_tuning, "STILL", -1.0)
    with pytest.raises(ValueError, match=r"held deflection that swings by .* %.*sample faster"):
        tuned_from_model(parameters, 0.125)


def test_flipped_and_incomplete_models_are_refused(crude_model):
    model = crude_model("peltier")
    flipped = replace(model, scalars={"thermal.linear_gain": 50.0, "thermal.ambient": 40.0})
    with pytest.raises(ValueError, match=r"sign-flipped|prevailing sign|does not move"):
        thermal_lag(flipped)
    with pytest.raises(ValueError, match="no law"):
        thermal_lag(DeviceModel("peltier"))
