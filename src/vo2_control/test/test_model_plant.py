"""The sampled plant of a model against its transfer functions, and laws that hold a model which has more than one lag."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from vo2_control.controller import CurrentLimits
from vo2_control.model_plant import linear_plant, quasi_static
from vo2_control.model_tuning import STILL, held_swing, thermal_lag, tuned_from_model
from vo2_control.pid import PidGains, pid_controller, pid_law
from vo2_control.sampled_loop import SampledPlant, ThermalLag, loop_margins

PERIOD = {"integrated": 1e-3, "peltier": 0.125}


def resonance(share, frequency, damping):
    w = 2 * np.pi * frequency
    return lambda s, _tau: 1 - share + share * w**2 / (s**2 + 2 * damping * w * s + w**2)


@pytest.mark.parametrize(
    ("device", "key", "values", "response"),
    [
        (
            "integrated",
            "cantilever_resonance",
            {"share": 0.8, "frequency": 60.0, "damping": 0.01},
            resonance(0.8, 60.0, 0.01),
        ),
        (
            "peltier",
            "sensor_lag:tip_deflection",
            {"time_constant": 2.0, "signal": "tip_deflection"},
            lambda s, _tau: 1 / (1 + 2.0 * s),
        ),
        ("integrated", "transition_kinetics", {"time_constant": 1e-3}, lambda s, _tau: 1 / (1 + 1e-3 * s)),
        (
            "peltier",
            "second_thermal_mode",
            {"share": 0.08, "time_constant": 200.0, "gain": 0.1},
            lambda s, tau: 1.02 + 0.08 * (1 + s * tau) / (1 + 200.0 * s),
        ),
        ("peltier", "dead_time", {"delay": 1.3}, lambda s, _tau: np.exp(-1.3 * s)),
    ],
)
def test_the_plant_is_the_lag_and_the_transfer_function_of_the_effect(
    crude_model, device, key, values, response
):
    model, period = replace(crude_model(device), effects={key: values}), PERIOD[device]
    lag = thermal_lag(model)
    plant = linear_plant(model.simulation, period)(lag)
    # up to a twentieth of the sampling rate: above, the held command makes more of two lags than of each
    omega = np.pi / period * np.geomspace(1e-4, 0.1, 40)
    found = plant.response(omega) / lag.sampled(period).response(omega)
    assert found == pytest.approx(response(1j * omega, lag.time_constant_s), rel=0.03)


def test_a_model_of_a_lag_alone_has_no_further_dynamics(crude_model):
    model = crude_model("peltier")
    assert linear_plant(model.simulation, 0.125) is None
    late = replace(
        model, effects={"adc_quantization:tip_deflection": {"step": 1e-7, "signal": "tip_deflection"}}
    )
    assert linear_plant(late.simulation, 0.125) is None
    assert quasi_static(model.simulation).active() == []


def test_of_a_slow_sensor_that_of_the_resistance_counts_where_self_sensing_starts_there(crude_model):
    one = crude_model("integrated")
    lagged = {"sensor_lag:film_resistance": {"time_constant": 3e-3, "signal": "film_resistance"}}
    blind, sensing = (
        replace(one, resistance=law, effects=lagged) for law in (one.resistance, one.deflection)
    )
    assert linear_plant(blind.simulation, 1e-3) is None
    plant = linear_plant(sensing.simulation, 1e-3)(thermal_lag(sensing))
    assert np.abs(np.linalg.eigvals(plant.a)) == pytest.approx(
        sorted([np.exp(-1 / 3), np.exp(-1e-3 / thermal_lag(sensing).time_constant_s)])[::-1], rel=1e-3
    )


def with_mode(lag, frequency, damping, period):
    """The lag and a mode behind it under a held command, written down once more."""
    w = 2 * np.pi * frequency
    a = np.array([[-1 / lag.time_constant_s, 0, 0], [0, 0, 1], [lag.gain * w**2, -(w**2), -2 * damping * w]])
    b = np.array([[1 / lag.time_constant_s], [0], [0]])
    step = expm(period * np.block([[a, b], [np.zeros((1, 4))]]))
    return SampledPlant(step[:3, :3], step[:3, 3], np.array([0.0, 1.0, 0.0]), period)


def test_a_mode_is_as_exact_as_written_down_once_more(crude_model):
    mode = {"share": 1.0, "frequency": 60.0, "damping": 0.019}
    model = replace(crude_model("integrated"), effects={"cantilever_resonance": mode})
    lag = thermal_lag(model)
    omega = 2 * np.pi * np.array([1.0, 30.0, 59.0, 60.0, 61.0, 100.0, 300.0, 500.0])
    found = linear_plant(model.simulation, 1e-3)(lag).response(omega)
    assert found == pytest.approx(with_mode(lag, 60.0, 0.019, 1e-3).response(omega), rel=1e-3)


@pytest.mark.parametrize("derivative", [False, True])
def test_gains_for_a_model_with_a_mode_hold_it_with_the_margins_they_state(crude_model, derivative):
    mode = {"share": 1.0, "frequency": 60.0, "damping": 0.019}
    model = replace(crude_model("integrated"), effects={"cantilever_resonance": mode})
    tuned = tuned_from_model(model.to_parameters(), 1e-3, derivative=derivative)
    margins = loop_margins(
        pid_law(tuned.gains, 1e-3), with_mode(thermal_lag(model), 60.0, 0.019, 1e-3), points=4000
    )
    assert margins.stable and margins.sensitivity_peak < 1.62
    controller = pid_controller(tuned.gains, CurrentLimits(0.0, 0.01278), 1e-3)
    assert held_swing(model.simulation, 1e-3)(controller) <= STILL


def test_margins_see_a_peak_that_is_narrower_than_the_grid():
    plant = with_mode(ThermalLag(1.0, 2e-3), 60.0, 0.0005, 1e-3)
    peak = abs(plant.response(np.array([2 * np.pi * 60.0]))[0])
    assert peak > 15 * abs(plant.response(np.array([2 * np.pi * 60.6]))[0])
    law = pid_law(PidGains(0.4 / peak, 1e-3), 1e-3)
    coarse, fine = (loop_margins(law, plant, points=n).sensitivity_peak for n in (100, 40_000))
    assert fine > 1.2 and coarse == pytest.approx(fine, rel=0.02)
