"""Bouc-Wen and the limiting loop against plain references written from their equations."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vo2_models.hysteresis.bouc_wen import BoucWen
from vo2_models.hysteresis.laws.bounded_plays import BoundedPlays, fit_bounded_plays
from vo2_models.hysteresis.limiting_loop import LimitingLoop


@pytest.mark.parametrize(
    ("sigma", "n"), [(0.5, 1.0), (0.9, 1.0), (1.4, 2.3), (20.0, 2.0), (12.0, 1.0), (5.0, 6.0), (10.0, 20.0)]
)
def test_bouc_wen_is_its_differential_equation(sigma, n):
    """The original form: dz = A du - beta |du| |z|^(n-1) z - gamma du |z|^n, with z = w and A = rho."""
    law = BoucWen(2.0, sigma, n, 3.0, [0.5, 0.2])
    memory = np.array([0.0, 0.1])
    path = np.r_[0.0, np.random.default_rng(11).uniform(-2.0, 2.0, 12)]
    w = 0.1
    beta, gamma = 2.0 * sigma, 2.0 * (1.0 - sigma)
    for before, now in pairwise(path):
        du = now - before

        def rate(_, z, du=du):
            return 2.0 * du - beta * abs(du) * np.abs(z) ** (n - 1) * z - gamma * du * np.abs(z) ** n

        w = solve_ivp(rate, (0, 1), [w], rtol=1e-11, atol=1e-12, max_step=0.002).y[0, -1]
        assert law.step(now, memory) == pytest.approx(3.0 * w + 0.5 + 0.2 * now, abs=2e-6)


@pytest.mark.parametrize(("sigma", "n"), [(0.7, 1.5), (20.0, 1.2), (50.0, 2.0), (50.0, 1.0), (8.0, 20.0)])
def test_bouc_wen_does_not_depend_on_the_sampling(sigma, n):
    law = BoucWen(3.0, sigma, n)
    turns = np.random.default_rng(11).uniform(-2.0, 2.0, 20)
    # and moves that end on the way to 0
    turns = np.concatenate([turns, turns[-1] + np.array([0.0, 0.02, 0.03, 0.01, 0.05])])
    count = turns.size - 1
    fine = np.interp(np.linspace(0, count, count * 137 + 1), np.arange(count + 1), turns)
    assert law.run(fine)[::137] == pytest.approx(law.run(turns), abs=2e-6)


def test_the_way_back_of_bouc_wen_is_a_tangent_for_n_2():
    """dw / d(rho u) = 1 + k^2 w^2 with k^2 = 2 sigma - 1, from w = -1 on."""
    k = np.sqrt(39.0)
    expected = -np.tan(np.arctan(k) - 0.15 * k) / k
    assert BoucWen(1.0, 20.0, 2.0).step(0.15, np.array([0.0, -1.0])) == pytest.approx(expected, abs=1e-7)


def plain_limiting_loop(path, beta, width, centre, gamma):
    """Insulating fraction g of de Almeida et al., (7) to (10), turn by turn; starts far in the cold."""
    outputs, delta, t_r, g_r, before, g = [], 1, None, None, -np.inf, 1.0
    for t in path:
        if t != before:
            now = 1 if t > before else -1
            if now != delta:
                delta, t_r, g_r = now, before, g
            proximity = 0.0
            if t_r is not None:
                t_pr = delta * width / 2 + centre - np.arctanh(2 * g_r - 1) / beta - t_r
                x = (t - t_r) / t_pr
                proximity = t_pr * 0.5 * (1 - np.sin(gamma * x)) * (1 + np.tanh(np.pi**2 - 2 * np.pi * x))
            g = 0.5 + 0.5 * np.tanh(beta * (delta * width / 2 + centre - (t + proximity)))
            before = t
        outputs.append(g)
    return np.array(outputs)


def test_limiting_loop_is_the_published_model():
    law = LimitingLoop(0.25, 68.6, 0.25, 61.4, 0.956, 1.0, 0.0)
    path = np.r_[30.0, np.random.default_rng(11).uniform(50.0, 80.0, 60)]
    assert law.run(path) == pytest.approx(plain_limiting_loop(path, 0.25, 7.2, 65.0, 0.956), abs=1e-9)


def test_limiting_loop_stays_inside_and_is_monotone():
    law = LimitingLoop(
        0.3, 68.0, 0.2, 60.0, 0.99
    )  # at 1 the slope at a turn is -3e-8 of the branch's, by the equation
    turns = np.random.default_rng(11).uniform(50.0, 80.0, 31)
    path = np.interp(np.linspace(0, 30, 1501), np.arange(31), turns)
    output, memory = [], law.initial_memory()
    for before, now in zip(np.r_[-np.inf, path[:-1]], path, strict=True):
        output.append(law.step(now, memory))
        if len(output) > 1 and now != before:
            # branches of two slopes cross far out, where a turn starts on the new branch at once
            assert (output[-1] - output[-2]) * np.sign(now - before) >= -1e-9
    assert min(output) >= 0.0 and max(output) <= 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BoucWen(0.0), r"rho: found 0.0, need a finite number above 0"),
        (lambda: BoucWen(1.0, 0.4), r"sigma: found 0.4, need at least 0.5"),
        (lambda: BoucWen(1.0, 0.5, 0.5), r"n: found 0.5, need at least 1"),
        (lambda: LimitingLoop(0.4, 60.0, 0.4, 68.0), r"falling_centre: found 68, need one below"),
        (lambda: LimitingLoop(0.4, 68.0, 0.4, 60.0, 1.5), r"gamma: found 1.5, need 0 to 1"),
        (lambda: LimitingLoop(-0.4, 68.0, 0.4, 60.0), r"rising_slope: found -0.4"),
    ],
)
def test_bad_parameters_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def relays_of_a_play(path, radius):
    """A play of inputs from 0 to 1 as the relays that it is the sum of: up at c + r, down at c - r, for r <= c <= 1 - r."""
    centre = radius + (1.0 - 2.0 * radius) * (np.arange(4000) + 0.5) / 4000
    up, outputs = np.zeros(centre.size, dtype=bool), []
    for z in path:
        up = (z >= centre + radius) | (up & (z > centre - radius))
        outputs.append(radius + (1.0 - 2.0 * radius) * np.mean(up))
    return np.array(outputs)


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_bounded_plays_are_sums_of_relays_within_the_ends(exponent):
    """(A.1) and (B.3): every relay begins down, as after a rest at the lower end."""
    law = BoundedPlays([2.0, 0.7], [0.05, 0.2], 20.0, 100.0, exponent, [0.5, 0.02])
    path = np.r_[20.0, np.random.default_rng(3).uniform(20.0, 100.0, 60), 100.0, 20.0]
    z = ((path - 20.0) / 80.0) ** exponent
    expected = 2.0 * relays_of_a_play(z, 0.05) + 0.7 * relays_of_a_play(z, 0.2) + 0.5 + 0.02 * path
    assert law.run(path) == pytest.approx(expected, abs=2e-3)
    assert law.run(np.r_[-300.0, path])[1:] == pytest.approx(law.run(path), abs=1e-12)
    assert law.settle(20.0, "upper") == pytest.approx(law.settle(20.0))


def test_few_turns_tell_the_loops_of_bounded_plays_everywhere():
    """Weights, exponent and memoryless part from five turns predict sixty others to a fraction of the noise."""
    truth = BoundedPlays([1.0, 0.5, 0.3], [0.0, 0.06, 0.15], 0.0, 150.0, 2.0, [0.0, 0.02])
    turns = np.array([0.0, 150.0, 0.0, 90.0, 40.0, 120.0, 0.0])
    u = np.interp(np.linspace(0, turns.size - 1, 1200), np.arange(turns.size), turns)
    clean = truth.run(u)
    noise = 2e-3 * np.ptp(clean)
    y = clean + noise * np.random.default_rng(5).normal(size=u.size)
    found = fit_bounded_plays(u, y, np.arange(u.size) // 40, np.ones(u.size, dtype=bool)).law
    assert found.exponent == 2.0
    fresh = np.r_[0.0, np.random.default_rng(6).uniform(0.0, 150.0, 60)]
    assert np.std(found.run(fresh) - truth.run(fresh)) < 0.5 * noise
    with pytest.raises(ValueError, match=r"measured: found 4 samples, need 10"):
        fit_bounded_plays(u, y, np.arange(u.size) // 40, np.arange(u.size) < 4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"radii": [0.1]}, "radii: found 1"),
        ({"radii": [-0.1, 0.2]}, "radii"),
        ({"high": 10.0}, "high: found 10, need one above low, 20"),
        ({"exponent": 0.0}, "exponent"),
    ],
)
def test_bounded_plays_that_cannot_be_are_refused(change, words):
    good = {"weights": [1.0, 2.0], "radii": [0.0, 0.1], "low": 20.0, "high": 100.0, "exponent": 1.0}
    with pytest.raises(ValueError, match=words):
        BoundedPlays(**(good | change))
