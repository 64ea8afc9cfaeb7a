"""The dynamic composite scheme: the mode it finds, the error it saves, and the static scheme it falls back to."""

import itertools
import math

import numpy as np
import pytest
from vo2_models.device import truth
from vo2_models.device.mode import mode_step
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing import DynamicSelfSensing, self_sensing
from vo2_models.self_sensing.dynamic import advance_mode
from vo2_models.self_sensing.mode_fit import fit_mode, grid_gain, through_mode
from vo2_models.self_sensing.records import MODE
from vo2_studies.self_sensing.dynamic_study import (
    RESONANCE,
    chirp_current,
    identification_current,
    identified,
)

SMALL = {"level": 14, "steps": 40, "plays": 6}
TRUE = RESONANCE["cantilever_resonance"]


@pytest.fixture(scope="module", params=[2, 9])
def resonant(request):
    """A device of thousands of switching domains with a mode, and what its noisy recording identified."""
    device = truth("integrated", seed=request.param, effects=RESONANCE)
    return device, identified(device, request.param, **SMALL)


@pytest.fixture(scope="module")
def rigid():
    """A device without mode, and what its recording identified."""
    device = truth("integrated", seed=5)
    return device, identified(device, 5, **SMALL)


def test_the_mode_is_recovered(resonant):
    _, parameters = resonant
    assert parameters[f"{MODE}.frequency"] == pytest.approx(TRUE["frequency"], rel=0.01)
    assert parameters[f"{MODE}.damping"] == pytest.approx(TRUE["damping"], rel=0.2)
    assert parameters[f"{MODE}.share"] == pytest.approx(TRUE["share"], abs=0.1)
    assert self_sensing("dynamic", parameters).note == ""


def test_under_a_chirp_the_error_is_at_most_half_of_the_static_one(resonant):
    device, parameters = resonant
    test = device.simulate(chirp_current(3.0), seed=77)
    error = {}
    for kind in ("composite", "dynamic"):
        found, _ = self_sensing(kind, parameters).estimate(test[RESISTANCE])
        error[kind] = np.abs(found.deflection - test["true_tip_deflection"])[50:].mean()
    assert error["dynamic"] <= 0.5 * error["composite"]


def test_the_bound_covers_fresh_errors_of_the_kind_it_was_identified_on(resonant):
    device, parameters = resonant
    test = device.simulate(identification_current(SMALL["level"], SMALL["steps"]), seed=78)
    found, _ = self_sensing("dynamic", parameters).estimate(test[RESISTANCE])
    gap = np.abs(found.deflection - test["true_tip_deflection"])
    assert np.mean(gap <= found.bound) > 0.85


def test_stream_equals_batch_and_memory_can_be_carried_over(resonant):
    device, parameters = resonant
    resistance = device.simulate(chirp_current(0.5), seed=3)[RESISTANCE]
    scheme = self_sensing("dynamic", parameters)
    whole, final = scheme.estimate(resistance)
    first, memory = scheme.estimate(resistance[:200])
    rest, after = scheme.estimate(resistance[200:], memory)
    np.testing.assert_array_equal(np.concatenate([first.deflection, rest.deflection]), whole.deflection)
    np.testing.assert_array_equal(after, final)
    state = scheme.initial_state()
    stream = [scheme.update(r, state).deflection for r in resistance]
    np.testing.assert_array_equal(stream, whole.deflection)


def test_a_sample_that_is_no_number_leaves_the_memory(resonant):
    device, parameters = resonant
    scheme = self_sensing("dynamic", parameters)
    _, state = scheme.estimate(device.simulate(chirp_current(0.1), seed=3)[RESISTANCE])
    before = state[-4:].copy()
    assert math.isnan(scheme.step(math.nan, state)[0])
    np.testing.assert_array_equal(state[-4:], before)


def test_without_mode_it_is_the_composite_bit_for_bit_and_says_so(rigid):
    device, parameters = rigid
    assert parameters[f"{MODE}.share"] == 0.0
    assert parameters[f"{MODE}.note"]
    resistance = device.simulate(chirp_current(0.5), seed=3)[RESISTANCE]
    dynamic = self_sensing("dynamic", parameters)
    static = self_sensing("composite", parameters)
    assert isinstance(dynamic, DynamicSelfSensing)
    assert "dynamics unidentified" in dynamic.note
    assert str(parameters[f"{MODE}.note"]) in dynamic.note
    for found, expected in zip(dynamic.estimate(resistance)[0], static.estimate(resistance)[0], strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_model_file_without_any_mode_falls_back(rigid):
    _, parameters = rigid
    older = {name: value for name, value in parameters.items() if not name.startswith(MODE)}
    scheme = self_sensing("dynamic", older)
    assert scheme.mode is None
    assert "holds no mode" in scheme.note


def test_a_mode_above_half_the_sampling_rate_is_refused(resonant):
    _, parameters = resonant
    with pytest.raises(ValueError, match=r"mode\.frequency: found 150"):
        self_sensing("dynamic", {**parameters, f"{MODE}.sample_period": 4e-3, f"{MODE}.frequency": 150.0})


def plain_mode(u, frequency, damping, period, parts=400):
    """z'' + 2 zeta w z' + w^2 z = w^2 u by small explicit steps, u linear between samples."""
    w, h = 2 * math.pi * frequency, period / parts
    z, rate, out = u[0], 0.0, [u[0]]
    for last, new in itertools.pairwise(u):
        for k in range(parts):
            drive = last + (new - last) * (k + 0.5) / parts
            rate += h * (w * w * (drive - z) - 2 * damping * w * rate)
            z += h * rate
        out.append(z)
    return np.array(out)


def test_kernels_follow_the_differential_equation():
    u = np.random.default_rng(2).normal(size=30)
    step = mode_step(60.0, 0.05, 1e-3)
    expected = plain_mode(u, 60.0, 0.05, 1e-3)
    out = np.empty((30, 1))
    through_mode(u[:, None], step, out)
    np.testing.assert_allclose(out[:, 0], expected, atol=3e-3)
    memory = np.zeros(4)
    stream = [advance_mode(value, step, 0.7, memory) for value in u]
    np.testing.assert_allclose(stream, 0.3 * u + 0.7 * out[:, 0], atol=1e-13)


def test_grid_gain_is_the_energy_that_the_best_share_removes():
    rng = np.random.default_rng(3)
    u, residual, used = rng.normal(size=200), rng.normal(size=200), rng.random(200) < 0.6
    step, out, gain = mode_step(90.0, 0.1, 1e-3), np.empty((200, 1)), np.empty(1)
    through_mode(u[:, None], step, out)
    part = (out[:, 0] - u)[used]
    for sign in (1.0, -1.0):
        target = residual + sign * 0.4 * (out[:, 0] - u)
        grid_gain(u, target, used, step[None], gain)
        shares = np.linspace(0, 1, 100001)
        energy = np.sum(target[used] ** 2)
        left = energy - 2 * shares * (part @ target[used]) + shares**2 * (part @ part)
        assert gain[0] == pytest.approx(energy - left.min(), rel=1e-6, abs=1e-9)


def ringing(frequency, damping, share):
    """4 s of random steps and what a mode makes of them, with noise."""
    rng = np.random.default_rng(4)
    static = np.repeat(rng.uniform(0, 50e-6, 160), 25)
    out = np.empty((static.size, 1))
    through_mode(static[:, None], mode_step(frequency, damping, 1e-3), out)
    return static, (1 - share) * static + share * out[:, 0] + 0.1e-6 * rng.normal(size=static.size)


def test_fit_mode_refuses_one_too_slow_for_the_recording():
    mode, why = fit_mode(*ringing(3.0, 0.1, 0.4), 1e-3)
    assert mode is None
    assert "no mode between 4 and 475 Hz" in why


@pytest.mark.parametrize(("frequency", "damping", "share"), [(12.0, 0.1, 0.4), (330.0, 0.004, 1.0)])
def test_fit_mode_finds_any_mode_below_nyquist(frequency, damping, share):
    mode, why = fit_mode(*ringing(frequency, damping, share), 1e-3)
    assert why == ""
    assert mode.frequency == pytest.approx(frequency, rel=0.01)
    assert mode.damping == pytest.approx(damping, rel=0.1)
    assert mode.share == pytest.approx(share, abs=0.05)


def test_fit_mode_refuses_noise_a_lag_and_too_little():
    rng = np.random.default_rng(5)
    static = np.repeat(rng.uniform(0, 50e-6, 100), 20)
    mode, why = fit_mode(static, static + 0.1e-6 * rng.normal(size=static.size), 1e-3)
    assert mode is None
    assert "50 % are needed" in why or "no mode" in why
    mode, why = fit_mode(static[:50], static[:50] * 1.1, 1e-3)
    assert mode is None
    assert "too few" in why
    lagged = np.empty_like(static)
    lagged[0] = static[0]
    for k in range(1, static.size):
        lagged[k] = lagged[k - 1] + 0.2 * (static[k] - lagged[k - 1])
    mode, why = fit_mode(static, lagged, 1e-3)
    assert mode is None
    assert why
