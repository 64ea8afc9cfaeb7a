"""Sparse Preisach densities: the bases, the optimum by another solver, the choice by what was held out, bad input."""

import clarabel
import numpy as np
import pytest
from scipy import sparse
from vo2_models.hysteresis.preisach import PreisachOperator, fit_sparse
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.hysteresis.preisach.sparse_fit import (
    BASES,
    _areas_seen,
    _split,
    choose_sparse,
    haar,
    transform,
)
from vo2_models.identification.excitation import damped_oscillation, random_levels

LEVEL = 16
WALLS = np.linspace(0.0, 1.0, LEVEL + 1)


def _densities():
    at = 0.5 * (WALLS[1:] + WALLS[:-1])
    alpha, beta = at[:, None], at[None, :]
    smooth = np.exp(-(((alpha - 0.65) / 0.2) ** 2) - ((beta - 0.35) / 0.2) ** 2)
    patches = 2.0 * ((alpha > 0.5) & (alpha < 0.8) & (beta < 0.4)) + 0.3
    return {"cosine": np.tril(smooth), "variation": np.tril(patches)}


DENSITIES = _densities()


@pytest.mark.parametrize("size", [1, 2, 7, 16])
def test_haar_is_orthonormal_at_any_size_and_blind_to_a_constant(size):
    matrix = haar(size)
    assert np.allclose(matrix @ matrix.T, np.eye(size), atol=1e-12)
    assert np.allclose(matrix @ np.ones(size), np.r_[np.sqrt(size), np.zeros(size - 1)], atol=1e-12)


@pytest.mark.parametrize("basis", sorted(BASES))
def test_a_constant_density_costs_nothing_and_nothing_is_lost(basis):
    psi, weight = transform(basis, 9)
    flat = np.ones(45)
    assert np.abs(weight * (psi @ flat)).max() < 1e-12
    # differences alone are blind to the levels below the diagonal and on it
    assert np.linalg.matrix_rank(psi) == (43 if basis == "variation" else 45)


def test_the_matrix_of_areas_is_that_of_the_dense_way():
    v = random_levels(-0.1, 1.1, 50, seed=3)
    used = np.arange(v.size) % 3 > 0
    assert np.allclose(_areas_seen(v, WALLS, used), signed_area_matrix(v, WALLS)[used][:, :-1], atol=1e-12)


def _objective(gram, wanted, psi, limit, x):
    return 0.5 * x @ gram @ x - wanted @ x + limit @ np.abs(psi @ x)


@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize("basis", sorted(BASES))
def test_the_optimum_is_that_of_an_interior_point_solver(basis, nonnegative):
    """The same quadratic programme by Clarabel, with t >= |psi x| as unknowns of their own."""
    level = 7
    psi, weight = transform(basis, level)
    rng = np.random.default_rng(5)
    matrix = rng.normal(size=(20, psi.shape[1]))  # fewer samples than cells
    gram = matrix.T @ matrix / 20
    wanted = matrix.T @ rng.normal(size=20) / 20
    limit = 0.05 * weight
    found = _split(gram, wanted, psi, limit[:, None], nonnegative)[:, 0]
    n, m = psi.shape[1], psi.shape[0]
    above = [np.hstack([psi, -np.eye(m)]), np.hstack([-psi, -np.eye(m)])]
    if nonnegative:
        above.append(np.hstack([-np.eye(n), np.zeros((n, m))]))
    inequality = np.vstack(above)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    hessian = np.zeros((n + m, n + m))
    hessian[:n, :n] = gram
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(hessian)), np.r_[-wanted, limit], sparse.csc_matrix(inequality),
        np.zeros(inequality.shape[0]), [clarabel.NonnegativeConeT(inequality.shape[0])], settings,
    ).solve()  # fmt: skip
    best = _objective(gram, wanted, psi, limit, np.array(solution.x)[:n])
    assert best < 0.0
    assert _objective(gram, wanted, psi, limit, found) - best < 1e-3 * abs(best)
    assert not nonnegative or found.min() >= 0.0


@pytest.mark.parametrize("name", sorted(DENSITIES))
def test_fewer_outputs_than_cells_and_the_right_basis_is_chosen(name):
    truth = PreisachOperator(WALLS, DENSITIES[name], 1.0)
    v = damped_oscillation(WALLS)
    rng = np.random.default_rng(2)
    y = truth(v) + 1e-3 * np.ptp(truth(v)) * rng.normal(size=v.size)
    seen = rng.random(v.size) < 0.5
    found = fit_sparse(v, np.where(seen, y, 0.0), WALLS, measured=seen)
    assert found.basis == name and found.error == min(found.held_out_rmse.values())
    assert found.held_out_rmse["haar"] > 1.2 * found.error
    probe = random_levels(0.0, 1.0, 200, seed=4)
    error = np.sqrt(np.mean((found.operator(probe) - truth(probe)) ** 2))
    assert error < 0.01 * np.ptp(truth(probe))
    assert found.residual.shape == (np.count_nonzero(seen),)


@pytest.mark.slow
def test_a_density_of_both_signs_is_found_where_it_is_needed():
    density = DENSITIES["cosine"] - 0.4 * DENSITIES["cosine"].T[::-1, ::-1].T
    truth = PreisachOperator(WALLS, np.tril(density), 0.0)
    v = np.interp(
        np.arange(0, 40, 0.05),
        np.arange(41),
        np.r_[0.0, np.tile([1.0, 0.0], 3), random_levels(0, 1, 34, seed=1)],
    )
    found = choose_sparse(v, truth(v), np.arange(v.size) // 20, np.ones(v.size, dtype=np.bool_))
    assert not found.nonnegative and found.operator.density.min() < 0.0
    assert found.error < 0.02 * np.ptp(truth(v))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bases": ("fourier",)}, r"basis: found 'fourier', need one of cosine, haar, variation"),
        ({"strengths": (0.0,)}, r"strengths, bases: found \[0.0\]"),
        ({"measured": np.ones(3)}, r"measured: found shape \(3,\), need \(137,\)"),
        ({"groups": np.zeros(137)}, r"groups: found 1 part\(s\) of the samples used, need at least 2"),
        ({"walls": np.linspace(0, 1, 3)}, r"walls: found level 2, need at least 3"),
    ],
)
def test_bad_input_is_named(change, message):
    v = damped_oscillation(WALLS)
    with pytest.raises(ValueError, match=message):
        fit_sparse(v, v, **{"walls": WALLS, **change})
