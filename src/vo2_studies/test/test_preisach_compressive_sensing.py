"""Compressive sensing: the l1 solvers against HiGHS, recovery of sparse outputs, section 4.3 in small."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import idct
from scipy.optimize import linprog
from vo2_models.hysteresis.preisach import PreisachOperator, signed_area_matrix
from vo2_models.identification.excitation import damped_oscillation
from vo2_studies.preisach.basis_pursuit import basis_pursuit
from vo2_studies.preisach.compressive_device_study import compressive_device_study
from vo2_studies.preisach.compressive_sensing import (
    identify_compressed,
    identify_preisach_compressed,
)
from vo2_studies.preisach.monte_carlo import METHODS, MORE, PUBLISHED, compressive_sensing_study

SEED = st.integers(0, 2**32 - 1)


def partial_cosines(rng, n, m):
    return np.ascontiguousarray(idct(np.eye(n), axis=0, norm="ortho")[rng.permutation(n)[:m]])


@settings(deadline=None, max_examples=30)
@given(seed=SEED, n=st.integers(2, 60), share=st.floats(0.1, 0.95))
def test_least_norm_equals_that_of_the_linear_programme(seed, n, share):
    rng = np.random.default_rng(seed)
    matrix = partial_cosines(rng, n, max(1, int(share * n)))
    measured = 1e3 * rng.normal(size=matrix.shape[0])
    found = basis_pursuit(matrix, measured)
    best = linprog(np.ones(2 * n), A_eq=np.hstack([matrix, -matrix]), b_eq=measured, method="highs")
    assert np.abs(found.solution).sum() == pytest.approx(best.fun, rel=1e-6)
    assert matrix @ found.solution == pytest.approx(measured, abs=1e-8 * np.abs(measured).max())
    assert abs(found.gap) < 1e-5


@settings(deadline=None, max_examples=15)
@given(seed=SEED)
def test_noise_bound_is_used_up_and_the_duality_gap_closes(seed):
    rng = np.random.default_rng(seed)
    matrix = partial_cosines(rng, 50, 30)
    measured = rng.normal(size=30)
    bound = 0.3 * float(np.linalg.norm(measured))
    found = basis_pursuit(matrix, measured, noise=bound)
    assert np.linalg.norm(matrix @ found.solution - measured) <= bound * (1 + 1e-9)
    assert 0 <= found.gap + 1e-12 <= 1e-6
    assert np.abs(found.solution).sum() < np.abs(basis_pursuit(matrix, measured).solution).sum()
    assert np.array_equal(basis_pursuit(matrix, measured, noise=100.0).solution, np.zeros(50))


def test_a_sparse_vector_is_recovered_exactly():
    rng = np.random.default_rng(1)
    q = np.zeros(120)
    q[rng.choice(120, 8, replace=False)] = rng.normal(size=8)
    matrix = partial_cosines(rng, 120, 60)
    assert basis_pursuit(matrix, matrix @ q).solution == pytest.approx(q, abs=1e-6)


def test_all_outputs_measured_return_the_operator_and_both_routes_agree():
    rng = np.random.default_rng(2)
    walls = np.arange(9.0)
    truth = PreisachOperator(walls, rng.uniform(0, 12, 36), 1.0, "square")
    outputs = truth(damped_oscillation(walls))
    every = np.arange(37)
    found, detail = identify_preisach_compressed(outputs, every, walls, diagonal="square")
    assert found.parameters == pytest.approx(truth.parameters, abs=1e-7)
    assert detail.outputs == pytest.approx(outputs, abs=1e-7)
    matrix = signed_area_matrix(damped_oscillation(walls), walls, diagonal="square")
    rows = np.sort(rng.choice(37, 25, replace=False))
    order = np.argsort(outputs)
    for nonnegative in (False, True):
        fast, _ = identify_preisach_compressed(
            outputs[rows], rows, walls, order=order, nonnegative=nonnegative, diagonal="square"
        )
        bounded = np.arange(37) < 36 if nonnegative else None
        general = identify_compressed(outputs[rows], rows, matrix, order=order, nonnegative=bounded)
        assert fast.parameters == pytest.approx(general.parameters, abs=1e-5)


def test_rank_deficient_matrix_takes_the_pseudoinverse():
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(30, 4)) @ rng.normal(size=(4, 10))
    w = rng.normal(size=10)
    found = identify_compressed(matrix @ w, np.arange(30), matrix)
    assert found.parameters == pytest.approx(np.linalg.pinv(matrix) @ (matrix @ w), abs=1e-6)
    assert np.linalg.norm(found.parameters) < np.linalg.norm(w)


def test_section_4_3_in_small():
    study = compressive_sensing_study((150, 300), runs=2, seed=1)
    # what holds here, and what of the published claims does not (see the module)
    assert study.ratio("coefficients", "CS Order", "CS") == pytest.approx(0.173, abs=0.08)
    assert study.ratio("density", "CS Order Non-negative") < 0.8
    assert study.ratio("model", "CS Order Non-negative") < 0.95
    assert study.ratio("density", "CS Order Non-negative", "CS Order") < 1.0
    assert study.ratio("model", "Minimum norm") < 0.6
    assert study.ratio("density", "CS") > 1.0 > PUBLISHED["density"]["CS"]
    assert study.ratio("density", "Least Squares, bias >= 0") == pytest.approx(1.0, abs=0.02)
    assert study.gap < 1e-4
    # no least-squares solution is as bad as the published baseline must have been
    implied = study.errors["density"][:, METHODS.index("CS")] / PUBLISHED["density"]["CS"]
    solutions = [k for k, name in enumerate(METHODS + MORE) if not name.startswith("CS")]
    assert np.all(implied[:, None] > 2.0 * study.errors["density"][:, solutions])
    study, again = (compressive_sensing_study((10, 20), runs=2, level=7, seed=1) for _ in range(2))
    assert all(np.array_equal(again.errors[k], study.errors[k]) for k in study.errors)


def test_section_4_4_in_small():
    study = compressive_device_study((150, 300), runs=2, seed=1, outside_always=True)
    for measure in ("density", "model", "random input"):
        assert study.ratio(measure, "CS Order Non-negative") <= study.ratio(measure, "CS Order")
        assert study.ratio(measure, "CS Order") < study.ratio(measure, "CS")
    with pytest.raises(ValueError, match=r"runs: found 0"):
        compressive_device_study(runs=0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: basis_pursuit(np.eye(3)[:2], np.zeros(3)), r"matrix: found shape \(2, 3\) for 3"),
        (lambda: basis_pursuit(2 * np.eye(3), np.zeros(3)), r"matrix: found rows that are not orthonormal"),
        (lambda: basis_pursuit(np.eye(3), np.zeros(3), noise=-1.0), r"noise: found -1"),
        (
            lambda: identify_preisach_compressed([1.0, 2.0], [0, 0], [0, 1, 2]),
            r"rows: found 2 indices .* 1 of them",
        ),
        (lambda: identify_preisach_compressed([1.0], [9], [0, 1, 2]), r"rows: found 1 indices from 9 to 9"),
        (lambda: identify_preisach_compressed([1.0], [0.5], [0, 1, 2]), r"rows: found float64"),
        (
            lambda: identify_preisach_compressed([1.0], [0], [0, 1, 2], order=[0, 0, 1, 2]),
            r"order: found shape \(4,\), need a permutation of 0 to 3",
        ),
        (
            lambda: identify_compressed([1.0], [0], np.eye(2), nonnegative=[True]),
            r"nonnegative: found shape \(1,\), need \(2,\)",
        ),
        (lambda: compressive_sensing_study(runs=0), r"runs: found 0"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
