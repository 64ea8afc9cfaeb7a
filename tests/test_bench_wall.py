"""`./vo2 bench --wall`: both loops run in wall time and are counted by their own clock."""

import pytest
from vo2_studies.bench.wall_loops import main, measure


def test_a_length_that_is_none_is_refused(capsys):
    assert main(["--seconds", "0"]) == 2
    assert "--seconds: found 0" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one process", "three processes"])
def test_a_loop_is_closed_and_most_periods_are_answered(model_file, name):
    result = measure(name, 2.0, model_file.parent, real_time=True)
    assert result.periods >= 2.0 * result.rate_hz
    # a busy machine may miss many; a loop that is not closed misses all
    assert result.missed_share < 0.5
    assert 0.0 < result.latency_p50_ms <= result.latency_p99_ms <= result.latency_p999_ms
    assert result.latency_p50_ms < 2e3 / result.rate_hz
