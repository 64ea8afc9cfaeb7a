"""Self-sensing schemes: exactness on their own law, bounds, memory, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from own_devices import STACK
from vo2_models.device import truth
from vo2_models.device.surrogate import temperature_of_surrogate
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.parameters import Parameter
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing import (
    KINDS,
    PARAMETERS,
    PolynomialSelfSensing,
    characterise,
    self_sensing,
)
from vo2_models.self_sensing.bounds import COVERAGE, fit_bound, table_at
from vo2_models.self_sensing.composite_fit import PLAYS as PLAYS_OWN
from vo2_models.self_sensing.composite_fit import composite_parameters
from vo2_models.self_sensing.polynomial import polynomial_step
from vo2_models.workflow import fit

PLAYS = np.array([0.05, 0.3, 0.6])


def bank(weights, centre, polynomial):
    """A law with loops of 7 K around `centre` degC."""
    slope = np.full(3, 0.25)
    return PlayBank(
        weights, PLAYS, slope, -slope * (centre + 3.5), slope, -slope * (centre - 3.5), polynomial
    )


def laws():
    resistance = bank([0.3, 0.2, 0.1], 60.0, [-5.0, 4e-3])
    deflection = bank([12e-6, 9e-6, 6e-6], 61.0, [30e-6, -0.15e-6])
    return {
        "model.device": "integrated",
        **resistance.to_parameters("model.resistance"),
        **deflection.to_parameters("model.deflection"),
    }


def samples(temperatures):
    parameters = laws()
    channels = {}
    for name, section in ((RESISTANCE, "model.resistance"), (TIP_DEFLECTION, "model.deflection")):
        law = PlayBank.from_parameters(section, parameters).egpi()
        channels[name], _ = law.simulate(temperatures, law.initial_state(v=36.0))
    channels[RESISTANCE] = 10.0 ** -channels[RESISTANCE]
    return channels


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(36.0, 94.0), min_size=2, max_size=40))
def test_composite_recovers_temperature_and_deflection_of_its_own_law(levels):
    temperatures = np.array([36.0, *levels])
    truth_channels = samples(temperatures)
    scheme = self_sensing("composite", laws())
    found, _ = scheme.estimate(truth_channels[RESISTANCE])
    np.testing.assert_allclose(found.temperature, temperatures, atol=1e-6)
    np.testing.assert_allclose(found.deflection, truth_channels[TIP_DEFLECTION], atol=1e-11)
    np.testing.assert_allclose(
        temperature_of_surrogate("integrated", found.surrogate), temperatures, atol=1e-6
    )


def test_composite_follows_loops_that_are_not_nested_in_the_resistance():
    """The polynomial, which knows no history, must be wrong on both branches at one resistance."""
    sweep = np.concatenate([np.linspace(36, 94, 300), np.linspace(94, 36, 300)])
    channels = samples(sweep)
    recording = Recording(np.arange(sweep.size) * 1e-3, channels, "integrated")
    parameters = {**laws(), **characterise(recording, laws())}
    errors = {}
    for kind in ("composite", "polynomial"):
        found, _ = self_sensing(kind, parameters).estimate(channels[RESISTANCE])
        errors[kind] = np.abs(found.deflection - channels[TIP_DEFLECTION]).mean()
    assert errors["composite"] < 1e-10
    assert errors["polynomial"] > 1e-7


@pytest.mark.parametrize("kind", KINDS)
def test_stream_equals_batch_and_memory_can_be_carried_over(kind):
    channels = samples(np.random.default_rng(4).uniform(36, 94, 60))
    recording = Recording(np.arange(60.0), channels, "integrated")
    scheme = self_sensing(kind, {**laws(), **characterise(recording, laws())})
    whole, final = scheme.estimate(channels[RESISTANCE])
    first, memory = scheme.estimate(channels[RESISTANCE][:25])
    rest, after = scheme.estimate(channels[RESISTANCE][25:], memory)
    np.testing.assert_array_equal(np.concatenate([first.deflection, rest.deflection]), whole.deflection)
    np.testing.assert_array_equal(final, after)
    state = scheme.initial_state()
    stream = [scheme.update(r, state) for r in channels[RESISTANCE]]
    np.testing.assert_array_equal([e.deflection for e in stream], whole.deflection)
    np.testing.assert_array_equal([e.bound for e in stream], whole.bound)


def test_polynomial_step_is_the_chebyshev_series():
    rng = np.random.default_rng(0)
    resistance = 10 ** rng.uniform(4, 5.4, 400)
    deflection = rng.normal(size=400)
    scheme = PolynomialSelfSensing.fit(resistance, deflection, 8)
    series = np.polynomial.Chebyshev(scheme.coefficients, scheme.domain)
    table = np.array([0.0, 1.0])
    found = [polynomial_step(r, scheme.domain, scheme.coefficients, table)[0] for r in resistance]
    np.testing.assert_allclose(found, series(np.log10(resistance)), rtol=0, atol=1e-12)
    ends = [polynomial_step(r, scheme.domain, scheme.coefficients, table)[0] for r in (1.0, 1e9)]
    np.testing.assert_allclose(ends, series(scheme.domain), atol=1e-12)


def test_bound_covers_the_share_it_promises_on_fresh_errors():
    rng = np.random.default_rng(1)
    knots = np.linspace(4, 5.4, 12)

    def draw(n):
        x = rng.uniform(4, 5.4, n)
        return x, rng.normal(size=n) * (1 + 3 * (x - 4))

    bound = fit_bound(*draw(20000), knots)
    x, error = draw(20000)
    table = np.concatenate([knots, bound])
    inside = np.mean([abs(e) <= table_at(table, place) for place, e in zip(x, error, strict=True)])
    assert inside == pytest.approx(COVERAGE, abs=0.02)
    assert bound[-1] > 2 * bound[0]


def test_bound_is_that_of_a_whole_pass():
    rng = np.random.default_rng(2)
    knots = np.linspace(4, 5.4, 12)
    half = knots[1] - knots[0]

    def passes(n):
        there = np.linspace(4, 5.4, 120)
        x = np.concatenate([there if k % 2 else there[::-1] for k in range(n)])
        return x, rng.normal(size=x.size)

    bound = fit_bound(*passes(400), knots)
    x, error = (each.reshape(400, -1) for each in passes(400))
    beyond = [
        np.any((np.abs(x - place) <= half) & (np.abs(error) > limit), axis=1)
        for place, limit in zip(knots[1:-1], bound[1:-1], strict=True)
    ]
    assert np.mean(beyond) == pytest.approx(1 - COVERAGE, abs=0.02)
    x, error = passes(1)
    np.testing.assert_array_equal(
        fit_bound(x, error, knots), [np.max(np.abs(error[np.abs(x - place) <= half])) for place in knots]
    )


def test_bound_is_large_where_the_laws_are_not_those_of_the_device():
    """Laws that belong to another device must not come with a small bound."""
    current = np.concatenate([np.linspace(3.7e-3, 8.4e-3, 800), np.linspace(8.4e-3, 3.7e-3, 800)])
    played = truth("integrated", seed=3).simulate(current, seed=3)
    # without the current the composite scheme has no laws of its own and keeps those given
    recording = Recording(
        played.time_s, {name: played[name] for name in (RESISTANCE, TIP_DEFLECTION)}, "integrated"
    )
    found = characterise(recording, laws())
    assert found["model.self_sensing.composite.resistance.weights"] == []
    foreign = np.max(found["model.self_sensing.bounds.composite"])
    assert foreign > 2e-6
    assert np.max(found["model.self_sensing.bounds.polynomial"]) < foreign


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -5.0])
def test_a_resistance_that_is_none_is_refused(bad):
    scheme = self_sensing("composite", laws())
    with pytest.raises(ValueError, match="resistance"):
        scheme.update(bad, scheme.initial_state())
    with pytest.raises(ValueError, match="resistance"):
        scheme.estimate([1e4, bad])


def test_a_model_without_the_laws_is_refused_with_the_remedy():
    with pytest.raises(ValueError, match=r"model\.resistance: found no law.*load a model file"):
        self_sensing("composite", {"model.device": "integrated"})
    with pytest.raises(ValueError, match="polynomial: found no law"):
        self_sensing("polynomial", laws())
    with pytest.raises(ValueError, match="kind: found 'magic'"):
        self_sensing("magic", laws())
    with pytest.raises(ValueError, match="no channel tip_deflection"):
        characterise(Recording(np.arange(3.0), {RESISTANCE: np.full(3, 1e4)}), laws())


def test_a_deflection_that_the_resistance_does_not_determine_is_told():
    assert all(self_sensing(kind, laws()).doubt == "" for kind in ("composite", "dynamic"))
    even = laws() | bank([0.0, 0.0, 0.0], 60.0, [-5.0, 0.12, -1e-3]).to_parameters("model.resistance")
    scheme = self_sensing("composite", even)
    with pytest.warns(
        UserWarning,
        match=r"^tip_deflection cannot be estimated from film_resistance: .* composite scheme errs by",
    ):
        scheme.estimate([1e4])


def test_a_direct_scheme_of_a_device_without_body_says_which_model_can_be_used():
    with pytest.raises(ValueError, match=r"egpi: found no law; `fit` writes .* use scheme composite with"):
        self_sensing("egpi", {"model.device": STACK.document})


def test_records_describe_what_characterise_writes():
    channels = samples(np.linspace(36, 94, 200))
    found = characterise(Recording(np.arange(200.0), channels, "integrated"), laws())
    records: dict[str, Parameter] = {record.name: record for record in PARAMETERS}
    assert set(found) == set(records)
    for name, value in found.items():
        assert records[name].check(value) == value
    assert set(KINDS) == {name.rsplit(".", 1)[1] for name in records if ".bounds." in name} - {
        "log10_resistance"
    }


def identification_current():
    """The damped oscillation of section 7.3.1, 10 ms a level, from the cold."""
    low, high = 3.68e-3, 8.49e-3
    levels = low + (high - low) * damped_oscillation(np.linspace(0, 1, 31))
    return np.concatenate([np.full(30, low), np.repeat(levels, 10)])


@pytest.mark.parametrize("seed", [3, pytest.param(17, marks=pytest.mark.slow)])
def test_identified_from_a_recording_it_estimates_an_independent_sequence(seed):
    """Truth is thousands of switching domains; only what a rig records goes into the identification."""
    device = truth("integrated", seed=seed)
    recorded = device.simulate(identification_current(), seed=seed)
    names = ("heater_current", RESISTANCE, TIP_DEFLECTION)
    given = Recording(recorded.time_s, {name: recorded[name] for name in names}, "integrated")
    parameters = fit(given, "integrated")
    sequence = np.repeat(random_levels(3.68e-3, 8.49e-3, 200, seed=seed), 10)
    test = device.simulate(np.concatenate([np.full(30, 3.68e-3), sequence]), seed=seed + 1)
    error = {}
    for kind in KINDS:
        found, _ = self_sensing(kind, parameters).estimate(test[RESISTANCE])
        gap = np.abs(found.deflection - test["true_tip_deflection"])[200:]
        error[kind] = 100 * gap.mean() / 57.03e-6
        assert np.mean(gap <= found.bound[200:]) > 0.85
    assert error["composite"] < 0.6
    assert error["dynamic"] == error["composite"], "this device has no mode to carry"
    for other in ("egpi", "preisach", "polynomial"):
        assert error["composite"] < error[other] < 2.5


@pytest.mark.slow
def test_together_the_composite_and_the_direct_scheme_err_less_on_a_slow_cycle():
    """Three cycles between levels that the identification does not stop at, means of three devices."""
    error = {kind: [] for kind in ("composite", "preisach", "combined")}
    cycle = 5.95e-3 + 1.1e-3 * np.sin(2 * np.pi * np.arange(9000) / 3000)
    for seed in (21, 22, 23):
        device = truth("integrated", seed=seed)
        recorded = device.simulate(identification_current(), seed=seed)
        names = ("heater_current", RESISTANCE, TIP_DEFLECTION)
        given = Recording(recorded.time_s, {name: recorded[name] for name in names}, "integrated")
        parameters = fit(given, "integrated")
        test = device.simulate(np.concatenate([np.full(30, 3.68e-3), cycle]), seed=seed + 1)
        for kind, found in error.items():
            estimate, _ = self_sensing(kind, parameters).estimate(test[RESISTANCE])
            found.append(np.mean(np.abs(estimate.deflection - test["true_tip_deflection"])[30:]) / 57.03e-6)
    means = {kind: float(np.mean(found)) for kind, found in error.items()}
    assert means["combined"] < 0.95 * min(means["composite"], means["preisach"])


def test_identification_uses_the_channels_there_are():
    recorded = truth("integrated", seed=1).simulate(identification_current(), seed=1)
    film = Recording(
        recorded.time_s, {name: recorded[name] for name in ("heater_current", RESISTANCE)}, "integrated"
    )
    parameters = fit(film, "integrated")
    assert parameters["model.resistance.weights"]
    assert not any(name.startswith(("model.deflection", "model.self_sensing")) for name in parameters)


def test_laws_of_its_own_make_the_composite_scheme_better_between_the_levels_of_the_recording():
    """Minor loops inside the transition, which the damped oscillation does not play."""
    device = truth("integrated", seed=900005)
    recorded = device.simulate(identification_current(), seed=5)
    names = ("heater_current", RESISTANCE, TIP_DEFLECTION)
    given = Recording(recorded.time_s, {name: recorded[name] for name in names}, "integrated")
    parameters = fit(given, "integrated")
    assert len(parameters["model.self_sensing.composite.deflection.weights"]) == PLAYS_OWN
    own = {name: v for name, v in parameters.items() if not name.startswith("model.self_sensing.composite")}
    inside = np.repeat(random_levels(5.6e-3, 6.6e-3, 200, seed=1), 10)
    test = device.simulate(np.concatenate([np.full(30, 3.68e-3), inside]), noise=False)
    error = []
    for known in (parameters, own):
        found, _ = self_sensing("composite", known).estimate(test[RESISTANCE])
        error.append(np.mean(np.abs(found.deflection - test["true_tip_deflection"])[200:]) / 57.03e-6)
    assert error[0] < error[1]
    assert error[0] < 0.005


def test_a_law_given_by_hand_and_a_recording_too_short_keep_the_laws_of_the_model():
    recorded = truth("integrated", seed=1).simulate(identification_current(), seed=1)
    banks = ("resistance.weights", "deflection.weights")
    by_hand = composite_parameters(recorded, laws())
    assert all(by_hand[f"model.self_sensing.composite.{name}"] == [] for name in banks)
    fitted = fit(recorded, "integrated")
    short = Recording(recorded.time_s[:300], {k: v[:300] for k, v in recorded.channels.items()}, "integrated")
    kept = composite_parameters(short, fitted)
    assert all(kept[f"model.self_sensing.composite.{name}"] == [] for name in banks)
