"""The Preisach operator against relays switched one by one, and the properties that define it."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.hysteresis.preisach import PreisachOperator, signed_area_matrix
from vo2_models.hysteresis.preisach.grid import cell_areas, everett_table, pack, unpack
from vo2_models.hysteresis.preisach.kernels import HEADER, run


def relays(walls, density, bias, diagonal, inputs, parts=4):
    """Output by switching every hysteron: each cell cut into `parts` x `parts`, inputs on the sub-walls only."""
    fine = np.concatenate([np.linspace(a, b, parts, endpoint=False) for a, b in pairwise(walls)])
    fine = np.append(fine, walls[-1])
    areas = np.tril(np.outer(np.diff(fine), np.diff(fine)))
    areas[np.diag_indices_from(areas)] *= 0.5
    cell = np.repeat(np.arange(walls.size - 1), parts)
    mass = density[np.ix_(cell, cell)] * areas
    if diagonal == "square":
        mass[cell[:, None] == cell[None, :]] *= 2.0
    relay = -np.ones_like(mass)
    outputs = []
    for v in inputs:
        relay[fine[1:] <= v + 1e-12, :] = 1.0
        relay[:, fine[:-1] >= v - 1e-12] = -1.0
        outputs.append(bias + np.sum(mass * relay))
    return np.array(outputs), fine


def same(one, other):
    """Whether the same outputs follow from two memories: what lies beyond the turning points does not count."""
    size = 3 + 2 * int(one[0])
    return one[0] == other[0] and np.array_equal(one[:size], other[:size])


def random_operator(rng, level, diagonal="triangle", uniform=True):
    walls = np.linspace(-1.0, 2.0, level + 1) if uniform else np.cumsum(rng.uniform(0.05, 1.0, level + 1))
    return PreisachOperator(walls, rng.uniform(0, 3, level * (level + 1) // 2), rng.normal(), diagonal)


@pytest.mark.parametrize("diagonal", ["triangle", "square"])
@pytest.mark.parametrize("uniform", [True, False])
@pytest.mark.parametrize("level", [1, 2, 7])
def test_equals_relays_switched_one_by_one(level, uniform, diagonal):
    rng = np.random.default_rng(level)
    operator = random_operator(rng, level, diagonal, uniform)
    expected, fine = relays(operator.walls, operator.density, operator.bias, diagonal, [])
    inputs = rng.choice(fine, 300)
    expected, _ = relays(operator.walls, operator.density, operator.bias, diagonal, inputs)
    assert operator(inputs) == pytest.approx(expected, abs=1e-11 * np.ptp(operator.output_range))


def test_a_strongly_non_uniform_grid_finds_its_cells():
    walls = np.r_[0.0, np.geomspace(1e-6, 1.0, 60)]
    rng = np.random.default_rng(1)
    operator = PreisachOperator(walls, rng.random(60 * 61 // 2))
    assert operator(walls) == pytest.approx(
        operator.output_range[0] + 2 * everett_table(operator.weights)[:, 0], rel=1e-12
    )


SEED = st.integers(0, 2**32 - 1)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 12), uniform=st.booleans())
def test_batch_streaming_devices_and_split_runs_agree_exactly(seed, level, uniform):
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, level, uniform=uniform)
    low, high = operator.walls[[0, -1]]
    inputs = np.where(
        rng.random(120) < 0.3, rng.choice(operator.walls, 120), rng.uniform(low - 0.1, high + 0.1, 120)
    )
    inputs[rng.random(120) < 0.2] = inputs[0]
    batch = operator(inputs)
    state = operator.initial_memory()
    assert [operator.step(v, state) for v in inputs] == batch.tolist()
    start = operator.initial_memory("upper")
    end = start.copy()
    first, second = operator.run(inputs[:50], end), operator.run(inputs[50:], end)
    again = operator(np.stack([inputs, inputs]), np.stack([start, start]))
    assert np.array_equal(again[1], np.concatenate([first, second]))
    assert same(operator.memory(operator.history(state)), state)
    operator.run(inputs, start)
    assert same(start, end)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 12))
def test_wiping_out_is_exact(seed, level):
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, level)
    before = operator.memory(rng.uniform(-1, 2, 10))
    low, high = np.sort(rng.uniform(-1, 2, 2))
    inner = rng.uniform(low, high, 20)
    # the loop low -> high -> low wipes out everything that happened inside it
    direct, detour = before.copy(), before.copy()
    operator.run([low, high, low], direct)
    operator.run(np.r_[low, inner, high, inner, low], detour)
    assert same(direct, detour)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 12))
def test_congruency_minor_loops_between_the_same_inputs_have_the_same_shape(seed, level):
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, level)
    low, high = np.sort(rng.uniform(-1, 2, 2))
    loop = np.r_[high, np.linspace(low, high, 9), np.linspace(high, low, 9)]
    shapes = []
    for _ in range(2):
        u = operator.run(loop, operator.memory(rng.uniform(-1, 2, 8)))
        shapes.append(u[1:] - u[1])
    assert shapes[0] == pytest.approx(shapes[1], abs=1e-12 * np.ptp(operator.output_range))


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 12))
def test_monotone_input_gives_monotone_output_and_order_is_kept(seed, level):
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, level)
    tolerance = 1e-13 * np.ptp(operator.output_range)
    state = operator.memory(rng.uniform(-1, 2, 10))
    rise = np.sort(rng.uniform(state[1], 2.0, 30))
    assert np.all(np.diff(operator.run(rise, state)) >= -tolerance)
    lower = rng.uniform(-1, 2, 40)
    upper = lower + rng.uniform(0, 0.5, 40)
    assert np.all(operator(upper) - operator(lower) >= -tolerance)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 12), repeats=st.integers(2, 5))
def test_rate_independence(seed, level, repeats):
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, level)
    inputs = rng.uniform(-1, 2, 30)
    slow = np.interp(np.arange(29 * repeats + 1) / repeats, np.arange(30), inputs)
    slow[::repeats] = inputs
    assert operator(slow)[::repeats] == pytest.approx(
        operator(inputs), abs=1e-12 * np.ptp(operator.output_range)
    )


@pytest.mark.parametrize("level", [3, 10, 20, 60])
def test_a_full_memory_forgets_the_smallest_corner_on_the_way_in_and_out(level):
    """A demagnetisation and the way out of it, which passes every turning point again."""
    operator = random_operator(np.random.default_rng(2), level)
    spiral = 0.5 + 1.5 * (-0.996) ** np.arange(900)
    inputs = np.concatenate([spiral, np.linspace(spiral[-1], 2.0, 500)])
    state = operator.initial_memory()
    batch = operator.run(inputs[:900], state)
    assert HEADER + 2 * state[0] <= state.size < 900
    streamed = operator.initial_memory()
    assert [operator.step(v, streamed) for v in spiral] == batch.tolist()
    batch = np.concatenate([batch, operator.run(inputs[900:], state)])
    unforgetting = np.zeros(2000)
    unforgetting[: state.size] = operator.initial_memory()
    exact = np.empty_like(inputs)
    run(spiral, exact[:900], unforgetting, *operator.compiled)
    assert unforgetting[0] > 850
    run(inputs[900:], exact[900:], unforgetting, *operator.compiled)
    # between two turning points that are kept there is no more than a corner of that size
    kept = (state.size - HEADER) / 2
    densest = np.max(operator.density)
    corner = (2.0 * np.ptp(operator.walls) / (kept - 2)) ** 2
    assert np.max(np.abs(batch - exact)) <= 2 * densest * corner
    operator.run([5.0], state)
    assert state[0] == 1 and same(state, operator.initial_memory("upper"))


@pytest.mark.parametrize(("level", "cycles"), [(10, 25), (13, 99), (40, 60)])
def test_a_demagnetisation_of_a_hundred_cycles_is_exact(level, cycles):
    """Against the areas of (4.3), which remember no turning points."""
    operator = random_operator(np.random.default_rng(level), level)
    low, high = operator.walls[0], operator.walls[-1]
    k = np.arange(2 * cycles)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    inputs = np.concatenate([centre + half * (1 - k / k.size) * (-1.0) ** k, np.linspace(centre, high, 101)])
    expected = signed_area_matrix(inputs, operator.walls) @ operator.parameters
    assert operator(inputs) == pytest.approx(expected, abs=1e-12 * np.ptp(operator.output_range))


def test_state_does_not_follow_its_copy():
    operator = random_operator(np.random.default_rng(3), 5)
    state = operator.memory([1.0, 0.2])
    kept = state.copy()
    operator.step(1.5, state)
    assert not same(kept, state) and same(kept, operator.memory([1.0, 0.2]))


def test_packing_and_the_saturation_values():
    cells = np.tril(np.arange(1.0, 10.0).reshape(3, 3))
    assert pack(cells).tolist() == [1, 4, 5, 7, 8, 9]
    assert np.array_equal(unpack(pack(cells)), cells)
    operator = PreisachOperator.from_weights([0.0, 1.0, 3.0, 4.0], cells, bias=2.0)
    assert operator.output_range == (2.0 - 34.0, 2.0 + 34.0)
    assert operator.weights == pytest.approx(cells)
    assert cell_areas(np.array([0.0, 1.0, 3.0]), "square").tolist() == [[1, 0], [2, 4]]
    assert operator.parameters[-1] == 2.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: PreisachOperator([0, 0, 1], np.ones(3)), r"walls: found 0 after 0 at index 1"),
        (lambda: PreisachOperator([0], np.ones(0)), r"walls: found 1 value\(s\), need at least 2"),
        (lambda: PreisachOperator([0, 1, 2], np.ones(4)), r"vector: found 4 elements, need L \(L \+ 1\) / 2"),
        (lambda: PreisachOperator([0, 1, 2], np.ones(6)), r"density: found level \(3, 3\), need \(2, 2\)"),
        (lambda: PreisachOperator([0, 1, 2], np.ones((2, 2))), r"density: found 1 at \(0, 1\), need 0 above"),
        (lambda: PreisachOperator([0, 1], [np.nan]), r"density: found nan at index \(0,\)"),
        (
            lambda: PreisachOperator([0, 1], [1.0], diagonal="full"),
            r"diagonal: found 'full', need 'triangle'",
        ),
        (lambda: PreisachOperator([0, 1], [1.0]).initial_memory("up"), r"saturation: found 'up', need"),
        (lambda: PreisachOperator([0, 1], [1.0])([0.0, np.inf]), r"u: found inf at index \(1,\)"),
        (lambda: PreisachOperator([0, 1], [1.0])(0.5), r"u: found shape \(\), need 1 or 2 dimension"),
        (
            lambda: PreisachOperator([0, 1], [1.0]).step(
                np.nan, PreisachOperator([0, 1], [1.0]).initial_memory()
            ),
            r"u: found nan",
        ),
        (
            lambda: PreisachOperator([0, 1], [1.0]).run(
                np.zeros((3, 4)), PreisachOperator([0, 1], [1.0]).initial_memory(devices=2)
            ),
            r"memory: found shape \(2, 403\), need \(3, 403\)",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_streaming_many_devices():
    operator = random_operator(np.random.default_rng(4), 6)
    inputs = np.random.default_rng(5).uniform(-1, 2, (3, 40))
    state = operator.initial_memory(devices=3)
    streamed = np.stack([operator.step_devices(column, state) for column in inputs.T], axis=1)
    assert np.array_equal(streamed, operator(inputs))
    assert same(state[1], operator.memory(inputs[1]))
    with pytest.raises(ValueError, match=r"memory: found shape \(3, 403\), need \(403,\)"):
        operator.step(0.0, state)
