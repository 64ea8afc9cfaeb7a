"""Parts of the fit: derivatives, least squares, grid, noise."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from vo2_models.device import truth
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankShape, evaluate, fit_bank, starting_shape
from vo2_models.identification.bank_uncertainty import bank_uncertainty
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.identification.grid import on_grid
from vo2_models.identification.levenberg_marquardt import levenberg_marquardt
from vo2_models.identification.noise import correlation_inflation, noise_of_residual, residual_colour
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording


def _shape(rng: np.random.Generator, plays: int = 4) -> BankShape:
    return BankShape(
        log_slope=np.log(rng.uniform(0.15, 0.6, plays)),
        centre=rng.uniform(56.0, 62.0, plays),
        log_width=np.log(rng.uniform(1.0, 5.0, plays)),
        log_weight=np.log(rng.uniform(0.05, 0.3, plays)),
        polynomial=rng.normal(size=4) * 0.1,
    )


def _path(seed: int) -> np.ndarray:
    turns = np.random.default_rng(seed).uniform(45.0, 75.0, 12)
    return np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(turns)])


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_derivatives_are_those_of_the_model(seed):
    rng = np.random.default_rng(seed)
    shape, path = _shape(rng), _path(seed)
    _, jacobian = evaluate(shape, path)
    step = 1e-6
    for k in range(shape.vector.size):
        up, down = (
            evaluate(BankShape.of(shape.vector + s * np.eye(shape.vector.size)[k], 4), path)[0]
            for s in (step, -step)
        )
        # an output whose branch changes within the step has no derivative there
        smooth = np.abs(up - 2 * evaluate(shape, path)[0] + down) < 1e-9
        assert smooth.mean() > 0.99
        assert np.allclose(((up - down) / (2 * step))[smooth], jacobian[smooth, k], atol=2e-5)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_bank_and_shape_are_the_same_law(seed):
    shape, path = _shape(np.random.default_rng(seed)), _path(seed)
    bank = shape.bank()
    law = bank.egpi()
    expected, _ = law.simulate(path, law.initial_state(v=-200.0))
    assert np.allclose(evaluate(shape, path)[0], expected, atol=1e-9)
    again = BankShape.of_bank(bank)
    assert np.allclose(evaluate(again, path)[0], expected, atol=1e-9)


def test_fit_recovers_a_bank_of_its_own_family():
    """Its own family with noise: the residual is the noise, and another path is predicted to a fraction of it."""
    rng = np.random.default_rng(1)
    true = _shape(rng, 3)
    path = np.tile(np.concatenate([_path(2), _path(3)]), 2)
    clean = evaluate(true, path)[0]
    noisy = clean + 0.01 * rng.standard_normal(path.size)
    noisy[100:130] = np.nan
    fit = fit_bank(path, noisy, starting_shape(path, noisy, plays=4))
    assert np.nanstd(fit.residual) == pytest.approx(0.01, rel=0.06)
    other = np.clip(_path(9), path.min(), path.max())  # a polynomial does not extrapolate
    gap = evaluate(fit.shape, other)[0] - evaluate(true, other)[0]
    assert np.sqrt(np.mean(gap**2)) < 0.004
    deviations = bank_uncertainty(fit)
    assert set(deviations) == {
        "weights", "rising_slopes", "rising_offsets", "falling_slopes", "falling_offsets", "polynomial"
    }  # fmt: skip
    assert all(np.all(np.isfinite(v)) and np.all(np.array(v) >= 0.0) for v in deviations.values())


def test_fit_needs_enough_samples():
    path = np.linspace(40.0, 80.0, 30)
    with pytest.raises(ValueError, match="values: found 30 measured"):
        fit_bank(path, path, starting_shape(path, path, plays=6))


def test_order_of_envelopes_is_kept():
    shape = _shape(np.random.default_rng(5), 6)
    t = np.linspace(30.0, 90.0, 500)
    bank = shape.bank()
    columns = t[:, None]
    rising = np.tanh(np.asarray(bank.rising_slopes) * columns + np.asarray(bank.rising_offsets))
    falling = np.tanh(np.asarray(bank.falling_slopes) * columns + np.asarray(bank.falling_offsets))
    assert np.all(rising <= falling)


def test_least_squares_with_bounds_and_prior():
    x = np.linspace(0.0, 3.0, 40)
    y = 2.0 * np.exp(-1.3 * x)

    def evaluate_at(theta):
        return theta[0] * np.exp(-theta[1] * x) - y, lambda: np.column_stack(
            [np.exp(-theta[1] * x), -theta[0] * x * np.exp(-theta[1] * x)]
        )

    wide = np.array([10.0, 10.0])
    found = levenberg_marquardt(evaluate_at, np.array([1.0, 0.2]), lower=-wide, upper=wide, tolerance=1e-12)
    assert found.theta == pytest.approx([2.0, 1.3], abs=1e-5)
    assert found.cost == pytest.approx(0.0, abs=1e-9)
    held = levenberg_marquardt(
        evaluate_at, np.array([1.0, 0.2]), lower=-wide, upper=np.array([10.0, 0.9]), tolerance=1e-12
    )
    assert held.theta[1] == 0.9
    # the best amplitude for the exponent at its bound, by linear least squares
    column = np.exp(-0.9 * x)
    assert held.theta[0] == pytest.approx(column @ y / (column @ column), abs=1e-6)
    stiff = levenberg_marquardt(
        evaluate_at,
        np.array([1.0, 0.2]),
        lower=-wide,
        upper=wide,
        prior=np.array([1e9, 0.0]),
        tolerance=1e-12,
    )
    assert stiff.theta[0] == pytest.approx(1.0, abs=1e-6)


def _recording() -> Recording:
    time = np.r_[np.arange(20) * 0.01, 0.25 + np.arange(20) * 0.01]
    current = np.linspace(0.004, 0.008, 40)
    commanded = np.r_[np.nan, current[1:]]
    resistance = np.r_[np.full(39, 1e4), -5.0]
    channels = {HEATER_CURRENT: current + 1e-5, COMMANDED_CURRENT: commanded, RESISTANCE: resistance}
    return Recording(time, channels, "integrated")


def test_grid_fills_gaps_and_prefers_commands():
    grid = on_grid(_recording())
    assert grid.dt == pytest.approx(0.01)
    assert grid.current.size == 45
    assert grid.commanded
    assert grid.current[0] == pytest.approx(0.00401)
    assert grid.current[1] == pytest.approx(0.004 + 0.004 / 39)
    assert np.all(grid.current[20:25] == grid.current[19])
    y = grid.measured[RESISTANCE]
    assert np.all(np.isnan(y[20:25])) and np.isnan(y[-1])
    assert np.all(y[:20] == -4.0)
    with pytest.raises(ValueError, match="heater_current"):
        on_grid(Recording(np.arange(20.0), {RESISTANCE: np.ones(20)}))
    with pytest.raises(ValueError, match="16"):
        on_grid(_recording().slice(0, 10))


def test_grid_counts_samples_that_come_early_or_late_right():
    count = 20_000
    late = np.random.default_rng(1).uniform(-0.25, 0.25, count)
    current = np.arange(count) % 977 + 1.0
    time = 0.01 * (np.arange(count) + late)
    grid = on_grid(Recording(time, {COMMANDED_CURRENT: current, TIP_DEFLECTION: 100.0 * time}, "integrated"))
    assert np.array_equal(grid.current, current)
    assert np.allclose(grid.measured[TIP_DEFLECTION], np.arange(count), atol=0.02)


@pytest.mark.parametrize("colour", [0.0, 0.5, 0.9])
def test_noise_is_told_from_misfit(colour):
    rng = np.random.default_rng(3)
    e = np.zeros(8000)
    white = rng.standard_normal(e.size) * np.sqrt(1 - colour**2)
    for k in range(1, e.size):
        e[k] = colour * e[k - 1] + white[k]
    signal = 50.0 * np.sin(np.arange(e.size) / 300)
    misfit = 2.0 * np.sin(np.arange(e.size) / 120)
    level, found = noise_of_residual(0.1 * (e + misfit), signal)
    assert found == pytest.approx(colour, abs=0.05)
    assert level == pytest.approx(0.1, rel=0.12)


@pytest.mark.parametrize("apart", [2, 4])
@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_noise_of_a_slow_channel_is_told_too(colour, apart):
    rng = np.random.default_rng(5)
    e = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(16_000))
    signal = 50.0 * np.sin(np.arange(e.size) / 300)
    slow = np.full(e.size, np.nan)
    slow[1::apart] = 0.1 * e[1::apart]
    level, found = noise_of_residual(slow, signal)
    assert found == pytest.approx(colour, abs=0.05)
    assert level == pytest.approx(0.1, rel=0.12)


def test_a_calibration_with_a_slow_channel_is_fitted():
    current = 3.68e-3 + 4.81e-3 * np.repeat(np.random.default_rng(1).uniform(size=60), 30)
    whole = truth("integrated", seed=1).simulate(current, seed=1)
    time_s, every = 1e-3 * np.arange(current.size), np.arange(current.size) % 3 == 0
    channels = {name: whole[name].copy() for name in (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)}
    channels[TIP_DEFLECTION][~every] = np.nan
    fitted = fit_device([Recording(time_s, channels, "integrated")], "integrated").model
    reference = fit_device(
        [Recording(time_s, {n: whole[n] for n in channels}, "integrated")], "integrated"
    ).model
    for name in (RESISTANCE, TIP_DEFLECTION):
        assert fitted.sensors[name].noise == pytest.approx(reference.sensors[name].noise, rel=0.25)


def test_correlation_of_a_residual():
    rng = np.random.default_rng(4)
    white = rng.standard_normal(20_000)
    assert residual_colour(white) == ()
    assert correlation_inflation(white) == pytest.approx(1.0, abs=0.15)
    red = np.zeros(white.size)
    for k in range(2, red.size):
        red[k] = 0.5 * red[k - 1] + 0.2 * red[k - 2] + white[k]
    assert residual_colour(red) == pytest.approx((0.5, 0.2), abs=0.03)
    assert correlation_inflation(red) > 3.0


def test_loop_of_the_ground_truth_is_learnt():
    """Six plays on the true temperature already follow the domains to a fifth of a per cent of range."""
    device = truth("integrated", seed=1)
    train = device.simulate(np.repeat(damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 21)), 10), seed=1)
    test = device.simulate(np.repeat(random_levels(3.68e-3, 8.49e-3, 200, seed=5), 10), noise=False)
    path, values = train["true_temperature"], train[TIP_DEFLECTION]
    fit = fit_bank(path, values, starting_shape(path, values, plays=6))
    gap = evaluate(fit.shape, test["true_temperature"])[0] - test["true_tip_deflection"]
    assert np.mean(np.abs(gap)) < 0.002 * 57.03e-6


def test_the_width_at_half_height_is_that_of_the_branches_over_a_range():
    # a play of width 6 K in the range, and one so far beyond that its loop is never done
    bank = PlayBank([1.0, 0.4], [0.0, 0.0], [0.4, 0.1], [-26.0, -14.0], [0.4, 0.1], [-23.6, -9.0], [3.0])
    rising, falling, span = bank.half_way(30.0, 90.0)
    up = np.linspace(30.0, 90.0, 60_001)
    memory = bank.settle(30.0)
    heating = bank.run(up, memory)
    cooling = bank.run(up[::-1], memory)[::-1]
    middle = 0.5 * (heating.min() + heating.max())
    assert span == pytest.approx(np.ptp(heating), rel=1e-3)
    assert rising == pytest.approx(up[np.argmax(heating >= middle)], abs=0.1)
    assert falling == pytest.approx(up[np.argmax(cooling >= middle)], abs=0.1)
    assert math.isnan(PlayBank([1.0], [0.0], [0.4], [-44.0], [0.4], [-36.0]).half_way(20.0, 30.0)[1])
