"""Entropy-optimal compression: published partitions, exhaustive search, and the compressed model itself."""

from decimal import Decimal, localcontext
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.hysteresis import CPI, GPI, TanhEnvelopes, compress, merge, partition
from vo2_models.hysteresis.compression_gpi import group_loss, scaling

J = np.arange(1, 31)
RADII = J / 31
ONE_PEAK = 5 / np.sqrt(2 * np.pi) * np.exp(-((J - 15) ** 2) / 15)
TWO_PEAKS = 5 / np.sqrt(2 * np.pi) * np.exp(-((J - np.where(J <= 16, 8, 23)) ** 2) / 8)


def exhaustive(radii, weights, groups, largest):
    """The least criterion over all partitions, from the equation."""
    n = len(radii)
    loss = {(a, b): group_loss(radii[a:b], weights[a:b]) for a in range(n) for b in range(a + 1, n + 1)}
    combine = max if largest else sum
    return min(
        combine(loss[pair] for pair in zip((0, *inner), (*inner, n), strict=True))
        for inner in combinations(range(1, n), groups - 1)
    )


def value_of(radii, weights, cuts, largest):
    losses = [group_loss(radii[a:b], weights[a:b]) for a, b in pairwise(cuts)]
    return max(losses) if largest else sum(losses)


def test_published_uniform_case():
    """Table 3.2."""
    for criterion in ("sum", "max"):
        cuts = partition(RADII, np.full(30, 0.5), 6, criterion=criterion).cuts
        assert cuts.tolist() == [0, 5, 10, 15, 20, 25, 30]


def test_published_one_peak_case():
    """Table 3.3."""
    assert partition(RADII, ONE_PEAK, 6).cuts.tolist() == [0, 11, 13, 14, 16, 18, 30]
    assert partition(RADII, ONE_PEAK, 6, criterion="max").cuts.tolist() == [0, 9, 12, 14, 16, 18, 30]


@pytest.mark.parametrize("weights", [ONE_PEAK, TWO_PEAKS])
@pytest.mark.parametrize("criterion", ["sum", "max"])
def test_optimal_among_all_partitions_of_30(weights, criterion):
    """118 755 partitions of 30 plays into 6 groups: none is better."""
    largest = criterion == "max"
    found = partition(RADII, weights, 6, criterion=criterion)
    assert found.loss == pytest.approx(value_of(RADII, weights, found.cuts, largest), rel=1e-9)
    assert found.loss == pytest.approx(exhaustive(RADII, weights, 6, largest), rel=1e-9)


@pytest.mark.parametrize(
    ("criterion", "published", "ours", "theirs"),
    [
        ("sum", (0, 7, 8, 14, 22, 23, 30), 0.29094, 0.32471),
        ("max", (0, 6, 8, 11, 21, 23, 30), 0.08131, 0.14718),
    ],
)
def test_published_two_peak_partitions_lose_more_than_the_optimum(criterion, published, ours, theirs):
    """Table 3.4: under the stated objective, which the exhaustive search above minimises too, ours is better."""
    largest = criterion == "max"
    found = partition(RADII, TWO_PEAKS, 6, criterion=criterion)
    assert value_of(RADII, TWO_PEAKS, found.cuts, largest) == pytest.approx(ours, abs=1e-5)
    assert value_of(RADII, TWO_PEAKS, published, largest) == pytest.approx(theirs, abs=1e-5)


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.data())
@settings(max_examples=60, deadline=None)
def test_optimal_on_random_distributions(seed, n, data):
    rng = np.random.default_rng(seed)
    radii = np.cumsum(rng.uniform(1e-3, 1, n))
    weights = rng.exponential(1, n) * 10.0 ** rng.uniform(-6, 3, n) * (rng.random(n) < 0.8)
    groups = data.draw(st.integers(1, n))
    for criterion in ("sum", "max"):
        largest = criterion == "max"
        found = partition(radii, weights, groups, criterion=criterion)
        best = exhaustive(radii, weights, groups, largest)
        assert found.cuts[0] == 0
        assert found.cuts[-1] == n
        assert np.all(np.diff(found.cuts) > 0)
        assert value_of(radii, weights, found.cuts, largest) == pytest.approx(best, rel=1e-9, abs=1e-60)


def exact_loss(radii, weights):
    """The loss of a group in fifty digits."""
    with localcontext() as context:
        context.prec = 50
        r, p = ([Decimal(float(x)) for x in values] for values in (radii, weights))
        total = sum(p)
        centre = sum(a * b for a, b in zip(p, r, strict=True)) / total
        spread = sum((a * (b - centre)) ** 2 for a, b in zip(p, r, strict=True)).sqrt()
        return float(spread * -sum(a / total * (a / total).ln() for a in p if a > 0))


@given(st.integers(0, 2**32 - 1), st.integers(2, 9))
@settings(max_examples=200, deadline=None)
def test_light_plays_beside_heavy_ones_keep_their_digits(seed, n):
    rng = np.random.default_rng(seed)
    radii = np.cumsum(rng.uniform(1e-3, 1, n))
    weights = rng.exponential(1, n) * 10.0 ** rng.uniform(-6, 3, n) * (rng.random(n) < 0.8)
    weights[rng.integers(n)] += 1e-3
    exact = pytest.approx(exact_loss(radii, weights), rel=1e-11, abs=1e-60)
    assert partition(radii, weights, 1).loss == exact
    assert group_loss(radii, weights) == exact


@pytest.mark.parametrize("criterion", ["sum", "max"])
def test_as_many_groups_as_plays_that_weigh_lose_nothing(criterion):
    radii, weights = np.arange(7.0), [0.0, 8e-5, 1e-6, 900.0, 0.0, 2e-4, 0.0]
    found = partition(radii, weights, 4, criterion=criterion)
    assert found.loss == 0.0
    assert value_of(radii, np.array(weights), found.cuts, criterion == "max") == 0.0


@pytest.mark.parametrize("exponent", [-700, 700])
def test_the_unit_of_the_weights_changes_no_digit(exponent):
    weights = np.random.default_rng(3).exponential(1, 12)
    plain = partition(np.arange(12.0), weights, 4)
    other = partition(np.arange(12.0), np.ldexp(weights, exponent), 4)
    assert other.cuts.tolist() == plain.cuts.tolist()
    assert other.loss == np.ldexp(plain.loss, exponent) > 0.0


def test_scaling_is_half_the_range_of_the_play():
    model = GPI([0.0, 0.3, 0.6], [1.0, 1.0, 1.0], TanhEnvelopes(1.2, -0.3, 1.2, 0.3))
    low, high = -2.0, 2.0
    _, bottom = model.simulate([low], model.initial_state("upper"))
    _, top = model.simulate([high], bottom)
    np.testing.assert_allclose(scaling(model, model.radii, (low, high)), (top - bottom)[1:] / 2, atol=1e-12)


@pytest.mark.parametrize("scaled", [True, False])
def test_a_compressed_model_follows_the_original(scaled):
    """Better than uniform groups on the one-peak case, as Table 3.3 has it, and exact for as many plays as there are."""
    span = (-1.0, 1.0)
    envelopes = TanhEnvelopes(2.5, -0.5, 2.5, 0.5)
    reach = scaling(GPI(RADII, np.ones(30), envelopes), RADII, span)
    model = GPI(RADII, np.divide(ONE_PEAK, reach, where=reach > 0, out=np.zeros(30)), envelopes, 0.2, span)
    v = np.sin(np.linspace(0, 60, 4000)) * np.linspace(1, 0.05, 4000)
    start = "upper"
    output, _ = model.simulate(v, model.initial_state(start, v=-1.0))

    def error(other):
        given, _ = other.simulate(v, other.initial_state(start, v=-1.0))
        return np.sqrt(np.mean((given - output) ** 2)) / np.ptp(output)

    small = compress(model, 6, scaled=scaled)
    assert small.model.plays == 6
    uniform_weights = ONE_PEAK.reshape(6, 5)
    uniform_radii = (uniform_weights * RADII.reshape(6, 5)).sum(1) / uniform_weights.sum(1)
    uniform_reach = scaling(model, uniform_radii, span)
    uniform = GPI(
        uniform_radii,
        np.divide(uniform_weights.sum(1), uniform_reach, where=uniform_reach > 0, out=np.zeros(6)),
        envelopes,
        small.model.bias,
        span,
    )
    assert error(small.model) < 0.5 * error(uniform)
    assert error(small.model) < 0.005
    assert error(compress(model, 30, scaled=scaled).model) < 1e-12


@pytest.mark.parametrize("scaled", [True, False])
def test_merging_by_the_optimal_cuts_is_compressing(scaled):
    model = GPI(RADII, ONE_PEAK, TanhEnvelopes(4.5, -0.8, 4.0, 0.6), 0.2, (-1.0, 1.0))
    small = compress(model, 6, scaled=scaled)
    same = merge(model, small.cuts, scaled=scaled)
    for name in ("radii", "weights", "bias"):
        np.testing.assert_array_equal(getattr(same, name), getattr(small.model, name))
    np.testing.assert_allclose(merge(model, np.arange(31), scaled=scaled).weights, model.weights, rtol=1e-12)


@pytest.mark.parametrize("cuts", [[0, 10, 29], [1, 30], [0, 20, 10, 30], [30], [0, np.nan, 30]])
def test_merging_refuses_cuts_that_are_no_partition(cuts):
    with pytest.raises(ValueError, match="cuts"):
        merge(GPI(RADII, ONE_PEAK, TanhEnvelopes(4.5, -0.8, 4.0, 0.6), 0.2, (-1.0, 1.0)), cuts)


def test_one_group_is_the_weighted_mean():
    model = CPI([0.0, 1.0, 2.0], [1.0, 1.0, 2.0])
    one = compress(model, 1, scaled=False).model
    assert one.radii.tolist() == [1.25]
    assert one.weights.tolist() == [4.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: partition([0.1, 0.2], [1, 1], 3), r"groups: found 3, need a whole number from 1 to 2"),
        (lambda: partition([0.1, 0.2], [1, -1], 1), r"weights: found -1 at index 1"),
        (lambda: partition([0.2, 0.1], [1, 1], 1), r"radii: found 0.1 after 0.2"),
        (lambda: partition([0.1, 0.2], [1, 1], 1, criterion="mean"), r"criterion: found 'mean'"),
        (lambda: compress(CPI([0.1], [1.0]), 1), r"input_range: found none"),
        (
            lambda: compress(GPI([0.1], [1.0], TanhEnvelopes([1], [0], [1], [0])), 1, input_range=(0, 1)),
            r"model: found one envelope pair per play",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
