"""Sparse form of a recording in the Everett function at the nodes, and the interior point that solves in it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize
from vo2_models.hysteresis.preisach.everett_rows import (
    everett_rows,
    mass_gradient,
    mass_gram,
    mass_map,
    node_values,
)
from vo2_models.hysteresis.preisach.grid import cell_areas, everett_table, pack
from vo2_models.hysteresis.preisach.interior_point import nonnegative_masses, signed_masses
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.identification.excitation import first_order_reversal_fan

SEED = st.integers(0, 2**32 - 1)


@settings(deadline=None)  # the first call compiles
@given(seed=SEED, level=st.integers(1, 9), diagonal=st.sampled_from(["triangle", "square"]))
def test_rows_give_the_outputs_of_the_signed_areas(seed, level, diagonal):
    rng = np.random.default_rng(seed)
    walls = np.cumsum(rng.uniform(0.1, 1.0, level + 1))
    between = rng.uniform(walls[0] - 0.2, walls[-1] + 0.2, 60)
    v = np.where(rng.random(60) < 0.3, rng.choice(walls, 60), between)
    history, kept = v[:7], rng.random(53) < 0.6
    masses = rng.normal(size=level * (level + 1) // 2)
    areas = pack(cell_areas(walls, diagonal))
    matrix = signed_area_matrix(v[7:], walls, bias=False, diagonal=diagonal, history=history)[kept]
    rows = everett_rows(v[7:], walls, history=history, kept=kept)
    found = rows @ node_values(masses) - masses.sum()
    assert found == pytest.approx(matrix @ (masses / areas), abs=1e-9)


@given(seed=SEED, level=st.integers(1, 12))
@settings(deadline=None)
def test_nodes_and_masses_are_inverse_and_adjoint(seed, level):
    rng = np.random.default_rng(seed)
    size = level * (level + 1) // 2
    masses, gradient = rng.normal(size=(2, size))
    nodes = node_values(masses)
    square = np.zeros((level, level))
    square[np.tril_indices(level)] = masses
    assert nodes == pytest.approx(pack(everett_table(square)[1:, :-1]), abs=1e-12)
    assert mass_map(level) @ nodes == pytest.approx(masses, abs=1e-12)
    assert mass_gradient(gradient) @ masses == pytest.approx(gradient @ nodes, abs=1e-10)
    gram = mass_map(level).T @ mass_map(level)
    assert mass_gram(gram) == pytest.approx(np.eye(size), abs=1e-10)


@settings(deadline=None, max_examples=25)
@given(seed=SEED, level=st.integers(2, 10), noise=st.sampled_from([0.0, 0.3, 30.0]))
def test_interior_point_agrees_with_lawson_and_hanson(seed, level, noise):
    rng = np.random.default_rng(seed)
    walls = np.arange(level + 1.0)
    fan = first_order_reversal_fan(walls)
    rows = everett_rows(fan, walls)
    masses = rng.uniform(0, 1, rows.shape[1]) * (rng.random(rows.shape[1]) < 0.5)
    outputs = rows @ node_values(masses) + noise * rng.normal(size=fan.size)
    found = nonnegative_masses(rows, outputs)
    dense = np.apply_along_axis(mass_gradient, 1, rows.toarray())
    ones = np.ones((fan.size, 1))
    _, norm = optimize.nnls(np.hstack([dense, ones, -ones]), outputs)
    residual = np.linalg.norm(dense @ found.masses + found.constant - outputs)
    assert found.masses.min() >= 0.0
    assert residual == pytest.approx(norm, rel=1e-5, abs=1e-5 * (1 + np.ptp(outputs)))
    assert found.slope > -1e-6
    assert found.slackness < 1e-4


def test_signed_masses_solve_the_normal_equations():
    rng = np.random.default_rng(3)
    walls = np.arange(7.0)
    v = rng.uniform(0, 6, 80)
    rows = everett_rows(v, walls)
    outputs = rng.normal(size=80)
    penalty = 0.1 * mass_map(6).T @ mass_map(6)
    masses, constant = signed_masses(rows, outputs, penalty)
    residual = outputs - constant - rows @ node_values(masses)
    assert abs(residual.sum()) < 1e-10
    assert mass_gradient(rows.T @ residual) == pytest.approx(0.1 * masses, abs=1e-10)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"kept: found shape \(1,\), need \(2,\)"):
        everett_rows([0.0, 1.0], [0.0, 1.0, 2.0], kept=[True])
    with pytest.raises(ValueError, match=r"v: found nan at index"):
        everett_rows([0.0, np.nan], [0.0, 1.0, 2.0])
