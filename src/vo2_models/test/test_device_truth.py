"""The simulated device: the contract's numbers, its domains, and the same run in batch and as a stream."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.device import preset, surrogate_of_temperature, temperature_of_surrogate, truth
from vo2_models.device.ensemble import ensemble_peek, ensemble_step, population, sort_population
from vo2_models.device.laws import arc_tip, mixture_conductance
from vo2_models.recording import COMMANDED_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

PRESETS = ("integrated", "peltier")


def _slow_loop(name: str, steps: int = 1200) -> np.ndarray:
    """Down to the cold end, slowly up to the hot end and back, each level long enough to settle."""
    cold, hot = preset(name).operating_range
    hold = 12 if name == "integrated" else 1
    up = np.linspace(cold, hot, steps if name == "integrated" else 20 * steps)
    settle = np.full(60 if name == "integrated" else 2000, cold)
    return np.repeat(np.concatenate([settle, up, up[::-1]]), hold)


@pytest.mark.parametrize("name", PRESETS)
def test_nominal_device_spans_the_published_ranges(name):
    nominal = preset(name)
    settle = 60 * 12 if name == "integrated" else 2000
    run = truth(name).simulate(_slow_loop(name), noise=False)
    r, d = run["true_film_resistance"][settle:], run["true_tip_deflection"][settle:]
    # the slow ramp lags by a fraction of a kelvin, a per cent of resistance
    assert (r.min(), r.max()) == pytest.approx(nominal.resistance_range, rel=0.02)
    low, high = nominal.deflection_extent
    assert (d.min(), d.max()) == pytest.approx((low, high), abs=0.003 * nominal.deflection_range)


@pytest.mark.parametrize("name", PRESETS)
def test_transition_has_the_published_statistics(name):
    nominal = preset(name)
    alpha, beta, offset = population(
        20_000, heating=nominal.heating, width=nominal.width, offset=nominal.offset, seed=4
    )
    assert (alpha.mean(), alpha.std()) == pytest.approx(nominal.heating, abs=0.1)
    assert ((alpha - beta).mean(), (alpha - beta).std()) == pytest.approx(nominal.width, abs=0.1)
    assert (offset.mean(), offset.std()) == pytest.approx(nominal.offset, abs=0.1)
    even = population(4000, heating=nominal.heating, width=nominal.width, offset=nominal.offset)
    for values, (mean, deviation) in zip(
        (even[0], even[0] - even[1], even[2]), (nominal.heating, nominal.width, nominal.offset), strict=True
    ):
        assert (values.mean(), values.std()) == pytest.approx((mean, deviation), abs=0.02)
    assert abs(np.corrcoef(even[0], even[2])[0, 1]) < 0.03


@pytest.mark.parametrize("name", PRESETS)
def test_loop_looks_like_vo2(name):
    """Heating branch at the higher temperature; resistance falls everywhere; deflection rises and falls."""
    run = truth(name, seed=5).simulate(_slow_loop(name), noise=False)
    settled = 100 * 12 if name == "integrated" else 2200
    t = run["true_temperature"][settled:]
    y = np.log10(run["true_film_resistance"])[settled:]
    d = run["true_tip_deflection"][settled:]
    top = int(np.argmax(t))
    up, down = slice(0, top), slice(top, None)
    middle = 0.5 * (y.min() + y.max())
    heating = np.interp(-middle, -y[up], t[up])
    cooling = np.interp(middle, y[down], t[down])
    assert 5.0 < heating - cooling < 9.5
    assert np.all(np.diff(y[up]) <= 1e-12)
    rise = np.argmin(d[up]), np.argmax(d[up])
    assert 0 < rise[0] < rise[1] < top - 1
    assert d[up][0] - d[up][rise[0]] > 0.01 * np.ptp(d)
    assert d[up][rise[1]] - d[top] > 0.01 * np.ptp(d)
    # resistance stays informative on the metallic plateau: a few 1e-3 decades per kelvin
    hot = t[up] > t.max() - 5.0
    assert 2e-3 < -np.polyfit(t[up][hot], y[up][hot], 1)[0] < 6e-3


@pytest.mark.parametrize("name", PRESETS)
def test_stream_equals_batch_bit_for_bit(name):
    rng = np.random.default_rng(8)
    current = np.repeat(
        rng.uniform(min(preset(name).operating_range), max(preset(name).operating_range), 600), 9
    )
    device = truth(
        name, seed=3, colour=0.4, effects={"adc_quantization": {"signal": RESISTANCE, "step": 50.0}}
    )
    batch = device.simulate(current, seed=6)
    stream = device.stepper(seed=6)
    samples = np.array([stream.step(i) for i in current])
    for k, channel in enumerate(stream.channels):
        assert np.array_equal(samples[:, k], batch[channel])
    assert stream.true_deflection == batch["true_tip_deflection"][-1]
    assert stream.temperature == batch["true_temperature"][-1]
    assert stream.sample == current.size


def test_seeds_make_devices_and_noise():
    current = _slow_loop("integrated", 100)
    one, other = truth("integrated", seed=1), truth("integrated", seed=2)
    assert np.array_equal(
        one.simulate(current, seed=4)[RESISTANCE],
        truth("integrated", seed=1).simulate(current, seed=4)[RESISTANCE],
    )
    assert not np.array_equal(
        one.simulate(current, noise=False)[RESISTANCE], other.simulate(current, noise=False)[RESISTANCE]
    )
    quiet = one.simulate(current, noise=False)
    assert np.array_equal(quiet["true_tip_deflection"], one.simulate(current, seed=9)["true_tip_deflection"])
    assert np.array_equal(quiet[TIP_DEFLECTION], quiet["true_tip_deflection"])
    assert np.array_equal(quiet[COMMANDED_CURRENT], current)


@pytest.mark.parametrize("colour", [0.0, 0.7])
@pytest.mark.parametrize("name", PRESETS)
def test_noise_has_the_published_level_and_the_chosen_colour(name, colour):
    nominal = preset(name)
    run = truth(name, colour=colour).simulate(np.full(20_000, nominal.operating_range[0]), seed=12)
    gaps = {
        RESISTANCE: run[RESISTANCE] / run["true_film_resistance"] - 1.0,
        TIP_DEFLECTION: run[TIP_DEFLECTION] - run["true_tip_deflection"],
    }
    if nominal.measures_temperature:
        gaps[STAGE_TEMPERATURE] = run[STAGE_TEMPERATURE] - run["true_temperature"]
    for channel, gap in gaps.items():
        assert gap.std() == pytest.approx(nominal.noise[channel], rel=0.05)
        assert np.corrcoef(gap[1:], gap[:-1])[0, 1] == pytest.approx(colour, abs=0.03)
    pairs = np.corrcoef(list(gaps.values()))
    assert np.all(np.abs(pairs - np.eye(len(gaps))) < 0.05)


@settings(max_examples=40, deadline=None)
@given(path=st.lists(st.floats(40.0, 80.0), min_size=1, max_size=40), seed=st.integers(0, 5))
def test_ensemble_equals_hysterons_one_by_one(path, seed):
    """(5.3): on above alpha, off below beta, else as before."""
    alpha, beta, offset = population(80, heating=(62.0, 3.5), width=(5.0, 2.0), offset=(0.8, 1.8), seed=seed)
    shifts = (np.zeros(80), offset)
    sorted_ones = [sort_population(alpha + s, beta + s) for s in shifts]
    levels, domains = (np.array([one[k] for one in sorted_ones]) for k in (0, 1))
    metallic = np.zeros((2, 80), dtype=np.uint8)
    for which, shift in enumerate(shifts):
        on = np.zeros(80, dtype=bool)
        count, previous = 0, -1e6
        for t in path:
            peeked = ensemble_peek(t, previous, which, levels, domains, metallic, count)
            count = ensemble_step(t, previous, which, levels, domains, metallic, count)
            previous = t
            on = (on | (t >= alpha + shift)) & ~(t <= beta + shift)
            assert count == peeked == on.sum()
            assert np.array_equal(metallic[which].astype(bool), on)


@given(
    insulator=st.floats(1e-7, 1e-4),
    contrast=st.floats(1.0, 1e4),
    s=st.floats(0.0, 1.0),
    p=st.floats(0.2, 0.8),
)
def test_mixture_solves_the_effective_medium_equation(insulator, contrast, s, p):
    metal = insulator * contrast
    g = mixture_conductance(insulator, metal, s, p)
    a = (1.0 - p) / p
    balance = (1 - s) * (insulator - g) / (insulator + a * g) + s * (metal - g) / (metal + a * g)
    assert abs(balance) < 1e-9
    assert insulator * (1 - 1e-9) <= g <= metal * (1 + 1e-9)


def test_arc_tip_is_the_chord_geometry_of_a_circle():
    length, curvature = 300e-6, 1500.0
    angle = np.linspace(0.0, curvature * length, 20_001)
    height = np.trapezoid(np.sin(angle), angle) / curvature
    assert arc_tip(curvature, length) == pytest.approx(height, rel=1e-7)
    assert arc_tip(-curvature, length) == -arc_tip(curvature, length)
    assert arc_tip(1e-9, length) == pytest.approx(0.5e-9 * length**2)


@pytest.mark.parametrize("name", PRESETS)
def test_safe_current_lets_the_device_cool_to_ambient(name):
    nominal = preset(name)
    hot = max(nominal.operating_range, key=abs)
    count = int(15 * nominal.time_constant / nominal.sample_period)
    run = truth(name, seed=2).simulate(np.r_[np.full(count, hot), np.zeros(count)], noise=False)
    assert run["true_temperature"].max() > 80.0
    assert run["true_temperature"][-1] == pytest.approx(nominal.ambient, abs=0.01)


def test_current_stays_in_the_range_of_the_source():
    run = truth("integrated").simulate([-0.01, 0.02], noise=False)
    assert run["heater_current"].tolist() == [0.0, 12.78e-3]


@pytest.mark.parametrize("name", PRESETS)
def test_surrogate_and_its_inverse(name):
    low, high = sorted(preset(name).operating_range)
    currents = np.linspace(low, high, 50)
    temperatures = temperature_of_surrogate(name, currents)
    assert np.allclose(surrogate_of_temperature(name, temperatures), currents, rtol=0, atol=1e-12)
    held = truth(name).simulate(np.full(3000 if name == "integrated" else 6000, currents[30]), noise=False)
    assert held["true_temperature"][-1] == pytest.approx(temperatures[30], abs=1e-6)


def test_settled_start():
    nominal = preset("integrated")
    hot = nominal.operating_range[1]
    run = truth("integrated").simulate(np.full(5, hot), noise=False, settled=True)
    assert np.allclose(run["true_temperature"], temperature_of_surrogate("integrated", hot), atol=1e-3)
    assert run.time_s[0] == 0.0


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: truth("nowhere"), "integrated, peltier"),
        (lambda: truth("integrated", effects={"gremlins": {}}), "gremlins"),
        (lambda: truth("integrated", effects={"peltier_joule_heating": {"rho": 1.0}}), "peltier"),
        (lambda: truth("integrated", effects={"latent_heat": {"latent": -1.0}}), "latent_heat.latent"),
        (lambda: truth("integrated", effects={"latent_heat": {"heat": 1.0}}), "heat"),
        (lambda: truth("integrated", effects={"sensor_lag": {"time_constant": 1.0}}), "signal"),
        (lambda: truth("integrated").simulate([0.004, np.nan]), "current"),
        (lambda: truth("integrated").simulate([0.004], dt=0.0), "dt"),
        (lambda: truth("integrated").stepper().step(np.inf), "current"),
        (lambda: truth("integrated", effects={"dead_time": {"delay": 50.0}}).simulate([0.0]), "dead time"),
    ],
)
def test_bad_input_is_refused_with_the_reason(call, word):
    with pytest.raises(ValueError, match=word):
        call()
