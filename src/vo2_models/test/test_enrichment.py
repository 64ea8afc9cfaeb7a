"""The correction of the loop shape against relays, plays and splines written out one at a time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from vo2_models.identification.digest import digest_of_drive
from vo2_models.identification.enrichment import (
    DEEPEST,
    LOCAL,
    EnrichmentBasis,
    cubic_spline,
    everett_table,
    preisach_features,
)
from vo2_models.identification.rough import cell_features, cell_sum

KNOTS = (np.arange(50.0, 60.0, 2.0), np.arange(0.0, 4.0, 1.0))
WALLS = np.arange(44.0, 66.1, 0.5)


def walk(size: int, *, seed: int = 1) -> np.ndarray:
    """Temperatures (n,) [degC] that turn often, with stretches at rest."""
    rng = np.random.default_rng(seed)
    path = 55.0 + np.cumsum(rng.choice([-1.0, 0.0, 1.0], size) * rng.exponential(1.2, size))
    return 45.0 + np.abs((path - 45.0) % 40.0 - 20.0)


def relays(path: np.ndarray, centre: np.ndarray, half_width: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Output of every density: relays in the middle of the cells, each switched on or off by itself."""
    step = walls[1] - walls[0]
    mid = 0.5 * (walls[1:] + walls[:-1])
    out = np.zeros((path.size, centre.size * half_width.size))
    for i, alpha in enumerate(mid):
        for beta in mid[: i + 1]:
            c, r = 0.5 * (alpha + beta), 0.5 * (alpha - beta)
            share = np.outer(cubic_spline(centre, np.array(c)), cubic_spline(half_width, np.array(r))).ravel()
            area = step**2 * (0.5 if alpha == beta else 1.0)
            on = False
            for k, temperature in enumerate(path):
                on = temperature > alpha if temperature > alpha or temperature < beta else on
                out[k] += on * area * share
    return out


def test_a_spline_is_the_uniform_cubic_b_spline() -> None:
    x = np.linspace(48.0, 62.0, 300)
    for knot, column in zip(KNOTS[0], cubic_spline(KNOTS[0], x).T, strict=True):
        element = BSpline.basis_element(knot + 2.0 * np.arange(-2.0, 3.0), extrapolate=False)
        assert np.allclose(column, np.nan_to_num(element(x)), atol=1e-14)


def test_densities_are_sums_over_relays() -> None:
    path = np.round(walk(60) * 2.0) / 2.0  # on the walls, where a relay's state is not shared
    found = preisach_features(path, WALLS, everett_table(*KNOTS, WALLS))
    assert np.ptp(np.sign(np.diff(path))) == 2.0
    assert np.allclose(found, relays(path, *KNOTS, WALLS), rtol=1e-11, atol=1e-11)


def test_a_temperature_between_walls_is_interpolated() -> None:
    table = everett_table(*KNOTS, WALLS)
    low, high = (preisach_features([t], WALLS, table) for t in (56.0, 56.5))
    assert np.allclose(preisach_features([56.2], WALLS, table), 0.6 * low + 0.4 * high, rtol=1e-12)


def test_more_nested_loops_than_are_remembered_are_no_error() -> None:
    shrinking = 55.0 + 8.0 * np.linspace(1.0, 0.0, 3 * DEEPEST) * (-1.0) ** np.arange(3 * DEEPEST)
    table = everett_table(*KNOTS, WALLS)
    back = preisach_features([*shrinking, 65.0], WALLS, table)[-1]
    assert np.allclose(back, preisach_features([65.0], WALLS, table)[-1], rtol=1e-12)


def plays(path: np.ndarray, low: float, step: float, shape: tuple[int, int]) -> np.ndarray:
    """On-fractions (n, rows, widths) of the cells, each a play with a ramp of its own."""
    out = np.zeros((path.size, *shape))
    for i in range(shape[0]):
        for j in range(shape[1]):
            alpha = low + i * step
            beta = alpha - (1 + j) * step
            p = 0.0
            for k, temperature in enumerate(path):
                p = max(p, np.clip((temperature - alpha) / step, 0.0, 1.0))
                p = min(p, np.clip((temperature - beta) / step, 0.0, 1.0))
                out[k, i, j] = p
    return out


@pytest.mark.parametrize("seed", [1, 2])
def test_cells_are_plays_with_a_ramp(seed) -> None:
    path, shape = walk(150, seed=seed), (9, 5)
    expected = plays(path, 52.0, 1.5, shape)
    chosen = np.array([0, 7, 23, 44])
    found = cell_features(path, low=52.0, step=1.5, shape=shape, chosen=chosen)
    assert np.allclose(found, expected.reshape(path.size, -1)[:, chosen], atol=1e-12)
    weights = np.random.default_rng(seed).normal(size=shape)
    total = cell_sum(path, low=52.0, step=1.5, weights=weights)
    assert np.allclose(total, np.tensordot(expected, weights, axes=2), atol=1e-11)


def test_columns_are_the_terms_at_their_prior_size() -> None:
    basis, path, span = EnrichmentBasis(), 60.0 + 2.0 * (walk(700, seed=3) - 55.0), 3.0
    columns = basis.features(path, span=span)
    assert columns.shape == (path.size, basis.columns)
    low, high = basis.centre_degc
    walls = np.arange(low - basis.half_width_k, high + basis.half_width_k + 0.25, basis.grid_k)
    fine = np.arange(low, high + 0.75, 1.5), np.arange(0.0, 8.5, 1.0)
    coarse = np.arange(low, high + 2.0, 4.0), np.arange(0.5, 8.0, 2.0)
    density = preisach_features(path, walls, everett_table(*fine, walls))
    crowd = preisach_features(path, walls, everett_table(*coarse, walls))
    warmth = (path - 0.5 * (low + high)) / (0.5 * (high - low))
    found = {name: columns[:, own] for name, own in basis.groups.items()}
    assert np.allclose(found["density"], span * 0.02 * density, rtol=1e-12)
    assert np.allclose(found["contrast"], span * 0.005 * warmth[:, None] * crowd, rtol=1e-12)
    ratio = found["mixing"] / np.where(np.abs(crowd) > 1e-9, crowd, np.nan)
    x = np.nanmedian(ratio, axis=1) / (span * 0.01)
    assert np.nanmax(np.abs(ratio - np.nanmedian(ratio, axis=1)[:, None])) < 1e-9
    assert np.nanmin(x) >= 0.0 and 0.9 < np.nanmax(x) <= 1.0  # the fraction of a typical device
    knots = np.arange(16.0, 106.0, 4.0)
    assert np.allclose(found["memoryless"], span * 0.3 * cubic_spline(knots, path), rtol=1e-12)
    # a share p of N domains scatters by sqrt(p / N)
    shape, chosen, share, lowest = basis._cells()
    assert 0.98 < share.sum() <= 1.0
    cells = cell_features(path, low=lowest, step=1.0, shape=shape, chosen=chosen)
    assert np.allclose(found["scatter"], span * np.sqrt(share / 4000.0) * cells, rtol=1e-12)


@pytest.mark.parametrize("half_width", [(0.2, 0.06), (1e-3, 1e-4)])
def test_a_loop_narrower_than_a_cell_has_columns(half_width) -> None:
    basis = EnrichmentBasis(typical_half_width=half_width)
    columns = basis.features(walk(300, seed=5), span=1.0)
    assert columns.shape == (300, basis.columns)
    assert np.all(np.isfinite(columns))
    assert np.ptp(columns[:, basis.groups["scatter"]]) > 0.0


def test_a_folded_correction_is_the_weighted_sum_of_its_columns() -> None:
    basis, path = EnrichmentBasis(), walk(700, seed=4)
    weights = np.random.default_rng(5).normal(size=basis.columns)
    whole = basis.features(path, span=2.0) @ weights
    # the memoryless part is read from a table
    assert np.allclose(basis.fold(weights, span=2.0)(path), whole, atol=2e-4 * np.ptp(whole))
    weights[basis.groups["memoryless"]] = 0.0
    whole = basis.features(path, span=2.0) @ weights
    assert np.allclose(basis.fold(weights, span=2.0)(path), whole, rtol=1e-9, atol=1e-12)


def test_a_basis_over_another_range_is_the_same_there() -> None:
    """Stretched by 2 and moved: at stretched temperatures the columns are what they were, and as many."""
    basis = EnrichmentBasis(temperature_degc=(40.0, 80.0), domains=1e3, local=LOCAL)
    places = basis.typical_centre[0], basis.typical_half_width[0]
    stretched = replace(
        basis,
        temperature_degc=(80.0, 160.0),
        typical_centre=(2.0 * places[0], 2.0 * basis.typical_centre[1]),
        typical_half_width=(2.0 * places[1], 2.0 * basis.typical_half_width[1]),
    ).over(92.0, 152.0)
    path = np.concatenate([[30.0], walk(300)])
    before, after = basis.features(path, span=3.0), stretched.features(2.0 * path, span=3.0)
    # cells begin at whole degrees, and are as many as fit: all else is the same
    for name in basis.groups.keys() - {"scatter"}:
        old, new = before[:, basis.groups[name]], after[:, stretched.groups[name]]
        assert np.max(np.abs(new - old)) < 1e-9 * np.max(np.abs(old)), name


def test_residuals_along_a_drive_are_means_between_its_turns() -> None:
    """Two recordings, one behind the other; small turns are passed over, the way between the recordings is none of them."""
    first = np.concatenate([np.linspace(30.0, 90.0, 200), np.linspace(90.0, 40.0, 150)[1:]])
    second = np.interp(np.arange(400), [0, 100, 250, 399], [60.0, 85.0, 35.0, 70.0])
    rng = np.random.default_rng(4)
    path = np.concatenate([[-300.0], first, [-300.0], second + 0.01 * rng.standard_normal(400)])
    residual = np.where(path > 0.0, 1e-3 * path, np.nan)
    digest = digest_of_drive(path, residual, np.zeros(path.size), starts=[0, first.size + 1], most=60)
    assert digest.count.size <= 64
    known = digest.count > 0.0
    middle = 0.5 * (digest.temperature[1:] + digest.temperature[:-1])
    assert np.max(np.abs(digest.log_resistance - 1e-3 * middle)[known]) < 2e-4, "means of a straight line"
    turns = (90.0, 40.0, 85.0, 35.0)
    assert all(np.min(np.abs(digest.temperature - turn)) < 0.5 for turn in turns), "turning points are ends"
    jumps = np.abs(np.diff(digest.temperature)) > 100.0
    assert np.count_nonzero(jumps) == 3 and not np.any(digest.count[jumps])
    # all samples but those beside a start, which count half or not at all
    assert path.size - 2 - digest.count.sum() < 4.0
    long = digest_of_drive(path, residual, np.zeros(path.size), starts=[0, first.size + 1])
    assert long.count.size > 300
