"""Identification from data: excitation, rank, exactness, agreement with scipy's solver, refusal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.optimize import nnls
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.hysteresis.preisach.damped import inverse_map
from vo2_models.hysteresis.preisach.least_squares import fit_preisach
from vo2_models.hysteresis.preisach.nnls import RankDeficientError, nonnegative_least_squares
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.identification.excitation import damped_oscillation, first_order_reversal_fan

SEED = st.integers(0, 2**32 - 1)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 9), diagonal=st.sampled_from(["triangle", "square"]))
def test_matrix_times_parameters_is_the_operator(seed, level, diagonal):
    rng = np.random.default_rng(seed)
    walls = np.cumsum(rng.uniform(0.1, 1, level + 1))
    operator = PreisachOperator(walls, rng.normal(size=level * (level + 1) // 2), rng.normal(), diagonal)
    history, inputs = rng.uniform(0, walls[-1] + 0.2, (2, 90))
    matrix = signed_area_matrix(inputs, walls, diagonal=diagonal, history=history)
    expected = operator.run(inputs, operator.memory(history))
    assert matrix @ operator.parameters == pytest.approx(expected, abs=1e-11 * (1 + np.ptp(expected)))
    linear = signed_area_matrix(inputs, walls, linear=True, diagonal=diagonal)
    assert np.array_equal(linear[:, -1], inputs) and np.all(linear[:, -2] == 1.0)


def test_damped_oscillation_has_full_rank_for_every_level_to_60():
    # an integer matrix with an exact inverse is regular: no tolerance, no singular values
    for level in range(1, 61):
        walls = np.arange(level + 1.0)
        matrix = signed_area_matrix(damped_oscillation(walls), walls, diagonal="square")
        assert matrix.shape == (level * (level + 1) // 2 + 1,) * 2
        assert set(np.unique(matrix)) <= {-1.0, 1.0}
        product = inverse_map(level) @ matrix
        assert np.array_equal(product, np.eye(matrix.shape[0])), level


def test_linear_term_keeps_full_rank_to_level_60_with_one_sample_outside():
    for level in range(1, 61):
        walls = np.arange(level + 1.0)
        inputs = np.append(damped_oscillation(walls), level + 4.0)
        matrix = signed_area_matrix(inputs, walls, diagonal="square", linear=True)
        # regular if and only if the Schur complement of the regular block is not zero; all in small integers
        known = inverse_map(level) @ matrix[:-1, -1]
        assert matrix[-1, -1] - matrix[-1, :-1] @ known == 4.0
        last_wall = signed_area_matrix(inputs[:-1], walls, diagonal="square", linear=True)[-1]
        assert last_wall[-1] - last_wall[:-1] @ known == 0.0


@pytest.mark.parametrize(("extra", "regular"), [(3.0, False), (9.5, True), (-1.0, True), (2.4, True)])
def test_linear_term_needs_one_sample_off_the_walls(extra, regular):
    walls = np.arange(8.0)
    inputs = np.append(damped_oscillation(walls), extra)
    matrix = signed_area_matrix(inputs, walls, linear=True)
    assert matrix.shape[0] == matrix.shape[1] == 7 * 8 // 2 + 2
    assert (np.linalg.matrix_rank(matrix) == matrix.shape[1]) is np.bool_(regular)


def test_reversal_fan_excites_every_cell():
    walls = np.cumsum(np.random.default_rng(0).uniform(0.1, 1, 13))
    operator = PreisachOperator(walls, np.random.default_rng(1).uniform(0, 5, 78), -3.0)
    fan = first_order_reversal_fan(walls)
    found = fit_preisach(fan, operator(fan), walls)
    assert found.operator.parameters == pytest.approx(operator.parameters, abs=1e-8)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 12), diagonal=st.sampled_from(["triangle", "square"]))
def test_noise_free_damped_oscillation_returns_the_truth(seed, level, diagonal):
    rng = np.random.default_rng(seed)
    walls = np.cumsum(rng.uniform(0.3, 1, level + 1))
    truth = PreisachOperator(walls, rng.uniform(0, 12, level * (level + 1) // 2), rng.normal(), diagonal)
    inputs = damped_oscillation(walls)
    found = fit_preisach(inputs, truth(inputs), walls, diagonal=diagonal)
    assert found.operator.parameters == pytest.approx(truth.parameters, abs=1e-8)
    assert found.predict([0.0, walls[1]], history=[walls[-1]]) == pytest.approx(
        truth.run([0.0, walls[1]], truth.memory([walls[-1]])), abs=1e-8
    )


@pytest.mark.parametrize("noise", [1.0, 20.0, 500.0])
@pytest.mark.parametrize("fast_path", [True, False])
def test_agrees_with_scipy_and_is_optimal(noise, fast_path):
    level = 14
    cells = level * (level + 1) // 2
    rng = np.random.default_rng(int(noise))
    walls = np.arange(level + 1.0)
    inputs = damped_oscillation(walls)
    if not fast_path:
        inputs = np.r_[inputs, rng.choice(walls, 150)]
    truth = PreisachOperator(walls, rng.uniform(0, 12, cells))
    outputs = truth(inputs) + noise * rng.uniform(-1, 1, inputs.size)
    matrix = signed_area_matrix(inputs, walls)
    expected, norm = nnls(np.hstack([matrix, -matrix[:, -1:]]), outputs)
    found = fit_preisach(inputs, outputs, walls)
    assert np.linalg.norm(found.residual) == pytest.approx(norm, rel=1e-9)
    assert found.operator.parameters[:-1] == pytest.approx(expected[:cells], abs=1e-7 * expected.max())
    gradient = matrix.T @ found.residual
    density = found.operator.parameters[:cells]
    scale = np.linalg.norm(matrix) * np.linalg.norm(outputs)
    assert density.min() >= 0.0
    assert (
        np.all(np.abs(gradient[:cells][density > 0]) < 1e-11 * scale) and abs(gradient[cells]) < 1e-11 * scale
    )
    assert np.all(gradient[:cells] < 1e-11 * scale)


def test_level_100_is_optimal():
    walls = np.arange(101.0)
    rng = np.random.default_rng(4)
    inputs = damped_oscillation(walls)
    outputs = PreisachOperator(walls, rng.uniform(0, 12, 5050))(inputs) + rng.uniform(-50, 50, inputs.size)
    found = fit_preisach(inputs, outputs, walls)
    gradient = signed_area_matrix(inputs, walls).T @ found.residual
    density = found.operator.parameters[:-1]
    scale = 5051 * np.linalg.norm(outputs)
    assert density.min() >= 0 and np.count_nonzero(density == 0) > 500
    assert np.all(gradient[:-1] < 1e-10 * scale) and np.all(
        np.abs(gradient[:-1][density > 0]) < 1e-10 * scale
    )


def test_signed_operator_and_linear_term_are_recovered():
    rng = np.random.default_rng(5)
    walls = np.linspace(21.0, 84.0, 11)
    truth = PreisachOperator(walls, rng.normal(size=55), 4.0)
    inputs = np.r_[damped_oscillation(walls), rng.uniform(15, 90, 80)]
    outputs = truth(inputs) - 3.5 * inputs
    found = fit_preisach(inputs, outputs, walls, nonnegative=False, linear=True)
    assert found.slope == pytest.approx(-3.5, abs=1e-8)
    assert found.operator.parameters == pytest.approx(truth.parameters, abs=1e-6)
    assert found.rmse < 1e-8
    positive = PreisachOperator(walls, rng.uniform(0, 1, 55), 4.0)
    again = fit_preisach(inputs, positive(inputs) - 3.5 * inputs, walls, linear=True)
    assert again.slope == pytest.approx(-3.5, abs=1e-8)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, columns=st.integers(1, 25), free=st.booleans())
def test_block_pivoting_equals_lawson_and_hanson(seed, columns, free):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(columns + 10, columns))
    target = rng.normal(size=columns + 10)
    unbounded = np.zeros(columns, dtype=bool)
    unbounded[0] = free
    x = nonnegative_least_squares(matrix, target, unbounded)
    wide = np.hstack([matrix, -matrix[:, :1]]) if free else matrix
    assert np.linalg.norm(matrix @ x - target) == pytest.approx(nnls(wide, target)[1], rel=1e-10)
    assert np.all(x[~unbounded] >= 0)


def test_too_little_excitation_is_refused_with_its_reason():
    walls = np.arange(6.0)
    loops = np.tile([0.0, 5.0], 20)
    with pytest.raises(ValueError, match=r"v: found too little excitation"):
        fit_preisach(loops, loops, walls)
    small = np.tile(np.r_[0.0:3.1, 2.0:-0.1:-1], 5)
    with pytest.raises(
        ValueError, match=r"v: found 9 of 15 cells that never switch \(the first: alpha in \[3, 4\]"
    ):
        fit_preisach(small, small, walls)
    inputs = damped_oscillation(walls)
    with pytest.raises(ValueError, match=r"one more sample outside the walls"):
        fit_preisach(inputs, inputs, walls, linear=True)
    with pytest.raises(ValueError, match=r"rank 16 for 17 unknowns"):
        fit_preisach(np.r_[inputs, inputs], np.r_[inputs, inputs], walls, linear=True, nonnegative=False)
    with pytest.raises(ValueError, match=r"u: found 3 value\(s\), need 16"):
        fit_preisach(inputs, np.zeros(3), walls)
    with pytest.raises(RankDeficientError, match=r"2 samples cannot determine 3"):
        nonnegative_least_squares(np.zeros((2, 3)), np.zeros(2))


def test_inverse_map_is_sparse():
    inverse = inverse_map(60)
    assert sparse.issparse(inverse) and np.diff(inverse.indptr).max() == 4
