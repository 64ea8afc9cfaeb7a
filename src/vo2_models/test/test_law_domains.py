"""The interacting domains against the definition: relays that see each other, switched one at a time."""

import numpy as np
import pytest
from vo2_models.device.ensemble import ensemble_step, sort_population
from vo2_models.hysteresis.domains import DomainEnsemble
from vo2_models.hysteresis.preisach import PreisachOperator


def one_at_a_time(alpha, beta, shares, coupling, inputs):
    """Sweep the input in small steps; at each, switch the domain that is farthest beyond its threshold until none is."""
    up = np.zeros(alpha.size, dtype=bool)
    outputs = []
    before = -100.0
    for target in inputs:
        for u in np.linspace(before, target, 2000):
            while True:
                field = u + coupling * (shares[up].sum() - 0.5)
                rising = u >= before
                beyond = np.where(up, beta - field, field - alpha)
                beyond[up if rising else ~up] = -np.inf
                worst = int(np.argmax(beyond))
                if beyond[worst] < 0:
                    break
                up[worst] = rising
        before = target
        outputs.append(shares[up].sum())
    return outputs


@pytest.mark.parametrize("coupling", [0.0, 3.0, -2.0])
def test_the_law_is_its_definition(coupling):
    rng = np.random.default_rng(3)
    alpha = rng.normal(5.0, 2.0, 25)
    beta = alpha - rng.uniform(3.0, 5.0, 25)
    shares = rng.uniform(0.5, 1.5, 25)
    shares /= shares.sum()
    inputs = np.r_[12.0, -8.0, rng.uniform(-2.0, 9.0, 25)]
    law = DomainEnsemble(alpha, beta, shares, coupling)
    assert law.run(inputs) == pytest.approx(one_at_a_time(alpha, beta, shares, coupling, inputs), abs=1e-12)


def test_without_coupling_it_is_the_device_ensemble():
    rng = np.random.default_rng(4)
    alpha = rng.normal(65.0, 4.0, 300)
    beta = alpha - rng.uniform(1.0, 8.0, 300)
    law = DomainEnsemble(alpha, beta)
    levels, domains = (part[None] for part in sort_population(alpha, beta))
    metallic, count, previous = np.zeros((1, 300), np.uint8), 0, -1e6
    memory = law.initial_memory()
    for t in rng.uniform(50.0, 80.0, 300):
        count = ensemble_step(t, previous, 0, levels, domains, metallic, count)
        previous = t
        assert law.step(t, memory) == pytest.approx(count / 300, abs=1e-12)


def test_many_domains_are_a_preisach_operator():
    walls = np.linspace(0.0, 1.0, 5)
    operator = PreisachOperator(walls, np.full(10, 1.0))
    edges = (np.arange(200) + 0.5) / 200
    alpha, beta = (grid.ravel() for grid in np.meshgrid(edges, edges, indexing="ij"))
    keep = alpha > beta
    low, high = operator.output_range
    law = DomainEnsemble(alpha[keep], beta[keep], None, 0.0, low, high)
    inputs = np.random.default_rng(5).uniform(0.0, 1.0, 60)
    assert law.run(inputs) == pytest.approx(operator(inputs), abs=0.02 * (high - low))


def test_strong_coupling_switches_in_one_avalanche():
    alpha = np.linspace(1.0, 2.0, 50)
    law = DomainEnsemble(alpha, alpha - 4.0, None, 4.0)
    assert law.run([2.99, 3.01]).tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, 2.0], [0.0, 2.5]), r"beta: found 2.5 for alpha 2 at index 1, need beta below alpha"),
        (([], []), r"alpha: found none"),
        (([1.0], [0.0], [-1.0]), r"shares: found -1 at index 0"),
        (([1.0], [0.0], [0.0]), r"shares: found only zeros"),
        (([1.0], [0.0], None, np.nan), r"coupling: found nan"),
    ],
)
def test_bad_ensembles_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        DomainEnsemble(*arguments)
