"""KL-optimal compression against complete enumeration written from the definitions (2.2) to (2.5)."""

from itertools import combinations
from math import comb
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.hysteresis.preisach.compression import _enumerate, compress, evaluate_partition
from vo2_models.hysteresis.preisach.grid import cell_areas
from vo2_studies.preisach.compression_study import PUBLISHED_MAX_ERROR, compression_study

UNKNOWN: Any = "l2"


def losses_by_definition(operator, partition):
    """H T of every cell, by summing p log(p / q) over the original cells in it."""
    area = cell_areas(operator.walls, operator.diagonal)
    found = []
    for i in range(len(partition) - 1):
        for j in range(i + 1):
            rows = range(partition[i], partition[i + 1])
            columns = range(partition[j], partition[j + 1])
            inside = [(a, b) for a in rows for b in columns if b <= a]
            total = sum(operator.density[k] * area[k] for k in inside)
            extent = sum(area[k] for k in inside)
            divergence = 0.0
            for k in inside:
                p = operator.density[k] / total if total > 0 else 0.0
                if p > 0:
                    divergence += p * np.log(p * extent) * area[k]
            found.append(divergence * total)
    return np.array(found)


def cost_by_definition(losses, criterion):
    if criterion == "max":
        return losses.max()
    total = losses.sum()
    if criterion == "sum" or total <= 0:
        return total
    share = losses[losses > 0] / total
    return total * np.sum(share * np.log(share * losses.size))


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    level=st.integers(2, 7),
    criterion=st.sampled_from(["kl", "sum", "max"]),
    diagonal=st.sampled_from(["triangle", "square"]),
)
def test_finds_the_best_of_all_partitions(seed, level, criterion, diagonal):
    rng = np.random.default_rng(seed)
    walls = np.cumsum(rng.uniform(0.2, 1.0, level + 1))
    density = rng.uniform(0, 5, level * (level + 1) // 2) * (rng.random(level * (level + 1) // 2) < 0.8)
    operator = PreisachOperator(walls, density, 0.3, diagonal)
    target = int(rng.integers(1, level + 1))
    choices = [(0, *inner, level) for inner in combinations(range(1, level), target - 1)]
    costs = [cost_by_definition(losses_by_definition(operator, choice), criterion) for choice in choices]
    found = compress(operator, target, criterion)
    scale = 1e-10 * operator.weights.sum()
    assert found.cost == pytest.approx(min(costs), abs=scale)
    assert (
        cost_by_definition(losses_by_definition(operator, found.partition), criterion) <= min(costs) + scale
    )
    assert found.losses[np.tril_indices(target)] == pytest.approx(
        losses_by_definition(operator, found.partition), abs=scale
    )
    # the mass of every cell is kept, so saturation and every history on the kept walls come out the same
    history = rng.choice(found.operator.walls, 40)
    assert found.operator(history) == pytest.approx(
        operator(history), abs=1e-10 * (1 + operator.weights.sum())
    )


def test_every_partition_is_compared_for_j_kl():
    table = np.ones((45, 45))
    _, _, compared = _enumerate(table, np.zeros_like(table), 9, 4, 0)
    assert compared == comb(8, 3)


def test_a_uniform_density_loses_nothing_and_one_level_keeps_only_saturation():
    operator = PreisachOperator(np.arange(9.0), np.full(36, 2.0), 1.0)
    for criterion in ("kl", "sum", "max"):
        assert compress(operator, 3, criterion).cost == pytest.approx(0.0, abs=1e-9)
    assert compress(operator, 1).operator.output_range == pytest.approx(operator.output_range)
    assert compress(operator, 8).partition.tolist() == list(range(9))


def test_walls_gather_where_the_density_varies():
    walls = np.linspace(30.0, 80.0, 41)
    middle = 0.5 * (walls[1:] + walls[:-1])
    bump = np.exp(-(((middle[:, None] - 58) / 4) ** 2) - ((middle[None, :] - 52) / 4) ** 2)
    operator = PreisachOperator(walls, np.tril(bump))
    uniform = evaluate_partition(operator, np.arange(0, 41, 10), "sum")
    for criterion in ("sum", "max"):
        found = compress(operator, 4, criterion)
        assert np.diff(found.partition).min() < 10
        assert found.cost <= evaluate_partition(operator, np.arange(0, 41, 10), criterion).cost
    assert compress(operator, 4, "sum").cost < 0.7 * uniform.cost


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: compress(PreisachOperator([0, 1, 2], np.ones(3)), 3),
            r"level: found 3, need a whole number from 1 to",
        ),
        (lambda: compress(PreisachOperator([0, 1, 2], [1, -1, 1]), 1), r"operator: found density -1"),
        (lambda: compress(PreisachOperator([0, 1, 2], np.ones(3)), 1, UNKNOWN), r"criterion: found 'l2'"),
        (
            lambda: evaluate_partition(PreisachOperator([0, 1, 2], np.ones(3)), np.array([0, 1])),
            r"partition: found \[0, 1\], need increasing indices from 0 to 2",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_section_2_4_in_simulation_j_kl_predicts_best_and_far_better_than_uniform():
    study = compression_study(densities=8)
    for errors, key in ((study.prediction, "prediction"), (study.inverse, "inverse")):
        assert errors["J_KL"] == min(errors.values())
        published = PUBLISHED_MAX_ERROR[key]["J_KL"] / PUBLISHED_MAX_ERROR[key]["uniform"]
        assert errors["J_KL"] / errors["uniform"] == pytest.approx(published, abs=0.15)
