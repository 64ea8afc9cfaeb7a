"""Elements of local memory against their differential equations and the limiting-loop law."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vo2_models.hysteresis.limiting_loop import LimitingLoop
from vo2_models.identification.enrichment import LOCAL, EnrichmentBasis
from vo2_models.identification.local_memory import FadingLags, LimitingLoops, LocalMemory

ELEMENTS = LocalMemory((55.0, 61.0), (1.5, 4.0), (0.8, 1.9))


def path(seed, count=12):
    turns = np.r_[20.0, np.random.default_rng(seed).uniform(45.0, 72.0, count), 20.0]
    return np.interp(np.linspace(0.0, turns.size - 1.0, 1200), np.arange(turns.size), turns)


def plain(temperature, centre, half_width, scale):
    """Fraction by the differential equation, leg by leg."""
    s, out = 0.0, [0.0]
    for start, end in pairwise(temperature):
        up = end > start

        def slope(at, value, up=up):
            middle = centre + half_width if up else centre - half_width
            cdf = 1.0 / (1.0 + np.exp(-(at - middle) / scale))
            # f / (1 - F) of a logistic distribution is F / scale, and f / F is (1 - F) / scale
            return (1.0 - value) * cdf / scale if up else value * (1.0 - cdf) / scale

        s = float(solve_ivp(slope, (start, end), [s], rtol=1e-10, atol=1e-12).y[0, -1])
        out.append(s)
    return np.array(out)


def test_elements_are_duhems_equation():
    temperature = path(3)[:400]
    found = ELEMENTS.features(temperature)
    places = np.arange(ELEMENTS.size).reshape(2, 2, 2)
    for (i, j, k), place in np.ndenumerate(places):
        wanted = plain(temperature, ELEMENTS.centre[i], ELEMENTS.half_width[j], ELEMENTS.scale[k])
        assert found[:, place] == pytest.approx(wanted, abs=2e-4)


def test_limiting_loops_are_those_of_the_law():
    loops, temperature = LimitingLoops((58.0, 62.0), (2.0, 4.0), (1.1,)), path(4)
    found = loops.features(temperature)
    for place, (centre, half_width) in enumerate(product(loops.centre, loops.half_width)):
        law = LimitingLoop(0.5 / 1.1, centre + half_width, 0.5 / 1.1, centre - half_width)
        assert found[:, place] == pytest.approx(law.run(temperature), abs=3e-5)


def test_fading_lags_are_their_equation():
    lags, temperature = FadingLags((56.0, 60.0), (1.5, 3.0), (0.9,), reach=(0.8, 2.0)), path(6)[:400]
    found = lags.features(temperature)
    for place, (half_width, reach, centre) in enumerate(product(lags.half_width, lags.reach, lags.centre)):
        behind, wanted = 1.0, []
        for start, end in pairwise(np.r_[temperature[0], temperature]):
            towards, way = np.sign(end - start), reach * half_width
            if towards:
                after = solve_ivp(
                    lambda _, x, d=towards, w=way: d * (d - x) / w, (start, end), [behind], rtol=1e-9
                )
                behind = float(after.y[0, -1])
            wanted.append(1.0 / (1.0 + np.exp(-(end - half_width * behind - centre) / 0.9)))
        assert found[:, place] == pytest.approx(np.array(wanted), abs=2e-4)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "elements",
    [
        ELEMENTS,
        LimitingLoops((55.0, 61.0), (1.5, 4.0), (0.8, 1.9)),
        FadingLags((55.0, 61.0), (1.5, 4.0), (0.8, 1.9)),
    ],
)
def test_the_sum_is_that_of_the_features(elements, seed):
    temperature = np.r_[
        path(seed), np.full(5, 58.0), 400.0, -200.0, 58.0, 61.0
    ]  # standing still, and beyond all tables
    weights = np.random.default_rng(seed).standard_normal(elements.size)
    features = elements.features(temperature)
    assert np.min(features) >= 0.0
    assert np.max(features) <= 1.0
    assert elements.total(temperature, weights) == pytest.approx(features @ weights, abs=1e-9)


def test_small_loops_wander_and_come_to_rest():
    """The same small loop again and again: no Preisach operator would move after the first."""
    once = np.r_[np.linspace(60.0, 57.0, 30), np.linspace(57.0, 60.0, 30)]
    fraction = LocalMemory((58.0,), (2.0,), (1.0,)).features(np.r_[20.0, np.tile(once, 40)])[:, 0]
    ends = fraction[60::60]
    assert ends[1] - ends[0] > 1e-3
    assert abs(ends[-1] - ends[-2]) < 1e-4


def test_a_correction_with_local_memory_is_its_features():
    basis, temperature = EnrichmentBasis(local=LOCAL), path(5)
    weights = np.random.default_rng(5).standard_normal(basis.columns)
    weights[basis.groups["memoryless"]] = 0.0  # interpolated in `fold`
    features = basis.features(temperature, span=3.0)
    assert basis.fold(weights, span=3.0)(temperature) == pytest.approx(features @ weights, abs=1e-9)
    assert features.shape[1] == EnrichmentBasis().columns + 56 + 21 + 42
