"""The concealed heat flow against references: the exact solution, an independent integrator, energy balances."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vo2_studies.challenge.core import REVERSAL_THRESHOLD, Terms, run_core
from vo2_studies.challenge.devices import PRESETS, draw_device
from vo2_studies.challenge.filters import (
    backlash,
    boxcar,
    half_order,
    lag,
    log_relaxation,
    oscillator,
    rate_limit,
)

STEP = 1.25e-4


def run(device, current, terms=None, step=STEP, **arrays):
    n = current.size
    full = {"ambient": np.full(n, device.ambient), "local": np.zeros(n), "shift": np.zeros(n)} | arrays
    return run_core(device, terms or Terms(), current=current, step=step, **full)


@pytest.fixture
def integrated():
    return draw_device(np.random.default_rng(8), "integrated")


def test_step_is_first_order(integrated):
    current = np.full(200, 5e-3)
    temperature, film, *_ = run(integrated, current)
    t = np.arange(201) * STEP
    rise = integrated.gain * 25e-6
    expected = integrated.ambient + rise * (1 - np.exp(-t / integrated.time_constant))
    assert np.allclose(temperature, expected, atol=1e-4 * rise)
    assert np.array_equal(film, temperature)


def test_nonlinear_terms_agree_with_another_integrator(integrated):
    terms = Terms(
        cooling_ratio=1.3, loss_beta=2e-3, loss_power=2.0, heater_tcr=1e-3, slow_gain=0.05, slow_time=0.02
    )
    current = np.repeat([4e-3, 5.0e-3, 3.0e-3], 200)  # stays below the transition
    temperature, *_ = run(integrated, current, terms)
    tau, a = integrated.time_constant, integrated.ambient

    def slope(t, x):
        i = current[min(int(t / STEP), current.size - 1)]
        power, rise = integrated.gain * i * i, x[0] - a
        rate = (power * (1 + terms.heater_tcr * rise) - rise - terms.loss_beta * rise**2) / tau
        return [rate / 1.3 if rate < 0 else rate, (terms.slow_gain * power - x[1]) / terms.slow_time]

    end = current.size * STEP
    exact = solve_ivp(
        slope, (0, end), [a, 0.0], t_eval=np.arange(current.size) * STEP, max_step=STEP, rtol=1e-8
    )
    assert np.allclose(temperature[:-1], exact.y.sum(axis=0), atol=0.02)


def test_latent_heat_is_conserved(integrated):
    """Across the whole transition the film takes up L more heat, and gives it back: integrate the heat flow."""
    latent = 8.0
    current = np.concatenate([np.full(2000, 9e-3), np.full(2000, 3e-3)])
    for part in (slice(0, 2000), slice(2000, 4000)):
        stored = []
        for terms in (Terms(), Terms(latent=latent)):
            temperature, _, metal, *_ = run(integrated, current, terms)
            power = integrated.gain * current**2
            flow = (power - ((temperature[:-1] + temperature[1:]) / 2 - integrated.ambient))[part]
            stored.append(flow.sum() * STEP / integrated.time_constant)
            assert metal[2000] == pytest.approx(1.0, abs=2e-3)
            assert metal[-1] == pytest.approx(0.0, abs=2e-3)
        assert stored[1] - stored[0] == pytest.approx(
            latent if part.start == 0 else -latent, rel=0.03, abs=0.05
        )


def test_latent_heat_slows_and_vanishes_with_its_coefficient(integrated):
    current = np.full(400, 8e-3)
    plain = run(integrated, current)[0]
    tiny = run(integrated, current, Terms(latent=1e-9))[0]
    held = run(integrated, current, Terms(latent=8.0))[0]
    assert np.allclose(plain, tiny, atol=1e-6)
    assert np.all(held <= plain + 1e-4)
    assert (plain - held).max() > 1.0
    assert held[-1] == pytest.approx(plain[-1], abs=0.01)


def test_kinetics_lag_the_fraction_exponentially(integrated):
    tau = 5e-3
    local = np.full(400, 90.0)  # far above the transition at once
    *_, metal, structure, _ = run(integrated, np.zeros(400), Terms(kinetic_time=tau), local=local)
    t = np.arange(401) * STEP
    expected = 1 - np.exp(-t / tau)
    # the start already sees the film above its threshold only from the first step on
    assert np.allclose(metal, expected, atol=1e-9)
    assert np.allclose(structure, expected, atol=1e-9)


def test_reversals_are_counted_from_a_threshold(integrated):
    swing = integrated.ambient + 20 + np.array([0, 10, 0, 10, 0]) * 1.0
    temperature = np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(swing)])
    base = integrated.gain * (5e-3) ** 2
    current = np.sqrt((base + temperature - temperature[0]) / integrated.gain)
    assert run(integrated, np.repeat(current, 40))[-1] == 3
    ripple = np.sqrt((base + 0.4 * REVERSAL_THRESHOLD * np.sin(np.arange(400))) / integrated.gain)
    assert run(integrated, np.repeat(ripple, 40))[-1] <= 1


def test_sense_current_heats_in_proportion_to_the_resistance(integrated):
    rise = 2.0
    terms = Terms(sense_heating=rise / integrated.preset.resistance[1])
    temperature, *_ = run(integrated, np.zeros(2000), terms)
    # at ambient the film is semiconducting, somewhat above its resistance at the cold end of operation
    assert rise < temperature[-1] - integrated.ambient < 1.8 * rise


def test_peltier_terms_have_the_stated_steady_state():
    device = draw_device(np.random.default_rng(8), "peltier")
    terms = Terms(joule=5.0, pumping=0.1)
    for i in (-0.8, 0.5):
        temperature, *_ = run(device, np.full(20000, i), terms, step=0.03125)
        rise = (device.gain * i + 5.0 * i * i) / (1 + 0.1 * i)
        assert temperature[-1] - device.ambient == pytest.approx(rise, rel=1e-3)


def test_oscillator_agrees_with_another_integrator():
    step, f, z = 1e-3, 30.0, 0.03
    t = np.arange(400) * step
    v = np.where(t > 0.05, 1.0, 0.0) + 0.3 * np.sin(40 * t)
    w = 2 * np.pi * f
    exact = solve_ivp(
        lambda s, x: [x[1], w * w * (np.interp(s, t, v) - x[0]) - 2 * z * w * x[1]],
        (0, t[-1]),
        [v[0], 0.0],
        t_eval=t,
        max_step=step / 4,
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    assert np.allclose(oscillator(v, step, f, z), exact, atol=2e-4)


def test_log_relaxation_follows_its_law_at_rest_and_is_forgotten():
    rest = np.concatenate([np.linspace(50, 60, 100), np.full(3000, 60.0)])
    x = log_relaxation(rest, 1e-3, 0.01, 0.02, 0.3)
    t = np.arange(2900) * 1e-3
    assert np.allclose(x[100:3000], x[99] + 0.01 * np.log(1 + t / 0.02), atol=2e-3)
    moved = np.concatenate([rest, np.linspace(60, 64, 4)])
    assert log_relaxation(moved, 1e-3, 0.01, 0.02, 0.3)[-1] < 0.1 * x[-1]
    falling = log_relaxation(np.concatenate([rest[::-1][-100:], np.full(100, 50.0)]), 1e-3, 0.01, 0.02, 0.3)
    assert falling[-1] < 0


def test_small_filters_by_definition():
    v = np.array([0.0, 1.0, 1.0, -1.0, 0.5])
    assert np.allclose(rate_limit(v, 0.4), [0.0, 0.4, 0.8, 0.4, 0.5])
    assert np.allclose(backlash(v, 0.3), [0.0, 0.7, 0.7, -0.7, 0.2])
    y = lag(np.concatenate([[0.0], np.ones(5)]), 1.0, 2.0)
    assert np.allclose(y[1:], 1 - np.exp(-np.arange(1, 6) / 2))
    assert lag(v, 1.0, 0.0) is v


def test_presets_are_the_contracts():
    a, b = PRESETS["integrated"], PRESETS["peltier"]
    assert float(a.steady_temperature(8.49e-3)) == pytest.approx(22 + 1.01e6 * 8.49e-3**2)
    assert float(b.steady_temperature(-1.15)) == pytest.approx(25 + 57.5)
    assert float(a.steady_current(a.steady_temperature(5e-3))) == pytest.approx(5e-3)
    assert (a.sample_period, b.sample_period) == (1e-3, 0.125)


def test_boxcar_is_the_mean_over_its_length():
    step = 1e-3
    ramp = np.arange(400) * step * 3.0
    averaged = boxcar(ramp, step, 0.05)
    assert np.allclose(averaged[60:], ramp[60:] - 3.0 * 0.025, atol=1e-12)
    assert np.allclose(boxcar(np.full(50, 2.0), step, 0.01), 2.0)
    # a length between two samples, against the integral
    wave = np.sin(np.arange(400) * 0.05)
    fine = np.interp(np.linspace(0.3 - 0.0333, 0.3, 4001), np.arange(400) * step, wave)
    assert boxcar(wave, step, 0.0333)[300] == pytest.approx(np.trapezoid(fine, dx=1 / 4000), abs=1e-7)


def test_half_order_memory_has_its_frequency_response():
    """1 / (1 + sqrt(i w tau)) at one frequency, once the start has died away."""
    step, tau, period = 1e-3, 0.05, 0.4
    t = np.arange(20_000) * step
    w = 2 * np.pi / period
    out = half_order(np.sin(w * t), step, tau)[-4000:]
    found = 2 * np.mean(out * np.exp(-1j * w * t[-4000:])) * 1j
    # the integral over whole periods; a change per sample is centred half a step late
    assert found == pytest.approx(1 / (1 + np.sqrt(1j * w * tau)), abs=0.01)
