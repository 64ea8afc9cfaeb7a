"""Fitting of play models: recovery, exact derivatives, order kept for any parameters, honest uncertainties."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.hysteresis import EGPI, GPI, Linear, Sine, TanhEnvelopes, fit_play_model
from vo2_models.hysteresis.fitting_memoryless import BASES
from vo2_models.hysteresis.fitting_projection import Parametrisation, Projection

TEMPERATURE = 60 + 40 * np.sin(np.linspace(-1.57, 60, 1200)) * np.linspace(1, 0.1, 1200)
ENVELOPES = TanhEnvelopes(0.3, -19.5, 0.25, -14.5)
WEIGHTS = np.array([1, 0.5, 2, 0.3, 0.4, 0.7])
DEVICE = GPI(np.arange(6) / 6, WEIGHTS, ENVELOPES, bias=5.0, input_range=(20, 100))


def record(device=DEVICE, noise=0.0, seed=0, v=TEMPERATURE):
    y, _ = device.simulate(v)
    return y + noise * np.ptp(y) * np.random.default_rng(seed).standard_normal(v.size)


def test_a_model_of_the_family_is_recovered():
    fit = fit_play_model(TEMPERATURE, record(), plays=6)
    assert fit.nrmse < 1e-9
    np.testing.assert_allclose(fit.model.weights, WEIGHTS, atol=1e-6)
    np.testing.assert_allclose(fit.model.bias, 5.0, atol=1e-6)
    for name in ("rising_slope", "rising_offset", "falling_slope", "falling_offset"):
        np.testing.assert_allclose(getattr(fit.model.envelopes, name), getattr(ENVELOPES, name), rtol=1e-6)
    predicted, _ = fit.model.simulate(TEMPERATURE, fit.initial_state())
    np.testing.assert_allclose(predicted + fit.residual, record(), atol=1e-9)


def test_units_do_not_matter():
    """Ampere in, metre out gives the same fit as degC in, volts out."""
    y = record(noise=1e-3)
    warm = fit_play_model(TEMPERATURE, y, plays=6)
    small = fit_play_model(TEMPERATURE * 1e-4, y * 1e-6 + 3.0, plays=6)
    assert small.nrmse == pytest.approx(warm.nrmse, rel=1e-4)
    np.testing.assert_allclose(small.model.weights * 1e6, warm.model.weights, rtol=1e-3, atol=1e-3)
    slope = warm.model.envelopes.rising_slope
    np.testing.assert_allclose(small.model.envelopes.rising_slope * 1e-4, slope, rtol=1e-3)


@pytest.mark.parametrize(("memoryless", "limit"), [("none", 0.1), ("sine", 2.5e-3), ("cubic", 8e-3)])
def test_non_monotone_record(memoryless, limit):
    """Deflection in metres with a sine: the extended model fits to the noise, the plain one does not."""
    device = EGPI(np.arange(6) / 6, 1e-6 * WEIGHTS, ENVELOPES, Sine(1.2e-6, 0.05, 0.3), 1e-4)
    fit = fit_play_model(TEMPERATURE, record(device, 2e-3), plays=6, memoryless=memoryless)
    assert fit.nrmse < limit
    if memoryless == "none":
        assert fit.nrmse > 1e-2
    new = 60 + 35 * np.sin(np.linspace(0, 9, 400)) * np.cos(np.linspace(0, 20, 400))
    start, start_fit = device.initial_state(), fit.initial_state()
    truth = device.simulate(new, start)[0]
    gap = np.sqrt(np.mean((fit.model.simulate(new, start_fit)[0] - truth) ** 2)) / np.ptp(truth)
    assert gap < 2 * limit


def test_envelopes_of_their_own_fit_what_shared_ones_cannot():
    rng = np.random.default_rng(3)
    envelopes = TanhEnvelopes(
        0.3 + 0.1 * rng.random(6),
        -20 + rng.normal(0, 1.5, 6),
        0.3 + 0.1 * rng.random(6),
        -16 + rng.normal(0, 1.5, 6),
    )
    device = EGPI(np.arange(6) / 6, WEIGHTS, envelopes, Linear(-0.02), on_disorder="warn")
    y = record(device, 1e-3)
    shared = fit_play_model(TEMPERATURE, y, plays=6, memoryless="linear")
    own = fit_play_model(TEMPERATURE, y, plays=6, memoryless="linear", per_play=True)
    assert own.model.envelopes.plays == 6
    assert own.rms < 0.5 * shared.rms
    assert own.model.order_excess(20, 100)[0] <= 1e-9


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from(sorted(BASES)))
@settings(max_examples=60, deadline=None)
def test_no_parameter_vector_breaks_the_order(seed, own, memoryless):
    """Whatever the solver tries, gamma_R - r <= gamma_L + r over the whole input range."""
    rng = np.random.default_rng(seed)
    radii = np.sort(rng.uniform(0, 1, 4)) * [0, 1, 1, 1]
    parameters = Parametrisation(radii, 4 if own else 1, BASES[memoryless])
    lower, upper = parameters.bounds()
    x = np.clip(rng.normal(0, 3, parameters.size), lower, np.minimum(upper, 5))
    arguments, _ = parameters.unpack(x)
    model = GPI(radii, np.ones(4), TanhEnvelopes(*arguments), input_range=(-1, 1))
    assert model.order_excess(-1, 1)[0] <= 1e-9


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from(["tanh", "sine"]))
@settings(max_examples=25, deadline=None)
def test_derivatives_are_those_of_the_model(seed, own, memoryless):
    """Against central differences of the model's output at fixed linear coefficients."""
    rng = np.random.default_rng(seed)
    z = np.sin(np.linspace(-1.5, 20, 150)) * np.linspace(1, 0.3, 150)
    radii = np.array([0.0, 0.2, 0.5])
    parameters = Parametrisation(radii, 3 if own else 1, BASES[memoryless])
    arguments = np.stack(
        [
            rng.uniform(2, 4, parameters.pairs),
            rng.normal(-0.5, 0.2, parameters.pairs),
            rng.uniform(2, 4, parameters.pairs),
            rng.normal(0.5, 0.2, parameters.pairs),
        ]
    )
    x = parameters.pack(arguments, np.array(BASES[memoryless].starts[0]))
    record = np.tanh(3 * z) + 0.1 * rng.standard_normal(150)
    projection = Projection(z, record, True, parameters, np.ones(150, dtype=bool))
    found = projection.linear(x)

    def output(at):
        _, theta = parameters.unpack(at)
        return (
            projection.regressors(at) @ found.weights
            + parameters.basis.columns(z, theta) @ found.coefficients
        )

    natural = projection.natural(x)
    count = 4 * parameters.pairs
    analytic = np.concatenate([parameters.chain(natural[:, :count], x), natural[:, count:]], axis=1)
    for k in range(parameters.size):
        step = np.zeros(parameters.size)
        step[k] = 1e-6
        difference = (output(x + step) - output(x - step)) / 2e-6
        # a play that switches within the step is differentiable on neither side: all but a few samples agree
        assert np.mean(np.abs(difference - analytic[:, k]) < 1e-5) > 0.97


def test_standard_deviations_cover_the_truth():
    """Errors over their stated deviations have a spread near one, over 24 noise realisations."""
    truth = {
        "rising_slope": 0.3,
        "rising_offset": -19.5,
        "falling_slope": 0.25,
        "falling_offset": -14.5,
        "bias": 5.0,
    }
    truth |= {f"weight[{j}]": float(w) for j, w in enumerate(WEIGHTS)}
    scores = []
    for seed in range(24):
        fit = fit_play_model(TEMPERATURE[:600], record(noise=5e-3, seed=seed, v=TEMPERATURE[:600]), plays=6)
        named = dict(zip(fit.names, zip(fit.values, fit.std, strict=True), strict=True))
        scores += [
            (named[name][0] - value) / named[name][1] for name, value in truth.items() if named[name][1] > 0
        ]
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3
    assert np.mean(np.abs(scores) < 1.645) > 0.83


def test_the_values_named_are_those_of_the_model():
    fit = fit_play_model(TEMPERATURE, record(noise=1e-3), plays=6, per_play=True)
    named = dict(zip(fit.names, fit.values, strict=True))
    for j in range(6):
        assert named[f"weight[{j}]"] == pytest.approx(fit.model.weights[j], rel=1e-9, abs=1e-9)
        assert named[f"falling_offset[{j}]"] == pytest.approx(fit.model.envelopes.falling_offset[j], rel=1e-9)
        assert named[f"rising_slope[{j}]"] == pytest.approx(fit.model.envelopes.rising_slope[j], rel=1e-9)
    assert named["bias"] == pytest.approx(fit.model.bias, rel=1e-9)
    assert fit.covariance.shape == (len(fit.names), len(fit.names))


@pytest.mark.parametrize(
    ("memoryless", "kind"),
    [("linear", "polynomial"), ("cubic", "polynomial"), ("tanh", "tanh"), ("sine", "sine")],
)
def test_values_of_the_memoryless_part_are_those_of_the_model(memoryless, kind):
    fit = fit_play_model(TEMPERATURE, record(noise=1e-3) + 0.02 * TEMPERATURE, plays=4, memoryless=memoryless)
    named = dict(zip(fit.names, fit.values, strict=True))
    part = fit.model.memoryless
    numbers = {
        "polynomial": lambda: {
            f"memoryless_coefficient[{k}]": c for k, c in enumerate(part.coefficients[1:])
        },
        "tanh": lambda: {
            "memoryless_coefficient[0]": part.amplitude,
            "memoryless_parameter[0]": part.gain,
            "memoryless_parameter[1]": part.offset,
        },
        "sine": lambda: {
            "memoryless_coefficient[0]": part.amplitude,
            "memoryless_coefficient[1]": part.phase,
            "memoryless_parameter[0]": part.frequency,
        },
    }[kind]()
    assert {name for name in named if name.startswith("memoryless")} == set(numbers)
    for name, value in numbers.items():
        assert named[name] == pytest.approx(value, rel=1e-9, abs=1e-12)
    assert named["bias"] == pytest.approx(fit.model.bias, rel=1e-9)


def test_deviations_of_a_straight_line_beside_the_plays_cover_the_truth():
    """Bias 5 and a slope of 0.02 per kelvin, over 24 noise realisations."""
    scores = []
    for seed in range(24):
        y = record(noise=5e-3, seed=seed, v=TEMPERATURE[:600]) + 0.02 * TEMPERATURE[:600]
        fit = fit_play_model(TEMPERATURE[:600], y, plays=6, memoryless="linear")
        named = dict(zip(fit.names, zip(fit.values, fit.std, strict=True), strict=True))
        for name, truth in (("bias", 5.0), ("memoryless_coefficient[0]", 0.02)):
            scores.append((named[name][0] - truth) / named[name][1])
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


SHORT = np.sin(np.linspace(0, 30, 60))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fit_play_model(SHORT[:10], SHORT[:10]), r"v: found 10 samples, need at least 22"),
        (lambda: fit_play_model(SHORT, np.ones(60)), r"y: found a constant signal \(1\)"),
        (lambda: fit_play_model(np.arange(60.0), SHORT), r"v: found an input that only rises"),
        (lambda: fit_play_model(SHORT, SHORT[:-1]), r"y: found 59 value\(s\), need 60"),
        (lambda: fit_play_model(np.where(SHORT > 0.9, np.nan, SHORT), SHORT), r"v: found nan at index"),
        (lambda: fit_play_model(SHORT, SHORT, radii=[0.2, 0.1]), r"radii: found 0.1 after 0.2"),
        (lambda: fit_play_model(SHORT, SHORT, radii=[0.2, 1.1]), r"radii: found .* need some from 0 to 1"),
        (lambda: fit_play_model(SHORT, SHORT, plays=0), r"plays: found 0"),
        (
            lambda: fit_play_model(SHORT, SHORT, memoryless="spline"),
            r"memoryless: found 'spline', need one of",
        ),
        (lambda: fit_play_model(SHORT, SHORT, initial="left"), r"initial: found 'left'"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


PIEZO = Path(__file__).resolve().parents[4] / "shared" / "data" / "piezo" / "Model_Vi_Do.dat"


@pytest.mark.skipif(not PIEZO.exists(), reason=f"measured piezo recording not found at {PIEZO}")
def test_measured_piezo_displacement_is_predicted():
    """First half of the recording (volts, um) fitted, second half predicted within 1 % of its range.

    The second half runs from the memory that the first one leaves; no sample of it is seen by the fit.
    """
    v, y = np.loadtxt(PIEZO, usecols=(0, 4), unpack=True)
    half = v.size // 2
    fit = fit_play_model(v[:half], y[:half], plays=12, memoryless="linear", measured=np.arange(half) >= 300)
    assert fit.nrmse < 0.006
    _, state = fit.model.simulate(v[:half], fit.initial_state())
    predicted, _ = fit.model.simulate(v[half:], state)
    error = np.sqrt(np.mean((predicted - y[half:]) ** 2)) / np.ptp(y[half:])
    assert error < 0.01
    # a memoryless line through the same data is several times worse
    line = np.polyval(np.polyfit(v[:half], y[:half], 3), v[half:])
    assert error < 0.3 * np.sqrt(np.mean((line - y[half:]) ** 2)) / np.ptp(y[half:])


def test_samples_that_are_not_measured_drive_the_plays_but_are_not_fitted():
    """A record that starts from an unknown memory: skipping the first sweep recovers the model."""
    start = DEVICE.initial_state("upper", v=55.0)
    v = np.concatenate([np.linspace(55, 100, 100), np.linspace(100, 20, 200), TEMPERATURE])
    y, _ = DEVICE.simulate(v, start)
    y[:100] += 0.5
    fit = fit_play_model(v, y, plays=6, measured=np.arange(v.size) >= 150)
    assert fit.nrmse < 1e-6
    assert fit.residual.size == v.size - 150
    np.testing.assert_allclose(fit.model.weights, WEIGHTS, atol=1e-3)
