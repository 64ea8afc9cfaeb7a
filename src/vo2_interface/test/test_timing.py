"""What a wall-time loop misses is counted, from its settling on; percentiles come within a bin of the exact ones."""

import math

import numpy as np
import pytest
from vo2_interface.timing import LoopTiming

PERIOD = 1e-3
BIN = 10 * PERIOD / 4000


def test_nothing_counts_before_the_loop_is_closed_and_has_settled():
    timing = LoopTiming(PERIOD)
    timing.sample(1.0, 5, False)
    assert timing.periods == 0
    assert math.isnan(timing.latency_s(0.5))
    timing.command(2.0, 0.5)
    timing.sample(3.9, 1, False)
    assert timing.periods == 0
    timing.sample(4.1, 2, False)
    timing.sample(4.2, 0, True)
    assert (timing.periods, timing.skipped, timing.unanswered) == (4, 2, 1)


def test_percentiles_are_those_of_the_latencies():
    timing = LoopTiming(PERIOD)
    timing.command(0.0, 1.0)
    latencies = np.random.default_rng(1).gamma(4.0, 1e-4, 20_000)
    for latency in latencies:
        timing.command(10.0, float(latency))
    for share in (0.5, 0.99, 0.999):
        exact = float(np.quantile(latencies, share, method="inverted_cdf"))
        assert exact <= timing.latency_s(share) + 1e-12
        assert timing.latency_s(share) <= exact + 1.01 * BIN
    assert float(timing.values()["latency_p50_ms"]) == pytest.approx(1e3 * timing.latency_s(0.5), rel=1e-3)


def test_what_takes_very_long_counts_as_ten_periods():
    timing = LoopTiming(PERIOD)
    timing.command(0.0, 1.0)
    timing.command(10.0, 5.0)
    assert timing.latency_s(0.5) == pytest.approx(10 * PERIOD, rel=1e-3)
