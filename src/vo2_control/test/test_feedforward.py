"""Inverse compensation: exact on its own model, useful on a device that is not, and its refusals."""

import math

import numpy as np
import pytest
from vo2_control.closed_loop import run_loop
from vo2_control.controller import CurrentLimits
from vo2_control.feedforward import (
    InverseFeedforward,
    NonMonotonicSolver,
    PlayInverse,
    ThermalPath,
    feedforward_from_model,
)
from vo2_control.model_tuning import tuned_from_model
from vo2_control.pid import PidGains, pid_controller
from vo2_models.device import truth
from vo2_models.hysteresis import EGPI, Polynomial, TanhEnvelopes
from vo2_models.hysteresis.preisach.nonmonotonic import NonMonotonicPreisach
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation

PERIOD = 1e-3
LIMITS = CurrentLimits(0.0, 12.78e-3)
THERMAL = ThermalPath(22.0, 0.0, 1.01e6, 1.8e-3)


def play_model():
    slopes, radii = np.full(4, 0.25), np.array([0.0, 0.15, 0.3, 0.5])
    return EGPI(
        radii=radii,
        weights=np.array([12e-6, 8e-6, 6e-6, 3e-6]),
        envelopes=TanhEnvelopes(slopes, -slopes * 62, slopes, -slopes * 55),
        memoryless=Polynomial([35e-6, -0.1e-6]),
    )


def preisach_model():
    walls = np.linspace(45.0, 75.0, 16)
    centre = np.add.outer(walls[:-1], walls[:-1])
    density = np.exp(-(((centre - 117) / 12) ** 2))[np.tril_indices(15)]
    return NonMonotonicPreisach(
        PreisachOperator(walls, 30e-6 * density / density.sum(), 30e-6), 0.06e-6, 0.1e-6, 22.0
    )


def inverse(kind):
    return PlayInverse(play_model(), (30.0, 95.0)) if kind == "play" else NonMonotonicSolver(preisach_model())


def respond(kind, current):
    """The same thermal path and hysteresis model run as a device by the ordinary simulation."""
    decay, temperature, path = math.exp(-PERIOD / 1.8e-3), 22.0, []
    for i in current:
        temperature = decay * temperature + (1 - decay) * (22.0 + 1.01e6 * i * i)
        path.append(temperature)
    if kind == "play":
        model = play_model()
        return model.simulate(path, model.initial_state(v=30.0))[0]
    return preisach_model()(np.clip(path, 45.0, 75.0))


def reference(kind):
    t = np.arange(1500) * PERIOD
    middle, size = (32e-6, 12e-6) if kind == "play" else (20e-6, 10e-6)
    return middle + size * (0.6 * np.sin(2 * np.pi * 2 * t) - 0.4 * np.sin(2 * np.pi * 7 * t))


@pytest.mark.parametrize("kind", ["play", "preisach"])
def test_exact_on_its_own_model_one_sample_later(kind):
    wanted = reference(kind)
    ahead = InverseFeedforward(inverse(kind), THERMAL, LIMITS, PERIOD, response_s=0.0)
    current, expected = ahead.run(wanted)
    got = respond(kind, current)
    # the deflection of sample k belongs to the reference of sample k; unreachable at the limits right after reversals
    error = np.abs(got - wanted)[200:]
    assert np.median(error) < 1e-10
    assert np.mean(error > 1e-8) < 0.05
    np.testing.assert_allclose(expected[1:], got[:-1], atol=1e-10)


@pytest.mark.parametrize("kind", ["play", "preisach"])
def test_without_lead_the_lag_remains(kind):
    wanted = reference(kind)
    plain = InverseFeedforward(inverse(kind), THERMAL, LIMITS, PERIOD, lead=False)
    led = InverseFeedforward(inverse(kind), THERMAL, LIMITS, PERIOD)
    errors = [np.sqrt(np.mean((respond(kind, f.run(wanted)[0]) - wanted)[200:] ** 2)) for f in (plain, led)]
    assert errors[1] < 0.5 * errors[0]


@pytest.fixture(scope="module")
def identified():
    """A simulated device and the model fitted to its own noisy recording."""
    device = truth("integrated", seed=2, domains=1500)
    share = damped_oscillation(np.linspace(0, 1, 21))
    recording = device.simulate(np.repeat(3.68e-3 + share * (8.49e-3 - 3.68e-3), 10), seed=3)
    return device, fit_device([recording], "integrated").model.to_parameters()


def test_open_loop_on_a_device_it_was_identified_from(identified):
    """The largest error 4.1 % and the root mean square 1.4 % of the range, as section 5.4.2 measured."""
    device, parameters = identified
    t = np.arange(20000) * PERIOD
    wanted = 1e-6 * (30 + 15 * np.sin(2 * np.pi * 0.1 * t) + 8 * np.sin(2 * np.pi * 0.37 * t))
    current, _ = feedforward_from_model(parameters, PERIOD).run(wanted)
    silent = pid_controller(PidGains(0.0, 0.0), LIMITS, PERIOD)
    error = run_loop(device, None, silent, wanted, feedforward_a=current).error_m[1000:] / 57.03e-6
    assert np.abs(error).max() < 0.041 and np.sqrt(np.mean(error**2)) < 0.014


def test_with_feedback_at_most_half_the_error_of_feedback_alone(identified):
    device, parameters = identified
    t = np.arange(5000) * PERIOD
    wanted = 1e-6 * (30 + 4 * np.sin(2 * np.pi * t) - 6 * np.sin(2 * np.pi * 10 * t))
    controller = pid_controller(tuned_from_model(parameters, PERIOD).gains, LIMITS, PERIOD)
    current, _ = feedforward_from_model(parameters, PERIOD).run(wanted)
    alone = run_loop(device, None, controller, wanted).error_m[250:]
    both = run_loop(device, None, controller, wanted, feedforward_a=current).error_m[250:]
    assert np.abs(both).mean() < 0.5 * np.abs(alone).mean()


def test_limits_and_unreachable_references():
    limits = CurrentLimits(2e-3, 7e-3, 0.5)
    ahead = InverseFeedforward(inverse("play"), THERMAL, limits, PERIOD)
    current, _ = ahead.run(np.repeat([1.0, -1.0, 30e-6], 100))
    assert current.min() >= 2e-3 and current.max() <= 7e-3
    assert np.abs(np.diff(current)).max() <= 0.5 * PERIOD + 1e-12


def test_the_temperature_is_led_no_faster_than_its_rate_and_without_lag_below_it():
    slow = ThermalPath(25.0, -50.0, 0.0, 25.0)
    limits = CurrentLimits(-1.2, 1.2)

    def led(reference, rate):
        ahead = InverseFeedforward(
            PlayInverse(play_model(), (30.0, 95.0)), slow, limits, 0.125, 0.0, rate_k_per_s=rate
        )
        currents, expected = ahead.run(reference)
        decay, temperature, path = math.exp(-0.125 / 25.0), 25.0, []
        for i in currents:
            temperature = decay * temperature + (1 - decay) * (25.0 - 50.0 * i)
            path.append(temperature)
        return np.array(path), expected

    # up, and a reversal: the inverse crosses the width of the loop at once, the temperature at its rate
    t = np.arange(0, 400, 0.125)
    reference = 30e-6 - 15e-6 * np.cos(2 * np.pi * t / 200)
    free, _ = led(reference, math.inf)
    held, expected = led(reference, 0.3)
    steps = np.abs(np.diff(held)) / 0.125
    assert steps.max() == pytest.approx(0.3, rel=1e-6)
    assert np.abs(np.diff(free)).max() / 0.125 > 0.6
    # off the crossings it follows exactly, where a response of the same effort would lag
    assert np.median(np.abs(expected[1200:] - reference[1199:-1])) < 1e-9


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="rate_k_per_s"):
        InverseFeedforward(inverse("play"), THERMAL, LIMITS, PERIOD, rate_k_per_s=rate)


def test_reset_and_bad_reference():
    ahead = InverseFeedforward(inverse("play"), THERMAL, LIMITS, PERIOD)
    first = ahead.run(reference("play")[:300])[0]
    with pytest.raises(ValueError, match="reference_m"):
        ahead.update(math.nan)
    ahead.reset()
    np.testing.assert_array_equal(ahead.run(reference("play")[:300])[0], first)
    with pytest.raises(ValueError, match="exactly one"):
        ThermalPath(22.0, 0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="response_s"):
        InverseFeedforward(inverse("play"), THERMAL, LIMITS, PERIOD, response_s=-1.0)


def test_a_film_that_heats_itself_has_no_feedforward(identified):
    parameters = {**identified[1], "model.thermal.power_gain": 100.0}
    with pytest.raises(ValueError, match=r"model\.thermal\.power_gain: found 100 K/W.*without feedforward"):
        feedforward_from_model(parameters, PERIOD)
