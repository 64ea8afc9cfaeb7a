"""Structured singular values against cases with a known answer and against brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_control.generalised_plant import RobustDesign, generalised_plant
from vo2_control.hinf import PUBLISHED_CONTROLLER, synthesise
from vo2_control.mu import mu_sweep, structured_singular_value


def random_matrices(seed, count=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3, 5)) + 1j * rng.normal(size=(count, 3, 5))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_bounds_bracket_and_meet(seed):
    m = random_matrices(seed)
    upper, lower, _ = structured_singular_value(m)
    assert np.all(lower <= upper * (1 + 1e-9))
    assert np.all(lower >= 0.99 * upper)  # exact for two blocks
    assert np.all(upper <= np.linalg.norm(m, 2, axis=(1, 2)) * (1 + 1e-9))
    assert np.all(upper >= np.abs(m[:, 0, 0]) * (1 - 1e-9))


def test_no_random_perturbation_beats_the_upper_bound_and_one_attains_the_lower():
    """mu = 1 / the norm of the smallest structured Delta that makes I - M Delta singular."""
    m = random_matrices(5, 1)
    upper, lower, _ = structured_singular_value(m)
    rng = np.random.default_rng(0)
    radius = 0.0
    for _ in range(4000):
        block = np.outer(*(rng.normal(size=(n, 2)) @ [1, 1j] for n in (4, 2)))
        delta = np.zeros((5, 3), complex)
        delta[0, 0] = np.exp(2j * np.pi * rng.random())
        delta[1:, 1:] = block / np.linalg.norm(block, 2)
        radius = max(radius, np.abs(np.linalg.eigvals(m[0] @ delta)).max())
    assert radius <= upper[0] * (1 + 1e-9)
    assert radius > 0.7 * lower[0]


def test_known_cases():
    diagonal = np.zeros((1, 3, 5), complex)
    diagonal[0, 0, 0], diagonal[0, 1, 1] = 3j, 2.0
    np.testing.assert_allclose(structured_singular_value(diagonal)[0], 3.0, rtol=1e-6)
    # off-diagonal only: mu is the geometric mean, whatever the scaling of the channels
    cross = np.zeros((1, 3, 5), complex)
    cross[0, 0, 1], cross[0, 1, 0] = 100.0, 0.04
    upper, lower, _ = structured_singular_value(cross)
    np.testing.assert_allclose([upper[0], lower[0]], 2.0, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "stability", "performance"), [("optimal", 0.249, 0.305), ("printed", 0.253, 0.336)]
)
def test_published_structured_singular_values_within_ten_per_cent(name, stability, performance):
    design = RobustDesign()
    controller = synthesise(design).controller if name == "optimal" else PUBLISHED_CONTROLLER
    sweep = mu_sweep(generalised_plant(design), controller)
    assert sweep.robust_stability.max() == pytest.approx(0.26, rel=0.1)
    assert sweep.upper.max() == pytest.approx(0.32, rel=0.1)
    assert sweep.robust_stability.max() == pytest.approx(stability, rel=0.01)
    assert sweep.upper.max() == pytest.approx(performance, rel=0.01)
    assert np.all(sweep.lower <= sweep.upper * (1 + 1e-9)) and sweep.lower.max() > 0.99 * sweep.upper.max()
