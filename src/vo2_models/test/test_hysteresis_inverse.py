"""Inverses of the play family: round trips, reachability, the nearest solution, and section 6.4.1."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from vo2_models.hysteresis import (
    CPI,
    EGPI,
    GPI,
    AnalyticInverse,
    Cosine,
    FixedPointInverse,
    Linear,
    LinearEnvelopes,
    Polynomial,
    RobustInverse,
    Sine,
    TabulatedEnvelopes,
    Tanh,
    TanhEnvelopes,
    Zero,
    convergence_condition,
    inverse_cpi,
    inverse_cpi_state,
)
from vo2_models.hysteresis.inverse_robust import output_range

RANGE = (-3.0, 3.0)
sequences = st.lists(st.floats(*RANGE, width=32), min_size=1, max_size=25)
seeds = st.integers(0, 2**32 - 1)
parts = st.sampled_from(
    [
        Zero(),
        Linear(-0.4),
        Sine(0.6, 3.0, 0.4),
        Cosine(5.0),
        Tanh(-1.2, 2.0, 0.3),
        Polynomial([0.1, -0.5, 0.0, 0.05]),
    ]
)


def random_model(seed, part, *, family, shared, n=6):
    """A model whose envelopes are in order on RANGE, with a few weights of zero."""
    rng = np.random.default_rng(seed)
    size = None if shared else n
    radii = np.sort(rng.uniform(0, 0.9, n)) * rng.integers(0, 2)
    radii = radii if radii.any() else np.arange(n) / n
    weights = rng.uniform(0, 2, n) * (rng.random(n) < 0.8) + 0.01
    slope, middle, half = rng.uniform(0.4, 3, size), rng.uniform(-1, 1, size), rng.uniform(0, 1, size)
    if family == "table":
        x = np.linspace(-4, 4, 11)
        y = np.cumsum(rng.uniform(0.02, 0.5, x.size if shared else (n, x.size)), axis=-1) - 1.5
        envelopes = TabulatedEnvelopes(x, y, y + 0.3)
    else:
        kind = TanhEnvelopes if family == "tanh" else LinearEnvelopes
        envelopes = kind(slope, middle - half, slope, middle + half)
    model = EGPI(radii, weights, envelopes, part)
    # envelopes far apart leave plays that never move: such a model has nothing to invert
    assume(output_range(model, *RANGE) > 1e-3)
    return model


@given(seeds, parts, st.sampled_from(["tanh", "linear", "table"]), st.booleans(), sequences)
@example(
    10266,
    Polynomial([0.1, -0.5, 0.0, 0.05]),
    "tanh",
    True,
    [2.145622491836548, 0.0, -1.3046875, 0.0, -1.3046875],
)
@settings(max_examples=150, deadline=None)
def test_every_reachable_output_is_reached_by_the_nearest_input(seed, part, family, shared, values):
    """Each wish is the output of some input from the present state; the answer gives it and is not farther."""
    model = random_model(seed, part, family=family, shared=shared)
    inverse = RobustInverse(model, RANGE)
    state = model.initial_state("upper", v=RANGE[0])
    for v in values:
        trial = state.copy()
        wish = model.update(v, trial)
        before = state[0]
        found = inverse.invert(wish, state)
        assert found.reached
        assert abs(found.output - wish) <= 1e-9 * inverse.output_range
        # at an extremum, outputs that agree to the solver's 1e-12 belong to inputs about 1e-6 apart
        assert abs(found.input - before) <= abs(v - before) + 3e-5
        assert model.output(state) == pytest.approx(found.output, abs=1e-12)


@given(seeds, parts, st.sampled_from(["tanh", "linear", "table"]), st.booleans(), sequences, st.floats(-2, 2))
@settings(max_examples=80, deadline=None)
def test_no_input_comes_closer_to_an_unreachable_output(seed, part, family, shared, values, factor):
    """Against a search on a fine grid from the same state: nothing there beats the answer."""
    model = random_model(seed, part, family=family, shared=shared)
    inverse = RobustInverse(model, RANGE)
    _, state = model.simulate([RANGE[0], *values])
    wish = model.output(state) + factor * inverse.output_range
    grid = np.linspace(*RANGE, 601)
    reachable = model.simulate(grid[:, None], np.tile(state, (grid.size, 1)))[0][:, 0]
    found = inverse.invert(wish, state)
    assert abs(found.output - wish) <= np.min(np.abs(reachable - wish)) + 1e-9 * inverse.output_range
    assert found.reached == (abs(found.output - wish) <= 1e-9 * inverse.output_range)
    if reachable.min() <= wish <= reachable.max() and isinstance(part, Zero):
        assert found.reached


@given(seeds, parts, st.sampled_from(["tanh", "linear", "table"]), st.booleans(), sequences, sequences)
@settings(max_examples=60, deadline=None)
def test_two_inputs_reach_what_any_sequence_reaches(seed, part, family, shared, history, future):
    """A wish taken from the end of a random sequence is met by at most two inputs from the present memory."""
    model = random_model(seed, part, family=family, shared=shared)
    inverse = RobustInverse(model, RANGE)
    _, state = model.simulate([RANGE[0], *history])
    wish = model.simulate(future, state)[0][-1]
    before = state.copy()
    plan = inverse.plan(wish, state)
    assert plan.reached
    assert len(plan.inputs) <= 2
    assert all(RANGE[0] <= v <= RANGE[1] for v in plan.inputs)
    given_back, after = model.simulate(plan.inputs, before)
    assert abs(given_back[-1] - wish) <= 1e-9 * inverse.output_range
    np.testing.assert_allclose(after, state, rtol=0, atol=1e-12)


def test_a_plan_for_what_nothing_reaches_is_the_nearest():
    model = EGPI([0.0, 0.4], [1.0, 1.0], TanhEnvelopes(3.0, -1.5, 3.0, 1.5), Linear(-0.3))
    inverse = RobustInverse(model, (-2.0, 2.0))
    state = model.initial_state(v=-1.0)
    plan = inverse.plan(50.0, state)
    assert not plan.reached
    assert len(plan.inputs) == 2
    branch = model.simulate(np.linspace(2.0, -2.0, 4001), model.initial_state(v=2.0))[0]
    assert plan.output == pytest.approx(branch.max(), abs=1e-5)


@given(seeds, sequences)
@settings(max_examples=40, deadline=None)
def test_inverse_batch_streaming_and_devices_agree(seed, values):
    model = random_model(seed, Sine(0.6, 3.0), family="tanh", shared=False)
    inverse = RobustInverse(model, RANGE)
    wishes, _ = model.simulate(values)
    start = model.initial_state(v=RANGE[0])
    batch = inverse.simulate(wishes, start)
    state = start.copy()
    stream = [inverse.update(u, state) for u in wishes]
    np.testing.assert_array_equal(stream, batch.input)
    np.testing.assert_array_equal(state, batch.state)
    many = inverse.simulate(np.stack([wishes, wishes[::-1]]), np.tile(start, (2, 1)))
    np.testing.assert_array_equal(many.input[0], batch.input)
    np.testing.assert_array_equal(many.input[1], inverse.simulate(wishes[::-1], start).input)


@given(seeds, sequences)
@settings(max_examples=40, deadline=None)
def test_analytic_inverse_is_the_robust_one(seed, values):
    rng = np.random.default_rng(seed)
    radii = np.cumsum(rng.uniform(0.02, 0.2, 5))
    radii -= radii[0] * rng.integers(0, 2)
    envelopes = TanhEnvelopes(rng.uniform(0.4, 1.5), -0.4, rng.uniform(0.4, 1.5), 0.4)
    model = GPI(radii, rng.uniform(0.1, 2, 5), envelopes, bias=0.3, on_disorder="accept")
    assume(model.order_excess(*RANGE)[0] <= 0)
    start = model.initial_state("upper", v=RANGE[0])
    wishes, _ = model.simulate(values, start)
    analytic = AnalyticInverse(model, RANGE).simulate(wishes, start)
    robust = RobustInverse(model, RANGE).simulate(wishes, start)
    given_back, _ = model.simulate(analytic, start)
    np.testing.assert_allclose(given_back, wishes, rtol=0, atol=1e-11)
    np.testing.assert_allclose(analytic, robust.input, rtol=0, atol=1e-6)


@given(seeds, sequences)
@settings(max_examples=40, deadline=None)
def test_inverse_of_the_classical_model_is_a_classical_model(seed, values):
    rng = np.random.default_rng(seed)
    radii = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 1, 4))])
    model = CPI(radii, rng.uniform(0.1, 2, 5), bias=-0.7)
    _, start = model.simulate(rng.uniform(*RANGE, 6))
    outputs, end = model.simulate(values, start)
    back, final = inverse_cpi(model).simulate(outputs, inverse_cpi_state(model, start))
    np.testing.assert_allclose(back, values, rtol=0, atol=1e-10)
    np.testing.assert_allclose(final[1:], inverse_cpi_state(model, end)[1:], rtol=0, atol=1e-10)


def table_6_3():
    return EGPI([0, 0.2, 0.4, 0.6, 0.8, 2], [6, 2, 1, 2, 4, 4], memoryless=Cosine(5.0))


@pytest.mark.parametrize("seed", range(5))
def test_section_6_4_1_converges_as_published(seed):
    """Random inputs, Table 6.3, D = 5 cos v: at most 8.4 iterations at 1e-4 (8.38), 5.31 at 1e-2, on average."""
    model = table_6_3()
    start = model.initial_state(v=0.0, memory=[0] * 6)
    values = np.random.default_rng(seed).uniform(-5, 5, 1000)
    wishes, _ = model.simulate(values, start)
    fine = FixedPointInverse(model, (-8.0, 8.0), tolerance=1e-4)
    assert fine.condition.holds
    assert fine.condition.memoryless_slope == pytest.approx(5 / 6 * fine.condition.hysteresis_slope, rel=1e-5)
    result = fine.simulate(wishes, start)
    assert result.converged.all()
    assert result.iterations.mean() <= 8.4
    coarse = FixedPointInverse(model, (-8.0, 8.0), tolerance=1e-2).simulate(wishes, start)
    assert coarse.iterations.mean() <= 5.31
    # u = Psi[v_n] + D(v_{n-1}), so the residual is |D(v_n) - D(v_{n-1})| <= 5 sigma
    assert np.max(np.abs(result.output - wishes)) <= 5 * 1e-4 + 1e-9
    exact = RobustInverse(model, (-8.0, 8.0)).simulate(wishes, start)
    assert exact.reached.all()
    np.testing.assert_allclose(exact.input, values, rtol=0, atol=1e-9)


def test_the_condition_fails_where_the_robust_inverse_does_not():
    """Where (6.4) fails by far, the iteration does not converge and the bracketing inverse does."""
    model = EGPI(
        [0.0, 0.3, 0.6], [0.2, 1.0, 0.5], TanhEnvelopes(1.5, -0.6, 1.5, 0.6), Linear(0.5), input_range=RANGE
    )
    condition = convergence_condition(model, RANGE)
    assert not condition.holds
    assert condition.hysteresis_slope < 0.001 < condition.memoryless_slope == 0.5
    start = model.initial_state("upper", v=-3.0)
    wishes, _ = model.simulate(2.9 * np.sin(np.linspace(0, 12, 120)), start)
    assert not FixedPointInverse(model, max_iterations=100).simulate(wishes, start).converged.all()
    assert RobustInverse(model).simulate(wishes, start).reached.all()


def test_condition_without_a_play_of_radius_zero():
    model = EGPI([0.3], [1.0], LinearEnvelopes(), Linear(0.5))
    condition = convergence_condition(model, RANGE)
    assert condition.hysteresis_slope == 0.0
    assert not condition.holds


def test_tangential_solution_is_found():
    """The wish touches an extremum of the output inside a piece: one solution, no sign change."""
    model = EGPI([0.0], [1.0], LinearEnvelopes(), Sine(3.0, 2.0))
    inverse = RobustInverse(model, (0.0, 3.0))
    peak = np.arccos(-1 / 6) / 2
    top = peak + 3 * np.sin(2 * peak)
    state = model.initial_state(v=0.0, memory=[0.0])
    found = inverse.invert(top, state)
    assert found.reached
    assert found.input == pytest.approx(peak, abs=1e-5)
    beyond = inverse.invert(top + 1e-3, model.initial_state(v=0.0, memory=[0.0]))
    assert beyond.reached == (3.0 + 3 * np.sin(6.0) >= top + 1e-3)


def test_a_present_input_outside_the_range_enters_it():
    model = GPI([0.0, 0.5], [1.0, 1.0], TanhEnvelopes(1.0, -0.5, 1.0, 0.5))
    inverse = RobustInverse(model, RANGE)
    found = inverse.invert(-99.0, model.initial_state())
    assert not found.reached
    assert found.input == RANGE[0]


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: RobustInverse(table_6_3()), r"input_range: found none, need \(low, high\)"),
        (lambda: RobustInverse(table_6_3(), (1.0, 1.0)), r"input_range: found \(1, 1\), need lower < upper"),
        (lambda: RobustInverse(CPI([0.0], [0.0]), RANGE), r"model: found an output that does not change"),
        (lambda: inverse_cpi(CPI([0.1], [1.0])), r"radii: found smallest radius 0.1, need 0"),
        (
            lambda: inverse_cpi(CPI([0.0, 1.0], [1.0, -2.0])),
            r"weights: found the sum of the first 2 to be -1",
        ),
        (lambda: inverse_cpi(CPI([0.0, 1.0], [0.0, 2.0])), r"weights: found 0 for the smallest radius"),
        (lambda: FixedPointInverse(table_6_3(), RANGE, tolerance=0.0), r"tolerance: found 0.0, need"),
        (
            lambda: RobustInverse(table_6_3(), RANGE).simulate([np.nan], np.zeros(7)),
            r"output: found nan at index \(0,\)",
        ),
        (lambda: RobustInverse(table_6_3(), RANGE).update(1.0, np.zeros(3)), r"state: found shape \(3,\)"),
        (lambda: RobustInverse(table_6_3(), RANGE).invert(np.nan, np.zeros(7)), r"output: found nan"),
        (
            lambda: AnalyticInverse(CPI([0.0], [1.0]), RANGE).simulate([4.0], np.zeros(2)),
            r"output: found 4 at index 0, which needs an input of 4",
        ),
        (lambda: AnalyticInverse(table_6_3(), RANGE), r"model: found a memoryless part"),
    ],
)
def test_bad_input_is_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()
