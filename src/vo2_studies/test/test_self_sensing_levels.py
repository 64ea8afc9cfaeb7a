"""The comparison over levels behind Fig. 7.9, at its smallest."""

import numpy as np
from vo2_models.self_sensing.direct_preisach import walls_of
from vo2_studies.self_sensing.level_study import SCHEMES, level_errors


def test_level_errors_order_the_schemes_and_take_time():
    found = level_errors(4, 6, walls=14, count=60)
    assert tuple(found) == SCHEMES
    error = {kind: one.random_m for kind, one in found.items()}
    assert 1e-9 < error["composite"] < error["polynomial"] < 3e-6
    for one in found.values():
        assert 0.0 < one.time_s < 1e-3 and 1e-9 < one.mean_m < one.largest_m < 2e-5
    assert found["composite"].mean_m < found["polynomial"].mean_m


def test_walls_are_fine_where_the_resistance_dwells_and_increase_even_where_samples_repeat():
    repeated = np.concatenate([np.full(500, 40.0), [30.0, 90.0]])
    walls = walls_of(repeated, 10)
    assert walls[0] == 30.0 and walls[-1] == 90.0
    assert np.all(np.diff(walls) > 0)
    assert np.ptp(walls[1:-1]) < 0.6 * np.ptp(np.linspace(30.0, 90.0, 11)[1:-1])


def test_preisach_of_level_ten_beats_the_polynomial_on_a_loop_narrow_against_the_resistance():
    """Uniform cells would be wider than the loop: with them the two are equally wrong."""
    found = level_errors(4, 10, walls=20, count=100)
    assert found["composite"].random_m < found["preisach"].random_m < 0.6 * found["polynomial"].random_m
