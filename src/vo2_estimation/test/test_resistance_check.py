"""A sensor that is stuck, saturated or disconnected is seen; a healthy one, however coarse or quiet, is left alone."""

import math

import numpy as np
import pytest
from vo2_estimation.resistance_check import ResistanceCheck, SensorLimits, sensor_limits
from vo2_models.device import truth
from vo2_models.device.description import preset
from vo2_models.identification.excitation import damped_oscillation, random_levels

MODEL = {"model.sensors.film_resistance.noise": 0.002}
PERIOD = 1e-3


def check(parameters=MODEL, device="integrated", **bounds):
    return ResistanceCheck(sensor_limits(device, parameters, **bounds))


def faults(judge, resistance, current, period=PERIOD):
    """Indices of the samples at which something is wrong."""
    return [
        k for k, (r, i) in enumerate(zip(resistance, current, strict=True)) if judge.fault(k * period, r, i)
    ]


def currents(device, kind):
    """Holds and moves over the operating range."""
    cold, hot = preset(device).operating_range
    if kind == "random":
        return np.repeat(random_levels(min(cold, hot), max(cold, hot), 150, seed=3), 10)
    if kind == "sine":
        return cold + (hot - cold) * (0.5 - 0.45 * np.cos(np.linspace(0, 20, 3000)))
    return np.repeat(cold + (hot - cold) * damped_oscillation(np.linspace(0, 1, 15)), 10)


def recorded(device, kind, *, noise=True, step=0.0):
    """(resistance, current) of a simulated device behind a converter with steps of `step` ohm."""
    run = truth(device, seed=1, domains=1500).simulate(currents(device, kind), seed=2, noise=noise)
    resistance = run["film_resistance"]
    if step:
        resistance = np.maximum(np.round(resistance / step), 1) * step
    return resistance, run["heater_current"]


@pytest.mark.parametrize("device", ["integrated", "peltier"])
@pytest.mark.parametrize("kind", ["random", "sine", "oscillation"])
@pytest.mark.parametrize("step", [0.0, 3.7, 60.0, 940.0])
def test_a_healthy_sensor_raises_no_alarm_however_coarse_its_converter(device, kind, step):
    resistance, current = recorded(device, kind, step=step)
    assert faults(check(device=device), resistance, current, preset(device).sample_period) == []


@pytest.mark.parametrize("device", ["integrated", "peltier"])
@pytest.mark.parametrize("kind", ["random", "oscillation"])
def test_an_ideal_sensor_may_stand_still_in_a_hold(device, kind):
    resistance, current = recorded(device, kind, noise=False)
    assert faults(check(device=device), resistance, current, preset(device).sample_period) == []


@pytest.mark.parametrize("step", [0.0, 3.7])
def test_a_stuck_sensor_is_seen_within_a_few_samples_of_a_moving_current(step):
    resistance, current = recorded("integrated", "sine", step=step)
    resistance = resistance.copy()
    resistance[1500:] = resistance[1500]
    found = faults(check(), resistance, current)
    assert 1500 < found[0] <= 1530
    assert found == list(range(found[0], resistance.size))


def test_it_recovers_with_the_next_change():
    judge = check()
    resistance, current = recorded("integrated", "sine")
    stuck = resistance.copy()
    stuck[1500:1600] = stuck[1500]
    assert max(faults(judge, stuck, current)) == 1599


def test_a_reading_that_never_moves_is_stuck_once_the_temperature_has_crossed_half_the_range():
    cold, hot = preset("integrated").operating_range
    current = np.linspace(cold, hot, 2000)
    heat = preset("integrated").steady_temperature
    middle = np.argmax([heat(i) >= 0.5 * (heat(cold) + heat(hot)) for i in current])
    assert middle <= faults(check(), np.full(2000, 1e5), current)[0] <= middle + 20


def test_a_current_too_short_for_a_slow_body_proves_nothing_of_a_coarse_converter():
    cold, hot = preset("peltier").operating_range
    current = np.tile([cold, hot], 10)
    assert faults(check(device="peltier"), np.full(20, 1e5), current, preset("peltier").sample_period) == []


def test_a_clipped_sensor_is_called_saturated():
    resistance, current = recorded("integrated", "sine")
    judge = check(upper_ohm=60e3)
    for k, value in enumerate(np.minimum(resistance, 60e3)):
        said = judge.fault(k * PERIOD, float(value), float(current[k]))
        assert bool(said) == (value == 60e3)
        assert not said or "outside 1119 to 6e+04 ohm" in said


@pytest.mark.parametrize("value", [0.5, 1e9])
def test_an_open_or_shorted_lead_is_beyond_the_preset(value):
    assert "saturated" in check().fault(0.0, value, 0.005)


def test_without_a_current_channel_a_repeat_proves_nothing():
    judge = check()
    assert not any(judge.fault(k * PERIOD, 1e5 + (k == 0), math.nan) for k in range(100))


def test_bounds_in_the_wrong_order_are_named():
    with pytest.raises(ValueError, match=r"sensor\.lower_ohm, sensor\.upper_ohm: found 20 and 10 ohm"):
        SensorLimits(20.0, 10.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0)
