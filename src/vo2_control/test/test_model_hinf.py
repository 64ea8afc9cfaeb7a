"""H-infinity from a model file: both presets, what it does on a device that is not the model, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from vo2_control.closed_loop import run_loop
from vo2_control.controller import CurrentLimits
from vo2_control.designs import design_controller
from vo2_control.hinf import DesignRefused
from vo2_control.model_hinf import robust_from_model
from vo2_control.model_tuning import STILL, held_swing, loop_slopes, thermal_lag
from vo2_control.sampled_loop import loop_margins
from vo2_models.device import truth
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank

PERIODS = {"integrated": 1e-3, "peltier": 0.125}


@pytest.mark.parametrize(
    ("device", "limits", "hold", "allowed_m"),
    [("integrated", (0.0, 0.01278), 600, 0.6e-6), ("peltier", (-1.2, 1.2), 2400, 1.8e-6)],
)
def test_the_law_has_integral_action_holds_the_margins_and_tracks_the_device(
    crude_model, device, limits, hold, allowed_m
):
    model, period = crude_model(device), PERIODS[device]
    robust = robust_from_model(model.to_parameters(), period)
    assert robust.synthesis.robust_stability < 1
    assert np.abs(np.linalg.eigvals(robust.law.a)).max() > 0.9999
    assert robust.law.sample_period_s == period
    assert robust.law.coordinate == ("heating_power" if device == "integrated" else "current")
    # in the device's own units, at the steepest and at the half typical slope
    lag, slopes = thermal_lag(model), loop_slopes(model.simulation)
    for gain in (slopes.largest, 0.5 * slopes.typical):
        for spread in (0.8, 1.0, 1.2):
            plant = replace(lag, gain=gain, time_constant_s=spread * lag.time_constant_s).sampled(period)
            margins = loop_margins(robust.law, plant)
            assert margins.stable and max(margins.sensitivity_peak, margins.complementary_peak) < 1.62
    # without integral action 5 % of 45 um were left; the slow device once hunted by a tenth of its range
    controller = robust.controller(CurrentLimits(*limits))
    assert held_swing(model.simulation, period)(controller) <= STILL
    reference = np.repeat([15e-6, 30e-6, 45e-6, 35e-6], hold)
    result = run_loop(truth(device, seed=1, domains=1000), None, controller, reference)
    settled = np.abs(result.error_m.reshape(-1, hold)[1:, -200:])
    assert settled.mean() < allowed_m


@pytest.mark.parametrize("period", [0.02, pytest.param(0.1, marks=pytest.mark.slow)])
def test_a_device_of_millimetres_is_scaled_to_the_weights_too(tmp_path, period):
    file = tmp_path / "wire.yaml"
    file.write_text(
        "schema: vo2-device/1\nid: wire\ndrive: {channel: heater_current, unit: A, limits: [0.0, 0.4]}\n"
        "body: {kind: first_order, ambient: 22.0, square_gain: 650.0, time_constant: 0.8}\n"
        "responses:\n  tip_deflection: {unit: m, range: [0.0, 4.6e-3]}\nsampling: {period: 0.02}\n"
    )
    bank = PlayBank(
        weights=[2.3e-3], radii=[0.0], rising_slopes=[0.06], rising_offsets=[-4.2],
        falling_slopes=[0.06], falling_offsets=[-3.9], polynomial=[2.3e-3],
    )  # fmt: skip
    model = DeviceModel(str(file), deflection=bank)
    robust = robust_from_model(model.to_parameters(), period)
    assert max(robust.worst.sensitivity_peak, robust.worst.complementary_peak) <= 1.6
    plant = thermal_lag(model).sampled(period)
    assert loop_margins(robust.law, plant).stable
    controller = robust.controller(CurrentLimits(0.0, 0.4))
    assert held_swing(model.simulation, period)(controller) <= STILL


@pytest.mark.slow
def test_a_mode_that_the_design_does_not_know_is_held_or_refused_with_what_to_do(crude_model):
    mode = {"share": 1.0, "frequency": 60.0, "damping": 0.002}
    model = replace(crude_model("integrated"), effects={"cantilever_resonance": mode})
    with pytest.raises(DesignRefused, match=r"hold all plants.*Ms or Mt of.*choose kind pi"):
        robust_from_model(model.to_parameters(), 1e-3)


def test_a_model_is_used_unless_a_design_is_given(crude_model):
    parameters = crude_model("peltier").to_parameters()
    where = {"preset": "peltier", "sample_period_s": 0.125}
    laws = [
        design_controller("hinf", values=values, **where).law
        for values in ({}, parameters, {**parameters, "hinf.performance.gain": 0.09})
    ]
    assert laws[0].order == laws[2].order and np.array_equal(laws[0].d, laws[2].d)
    assert not np.array_equal(laws[0].d, laws[1].d)
    # the published design has no integrator, that of the model has
    radius = [np.abs(np.linalg.eigvals(law.a)).max() for law in laws]
    assert radius[0] < 0.9999 < radius[1] <= 1.0


def test_a_model_without_dynamics_is_refused_in_one_line(crude_model):
    for scalars, found in (({"thermal.time_constant": 1e-6}, "1e-06"),):
        model = replace(crude_model("peltier"), scalars={**scalars, "driver.dead_time": 0.0})
        with pytest.raises(ValueError, match=r"model\.thermal\.time_constant: found") as caught:
            robust_from_model(model.to_parameters(), 0.125)
        message = str(caught.value)
        assert found in message and "without dynamics" in message and "kind pi" in message
        assert "\n" not in message
    with pytest.raises(ValueError, match=r"model\.deflection: found no law"):
        robust_from_model(DeviceModel("peltier").to_parameters(), 0.125)
