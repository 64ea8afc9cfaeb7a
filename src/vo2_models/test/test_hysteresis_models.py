"""The compiled play models against the equations, and what every operator of the family must satisfy."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from play_reference import egpi, tanh_pair
from vo2_models.hysteresis import (
    CPI,
    EGPI,
    GPI,
    Cosine,
    Linear,
    LinearEnvelopes,
    MemorylessSum,
    OrderWarning,
    Play,
    Polynomial,
    Sine,
    TabulatedEnvelopes,
    Tanh,
    TanhEnvelopes,
    Zero,
    kernels,
)

finite = st.floats(-4, 4, allow_nan=False, width=32)
inputs = st.lists(finite, min_size=1, max_size=40)


@st.composite
def ordered_models(draw, *, nonnegative=True, memoryless=True):
    """Random models over inputs in [-4, 4]: envelope families, shared or per play, that preserve order."""
    n = draw(st.integers(1, 9))
    steps = draw(st.lists(st.floats(0.001, 0.3), min_size=n, max_size=n))
    radii = np.cumsum(steps) - steps[0] * draw(st.booleans())
    low = 0.0 if nonnegative else -2.0
    weights = np.array(draw(st.lists(st.floats(low, 3), min_size=n, max_size=n)))
    size = draw(st.sampled_from([None, n]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    slope = rng.uniform(0.3, 1.5, size)
    middle = rng.uniform(-0.5, 0.5, size)
    half_width = rng.uniform(0.0, 1.0, size)
    family = draw(st.sampled_from(["tanh", "linear", "table"]))
    if family == "table":
        x = np.linspace(-5, 5, 23)
        y = np.cumsum(rng.uniform(0.01, 0.5, x.size if size is None else (n, x.size)), axis=-1)
        envelopes = TabulatedEnvelopes(x, y, y + half_width.max() if size else y + half_width)
    else:
        kind = TanhEnvelopes if family == "tanh" else LinearEnvelopes
        envelopes = kind(slope, middle - half_width, slope, middle + half_width)
    part = Zero()
    if memoryless:
        part = draw(
            st.sampled_from(
                [
                    Zero(),
                    Linear(-0.7),
                    Sine(0.8, 1.3, 0.2),
                    Cosine(-0.5, 0.9),
                    Tanh(1.1, 0.6, -0.3),
                    Polynomial([0.3, -0.2, 0.1]),
                    MemorylessSum((Linear(0.4), Tanh(-0.6, 2.0))),
                ]
            )
        )
    return EGPI(radii, weights, envelopes, part, bias=0.25)


def reference_pairs(model):
    n = model.plays
    if model.envelopes.plays is None:
        return [(lambda v: float(model.envelopes.rising(v)), lambda v: float(model.envelopes.falling(v)))] * n
    return [
        (
            lambda v, j=j: float(model.envelopes.rising(v)[j]),
            lambda v, j=j: float(model.envelopes.falling(v)[j]),
        )
        for j in range(n)
    ]


@given(ordered_models(nonnegative=False), inputs)
@settings(max_examples=60, deadline=None)
def test_compiled_model_is_the_equation(model, values):
    start = model.initial_state()
    expected, memory = egpi(
        values,
        model.radii,
        model.weights,
        reference_pairs(model),
        lambda v: float(model.memoryless(v)),
        model.bias,
        start[0],
        start[1:],
    )
    output, state = model.simulate(values)
    np.testing.assert_allclose(output, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state[1:], memory, rtol=0, atol=1e-12)
    assert state[0] == values[-1]


@given(ordered_models(), inputs, st.integers(1, 4))
@settings(max_examples=40, deadline=None)
def test_batch_streaming_and_devices_agree(model, values, devices):
    batch, final = model.simulate(values)
    state = model.initial_state()
    stream = [model.update(v, state) for v in values]
    np.testing.assert_allclose(stream, batch, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(state, final)
    shifts = 0.1 * np.arange(devices)[:, None]
    many = np.asarray(values)[None, :] - shifts
    outputs, states = model.simulate(many)
    streamed = model.initial_state(devices=devices)
    for k in range(many.shape[1]):
        np.testing.assert_allclose(model.update(many[:, k], streamed), outputs[:, k], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(streamed, states)
    for i in range(devices):
        alone, last = model.simulate(many[i])
        np.testing.assert_array_equal(alone, outputs[i])
        np.testing.assert_array_equal(last, states[i])


@given(ordered_models(), inputs, st.lists(st.integers(1, 3), min_size=40, max_size=40))
@settings(max_examples=40, deadline=None)
def test_rate_independence(model, values, repeats):
    """Repeating samples, and passing through points between them, changes nothing at the samples."""
    plain, _ = model.simulate(values)
    slow = []
    where = []
    for k, (value, count) in enumerate(zip(values, repeats, strict=False)):
        before = values[k - 1] if k else value
        slow += [*np.linspace(before, value, count + 1)[1:].tolist(), value]
        where.append(len(slow) - 1)
    output, _ = model.simulate(slow)
    np.testing.assert_allclose(output[where], plain, rtol=0, atol=1e-12)


@given(ordered_models(), inputs, finite, finite)
@settings(max_examples=40, deadline=None)
def test_wiping_out(model, values, first, second):
    """An excursion inside an earlier extremum leaves no trace once the input passes it again."""
    low, high = min(first, second), max(first, second)
    _, before = model.simulate([*values, low, high])
    inner = np.clip(values, low, high)
    output, after = model.simulate([*inner, high], before)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)
    assert output[-1] == pytest.approx(model.output(before), abs=1e-11)


@given(ordered_models(memoryless=False), inputs, inputs)
@settings(max_examples=40, deadline=None)
def test_monotone_in_the_input(model, values, raises):
    """With non-negative weights a larger input history gives a larger output (order preservation)."""
    raises = (raises * 40)[: len(values)]
    lower, _ = model.simulate(values)
    upper, _ = model.simulate(np.asarray(values) + np.abs(raises))
    assert np.all(upper >= lower - 1e-11)


@given(st.floats(0.1, 2), finite, finite, inputs, inputs)
@settings(max_examples=40, deadline=None)
def test_congruency_of_the_classical_model(scale, first, second, history, other):
    """Minor loops between the same inputs are congruent: translates of each other along the output."""
    model = CPI([0.0, 0.3, 0.9, 2.0], [scale, 1.0, 0.5, 2.0])
    low, high = min(first, second), max(first, second)
    loops = []
    for past in (history, other):
        _, state = model.simulate([*past, low, high, low])
        loop, _ = model.simulate(
            np.concatenate([np.linspace(low, high, 9), np.linspace(high, low, 9)]), state
        )
        loops.append(loop - loop[0])
    np.testing.assert_allclose(loops[0], loops[1], rtol=0, atol=1e-11)


def test_the_rising_form_needs_no_order_and_differs_from_the_clamp():
    """Where envelopes cross, the model is (B.6) as it stands, when asked for; never silently a clamp."""
    envelopes = TanhEnvelopes(2.0, 0.0, 1.0, 0.0)
    with pytest.raises(ValueError, match=r"envelopes: found gamma_R\(v\) - r above .* for play 0"):
        GPI([0.0], [1.0], envelopes).simulate([0.0, 1.0])
    with pytest.warns(OrderWarning):
        GPI([0.0], [1.0], envelopes, on_disorder="warn").simulate([0.0, 1.0])
    accepted = GPI([0.0], [1.0], envelopes, on_disorder="accept")
    output, _ = accepted.simulate([-1.0, 0.5, 0.4])
    assert output[1] == pytest.approx(math.tanh(1.0))
    assert output[2] == pytest.approx(math.tanh(0.4))
    # the same envelopes are in order for a large enough radius, and for inputs below the crossing
    GPI([0.2], [1.0], envelopes).simulate([0.0, 1.0])
    GPI([0.0], [1.0], envelopes).simulate([-1.0, 0.0])
    with pytest.raises(ValueError, match="envelopes: found"):
        GPI([0.0], [1.0], envelopes, input_range=(-1.0, 1.0))


def test_plays_without_weight_do_not_spoil_the_order():
    envelopes = TanhEnvelopes(2.0, 0.0, 1.0, 0.0)
    model = GPI([0.0, 0.2], [0.0, 1.0], envelopes, input_range=(-1.0, 1.0))
    assert model.order_excess(-1.0, 1.0)[2] == 1
    own = TanhEnvelopes([2.0, 1.0], [0.0, -0.1], [1.0, 1.0], [0.0, 0.1])
    assert GPI([0.0, 0.0], [0.0, 1.0], own, input_range=(-1.0, 1.0)).order_excess(-1.0, 1.0)[2] == 1
    with pytest.raises(ValueError, match="for play 0"):
        GPI([0.0, 0.0], [0.1, 1.0], own, input_range=(-1.0, 1.0))


@given(ordered_models(), inputs, finite)
@settings(max_examples=30, deadline=None)
def test_kernels_for_other_compiled_loops(model, values, v):
    """Looking ahead leaves the state alone and gives what a step then gives."""
    _, state = model.simulate(values)
    before = state.copy()
    ahead = kernels.move_egpi(v, model.packed, state, False)
    np.testing.assert_array_equal(state, before)
    assert kernels.egpi_output(model.packed, state) == pytest.approx(model.output(state), abs=1e-12)
    assert kernels.egpi_step(v, model.packed, state) == ahead
    assert state[0] == v
    assert math.isnan(kernels.egpi_step(math.nan, model.packed, state))
    assert math.isnan(kernels.egpi_step(v, model.packed, state[1:].copy()))


def test_saturation_and_given_memory():
    model = GPI([0.1, 0.4], [1.0, 2.0], TanhEnvelopes(1.0, -0.5, 1.0, 0.5))
    np.testing.assert_allclose(model.initial_state()[1:], [-0.9, -0.6])
    np.testing.assert_allclose(model.initial_state("upper")[1:], [0.9, 0.6])
    from_above = model.initial_state("upper", v=0.0)
    np.testing.assert_allclose(from_above[1:], np.minimum(np.tanh(0.5) + model.radii, [0.9, 0.6]))
    clipped = model.initial_state(v=0.0, memory=[5.0, 0.0])
    np.testing.assert_allclose(clipped[1:], [np.tanh(0.5) + 0.1, 0.0])
    restored = pickle.loads(pickle.dumps(clipped))
    assert model.update(0.3, restored) == model.update(0.3, clipped.copy())
    classical = CPI([0.0, 1.0], [1.0, 1.0])
    assert classical.update(2.0, classical.initial_state()) == 3.0
    assert classical.update(2.0, classical.initial_state("upper")) == 5.0


def test_simulate_leaves_the_memory_it_was_given():
    model = Play(0.5)
    state = model.initial_state(v=0.0, memory=[0.0])
    model.simulate([1.0, 2.0], state)
    np.testing.assert_array_equal(state, [0.0, 0.0])


def test_play_outputs_are_the_regressors_of_the_model():
    model = GPI([0.0, 0.3, 0.6], [1.0, 0.5, 2.0], TanhEnvelopes(1.0, -0.5, 1.0, 0.5), bias=3.0)
    v = np.sin(np.linspace(0, 20, 200)) * np.linspace(3, 0.1, 200)
    output, _ = model.simulate(v)
    np.testing.assert_allclose(model.play_outputs(v) @ model.weights + 3.0, output, atol=1e-12)


def test_per_play_envelopes_of_one_pair_are_the_shared_pair():
    shared = GPI([0.1, 0.5], [1.0, 2.0], TanhEnvelopes(1.0, -0.5, 1.0, 0.5))
    own = GPI([0.1, 0.5], [1.0, 2.0], TanhEnvelopes([1.0] * 2, [-0.5] * 2, [1.0] * 2, [0.5] * 2))
    v = np.sin(np.linspace(0, 30, 300)) * 2
    np.testing.assert_allclose(shared.simulate(v)[0], own.simulate(v)[0], atol=1e-14)


@pytest.mark.parametrize(
    "part",
    [Linear(2.0), Sine(1.5, 0.7, 0.3), Cosine(2.0, 1.1), Tanh(1.2, 0.5, 0.1), Polynomial([1, 2, -0.5, 0.1])],
)
def test_memoryless_slopes(part):
    v = np.linspace(-2, 2, 11)
    np.testing.assert_allclose(part.slope(v), (part(v + 1e-6) - part(v - 1e-6)) / 2e-6, atol=1e-8)


def test_tanh_pair_matches_math():
    rising, falling = tanh_pair(1.2, -0.3, 0.9, 0.4)
    envelopes = TanhEnvelopes(1.2, -0.3, 0.9, 0.4)
    assert float(envelopes.rising(0.7)) == pytest.approx(rising(0.7), abs=1e-15)
    assert float(envelopes.falling(0.7)) == pytest.approx(falling(0.7), abs=1e-15)


LINE = LinearEnvelopes()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: CPI([-0.1], [1.0]), r"radii: found -0.1 at index 0, need values >= 0"),
        (lambda: CPI([0.5, 0.2], [1.0, 1.0]), r"radii: found 0.2 after 0.5 at index 1, need ascending"),
        (lambda: CPI([0.0, np.nan], [1.0, 1.0]), r"radii: found nan at index \(1,\)"),
        (lambda: CPI([0.0], [1.0, 2.0]), r"weights: found 2 value\(s\), need 1"),
        (lambda: CPI([], []), r"radii: found none, need at least one"),
        (
            lambda: TanhEnvelopes(-1.0, 0.0, 1.0, 0.0),
            r"rising_slope: found -1 at index 0, need slopes above 0",
        ),
        (lambda: TanhEnvelopes([1.0], 0.0, 1.0, 0.0), r"rising_offset: found shape \(\), need \(1,\)"),
        (lambda: TabulatedEnvelopes([0, 1], [1, 0], [1, 2]), r"rising_values: found 0 after 1 at index 1"),
        (lambda: TabulatedEnvelopes([0], [1], [1]), r"inputs: found 1 knot\(s\), need at least 2"),
        (
            lambda: GPI([0.1], [1.0], TanhEnvelopes([1] * 2, [0] * 2, [1] * 2, [0] * 2)),
            r"envelopes: found pairs",
        ),
        (lambda: GPI([0.1], [1.0], LINE, input_range=(1.0, 0.0)), r"input_range: found \(1, 0\), need lower"),
        (lambda: GPI([0.1], [1.0], LINE, on_disorder="ignore"), r"on_disorder: found 'ignore', need"),
        (lambda: EGPI([0.1], [1.0], LINE, memoryless=3), r"memoryless: found int, need"),
        (lambda: Polynomial([]), r"coefficients: found none"),
        (lambda: Sine(1.0, np.inf), r"frequency: found inf"),
        (lambda: CPI([0.0], [1.0]).simulate([0.0, np.nan]), r"v: found nan at index \(1,\)"),
        (lambda: CPI([0.0], [1.0]).simulate(np.zeros((1, 1, 1))), r"v: found shape \(1, 1, 1\)"),
        (lambda: CPI([0.0], [1.0]).simulate([0.0], np.zeros(3)), r"state: found shape \(3,\), need \(2,\)"),
        (lambda: CPI([0.0], [1.0]).update(np.nan, np.zeros(2)), r"v: found nan"),
        (lambda: CPI([0.0], [1.0]).update(1.0, np.zeros(3)), r"state: found shape \(3,\), need \(2,\)"),
        (lambda: CPI([0.0], [1.0]).initial_state(memory=[0.0]), r"v: found none, need the present input"),
        (lambda: CPI([0.0], [1.0]).initial_state("middle"), r"saturation: found 'middle'"),
    ],
)
def test_bad_input_is_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()
