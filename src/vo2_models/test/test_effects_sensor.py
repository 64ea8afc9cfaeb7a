"""Structure and sensor effects against their equations, worked out with numpy and scipy."""

import numpy as np
import pytest
from scipy.signal import lfilter, lsim
from vo2_models.device import truth
from vo2_models.device.coefficients import CHANNELS, Coefficient
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording

CURRENT = np.repeat(np.random.default_rng(1).uniform(4e-3, 8.4e-3, 40), 15)
DT = 1e-3


@pytest.fixture(scope="module")
def clean():
    return truth("integrated", seed=4).simulate(CURRENT, noise=False)


def _with(name: str, **values) -> np.ndarray:
    return truth("integrated", seed=4, effects={name: values}).simulate(CURRENT, noise=False)


def _stepped(name: str, **values) -> Recording:
    """The same in one step a sample: what a hook makes of a response that goes the way of the heat from sample to sample."""
    out = truth("integrated", seed=4, effects={name: values}).run(CURRENT, dt=DT)
    return Recording(DT * np.arange(CURRENT.size), {c: out[:, k] for k, c in enumerate(CHANNELS)})


def _between(values: np.ndarray, parts: int) -> np.ndarray:
    """Values at `parts` points a sample, on the way that heat goes under a held current: A + B exp(-t / tau)."""
    tau = truth("integrated", seed=4).coefficients[Coefficient.TIME_CONSTANT]
    gone = np.exp(-DT / tau * np.arange(1, parts + 1) / parts)
    share = (gone - gone[-1]) / (1 - gone[-1])  # of the old value
    ways = values[1:, None] + (values[:-1] - values[1:])[:, None] * share
    return np.concatenate([values[:1], ways.ravel()])


@pytest.mark.parametrize("channel", [RESISTANCE, TIP_DEFLECTION])
def test_lag(clean, channel):
    rest = truth("integrated", seed=4).simulate(np.zeros(1), noise=False)[channel][0]
    # from rest one sample before the first
    way = _between(np.concatenate([[0.0], clean[channel] - rest]), 100)
    _, expected, _ = lsim(([1.0], [3e-3, 1.0]), way, DT / 100 * np.arange(way.size))
    found = _stepped("sensor_lag", signal=channel, time_constant=3e-3)[channel]
    assert np.abs(found - rest - expected[100::100]).max() < 1e-5 * np.ptp(clean[channel])


@pytest.mark.parametrize("delay", [0.3e-3, 1e-3, 4.6e-3])
def test_clock(clean, delay):
    time = clean.time_s
    way = _between(clean[RESISTANCE], 100)
    expected = np.interp(time - delay, DT / 100 * np.arange(way.size), way)
    found = _stepped("clock_offset", signal=RESISTANCE, delay=delay)[RESISTANCE]
    late = time >= delay
    assert np.allclose(found[late], expected[late], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("averaging", {"window": 2.03e-3}),
        ("averaging", {"window": 5e-3}),
        ("sensor_lag", {"time_constant": 1e-3}),
        ("clock_offset", {"delay": 0.5e-3}),
        ("cantilever_resonance", {"share": 1.0, "frequency": 200.0, "damping": 0.02}),
    ],
)
def test_a_recording_holds_what_happens_between_its_samples(clean, name, values):
    """The film crosses its transition within a sample or two: of 64 steps a sample, next to nothing is different."""
    given = values if name == "cantilever_resonance" else {**values, "signal": TIP_DEFLECTION}
    device, parts = truth("integrated", seed=4, effects={name: given}), 64
    fine = device.run(np.repeat(CURRENT, parts), dt=DT / parts)[
        parts - 1 :: parts, CHANNELS.index(TIP_DEFLECTION)
    ]
    found = device.simulate(CURRENT, noise=False)[TIP_DEFLECTION]
    effect = np.std(fine - clean[TIP_DEFLECTION])
    assert np.std(found - fine) < 0.02 * effect
    assert np.std(_stepped(name, **given)[TIP_DEFLECTION] - fine) > 0.03 * effect


def test_the_noise_is_that_of_the_samples_alone():
    lagged = {"sensor_lag": {"signal": TIP_DEFLECTION, "time_constant": 1e-3}}
    noise = []
    for effects in ({}, lagged):
        device = truth("integrated", seed=4, colour=0.7, effects=effects)
        loud, quiet = device.simulate(CURRENT, seed=3), device.simulate(CURRENT, noise=False)
        noise.append(loud[TIP_DEFLECTION] - quiet[TIP_DEFLECTION])
    assert np.std(noise[0]) > 0
    assert np.allclose(noise[0], noise[1], rtol=0, atol=1e-9 * np.std(noise[0]))


@pytest.mark.parametrize("channel", [RESISTANCE, TIP_DEFLECTION])
def test_programs_that_are_given_the_samples(clean, channel):
    """A moving mean, an exponential one and a shift, as numpy and scipy make them of the samples."""
    x = clean[channel]
    late = slice(20, None)
    found = _with("averaging", signal=channel, window=4 * DT, sampled=1.0)[channel]
    assert np.allclose(found[late], np.convolve(x, np.full(4, 0.25))[: x.size][late], rtol=1e-9)
    found = _with("averaging", signal=channel, window=0.5 * DT, sampled=1.0)[channel]
    assert np.allclose(found, x, rtol=1e-12)
    keep = 0.6
    found = _with("sensor_lag", signal=channel, time_constant=-DT / np.log(keep), sampled=1.0)[channel]
    expected, _ = lfilter([1 - keep], [1, -keep], x, zi=[found[0] - (1 - keep) * x[0]])
    assert np.allclose(found, expected, rtol=1e-9)
    found = _with("clock_offset", signal=channel, delay=2.3 * DT, sampled=1.0)[channel]
    assert np.allclose(found[late], (0.7 * np.roll(x, 2) + 0.3 * np.roll(x, 3))[late], rtol=1e-9)


def test_gain_drift(clean):
    found = _with("sensor_gain_drift", signal=TIP_DEFLECTION, rate=0.05)[TIP_DEFLECTION]
    assert np.allclose(found, clean[TIP_DEFLECTION] * (1 + 0.05 * clean.time_s), rtol=1e-12)


def test_zero_drift(clean):
    found = _with("sensor_zero_drift", signal=TIP_DEFLECTION, rate=2e-6, curvature=-1e-6)[TIP_DEFLECTION]
    t = clean.time_s
    assert np.allclose(found, clean[TIP_DEFLECTION] + 2e-6 * t - 1e-6 * t**2, rtol=0, atol=1e-15)


def test_quantisation_and_saturation(clean):
    found = _with("adc_quantization", signal=RESISTANCE, step=1000.0)[RESISTANCE]
    assert np.allclose(found, 1000.0 * np.round(clean[RESISTANCE] / 1000.0), rtol=0, atol=1e-9)
    found = _with("adc_saturation", signal=TIP_DEFLECTION, low=5e-6, high=40e-6)[TIP_DEFLECTION]
    assert np.array_equal(found, np.clip(clean[TIP_DEFLECTION], 5e-6, 40e-6))


def test_quantisation_comes_after_the_noise():
    effects = {"adc_quantization": {"signal": STAGE_TEMPERATURE, "step": 0.25}}
    run = truth("peltier", effects=effects).simulate(np.full(400, -0.5), seed=3)
    steps = run[STAGE_TEMPERATURE] / 0.25
    assert np.allclose(steps, np.round(steps))


def test_two_sensors_at_once():
    effects = {
        "sensor_gain_drift:a": {"signal": RESISTANCE, "rate": 0.02},
        "sensor_gain_drift:b": {"signal": TIP_DEFLECTION, "rate": 0.03},
    }
    base = truth("integrated", seed=4).simulate(CURRENT, noise=False)
    run = truth("integrated", seed=4, effects=effects).simulate(CURRENT, noise=False)
    for channel, rate in ((RESISTANCE, 0.02), (TIP_DEFLECTION, 0.03)):
        assert np.allclose(run[channel] / base[channel], 1 + rate * base.time_s)


def test_creep(clean):
    d = clean["true_tip_deflection"]
    rest = truth("integrated", seed=4).simulate(np.zeros(1), noise=False)["true_tip_deflection"][0]
    decay = np.exp(-DT / 0.1)
    slow = rest + lfilter([1 - decay], [1, -decay], d - rest)
    found = _with("creep", share=0.2, time_constant=0.1)["true_tip_deflection"]
    assert np.allclose(found, 0.8 * d + 0.2 * slow, rtol=1e-9)
    on_top = _with("creep", share=0.2, time_constant=0.1, gain=0.2)["true_tip_deflection"]
    assert np.allclose(on_top, d + 0.2 * slow, rtol=1e-9)


def test_resonance_solves_the_oscillator(clean):
    """Many small steps of z'' + 2 zeta w z' + w^2 z = w^2 D."""
    d = clean["true_tip_deflection"]
    rest = truth("integrated", seed=4).simulate(np.zeros(1), noise=False)["true_tip_deflection"][0]
    frequency, damping, parts = 120.0, 0.02, 200
    w = 2 * np.pi * frequency
    fine = _between(np.r_[rest, d], parts)
    h = DT / parts
    z, rate = rest, 0.0
    expected = []
    for k in range(d.size * parts):
        force = 0.5 * (fine[k] + fine[k + 1])
        # midpoint rule
        zm = z + 0.5 * h * rate
        rm = rate + 0.5 * h * (w * w * (fine[k] - z) - 2 * damping * w * rate)
        z += h * rm
        rate += h * (w * w * (force - zm) - 2 * damping * w * rm)
        if (k + 1) % parts == 0:
            expected.append(z)
    found = _stepped("cantilever_resonance", share=1.0, frequency=frequency, damping=damping)[TIP_DEFLECTION]
    assert np.abs(found - expected).max() < 2e-3 * np.ptp(d)
    half = _stepped("cantilever_resonance", share=0.5, frequency=frequency, damping=damping)[TIP_DEFLECTION]
    assert np.allclose(half, 0.5 * d + 0.5 * found, rtol=0, atol=1e-12)


def test_delays_that_finer_steps_could_not_hold_are_simulated_in_one():
    lagged = {"sensor_lag": {"signal": TIP_DEFLECTION, "time_constant": 1e-3}}
    assert truth("integrated", effects=lagged).steps_per_sample(DT) == 4
    assert truth("integrated", effects={**lagged, "dead_time": {"delay": 1.2}}).steps_per_sample(DT) == 1
    late = truth("integrated", effects={**lagged, "dead_time": {"delay": 1.2}})
    assert np.ptp(late.simulate(CURRENT, noise=False)[TIP_DEFLECTION]) < 1e-9
    slow = {"averaging": {"signal": TIP_DEFLECTION, "window": 0.9}}
    assert truth("integrated", effects=slow).steps_per_sample(DT) == 1
