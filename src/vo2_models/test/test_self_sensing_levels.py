"""The comparison over levels behind Fig. 7.9, at its smallest."""

from vo2_models.self_sensing.level_study import SCHEMES, level_errors


def test_level_errors_order_the_schemes_and_take_time():
    found = level_errors(4, 6, walls=14, count=60)
    assert tuple(found) == SCHEMES
    error = {kind: value for kind, (value, _) in found.items()}
    assert 1e-9 < error["composite"] < error["polynomial"] < 3e-6
    assert all(0.0 < duration < 1e-3 for _, duration in found.values())
