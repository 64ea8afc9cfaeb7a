"""Excitation sequences: counts and order by definition, timing, and the composite recording."""

from itertools import pairwise

import numpy as np
import pytest
from vo2_models.identification.excitation import (
    Excitation,
    chirp,
    composite_recording,
    damped_oscillation,
    first_order_reversal_fan,
    random_levels,
)


def test_damped_oscillation_of_three_cells_is_the_one_written_by_hand():
    assert damped_oscillation([0, 1, 2, 3]).tolist() == [0, 1, 2, 3, 2, 1, 2]
    assert damped_oscillation([0, 1, 2, 3], reversals_only=True).tolist() == [0, 3, 1, 2]


@pytest.mark.parametrize("level", [1, 2, 7, 30])
def test_damped_oscillation_has_one_level_per_unknown(level):
    levels = damped_oscillation(np.arange(level + 1.0))
    assert levels.size == level * (level + 1) // 2 + 1
    assert np.all(np.abs(np.diff(levels)) == 1.0)


def test_fan_starts_low_and_returns_to_the_top_after_each_reversal():
    assert first_order_reversal_fan([0, 1, 2]).tolist() == [0, 2, 1, 2, 0, 1, 2]
    assert first_order_reversal_fan([0, 1, 2], reversals_only=True).tolist() == [0, 2, 1, 2, 0, 2]


def test_random_levels_stay_inside_and_repeat_with_the_seed():
    levels = random_levels(2.0, -1.0, 200, seed=3)
    assert levels.min() >= -1.0 and levels.max() <= 2.0 and np.ptp(levels) > 2.0
    assert np.array_equal(levels, random_levels(2.0, -1.0, 200, seed=3))


def test_sampling_follows_ramps_and_holds():
    play = Excitation(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.5, 0.0]), np.array([0.25, 0.5, 0.25]))
    assert play.sample(0.25) == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0, 3.0])
    # 0.1 is no binary fraction: sums of it must not shift a step by one sample
    stairs = Excitation(np.arange(50.0), np.zeros(50), np.full(50, 0.1))
    assert np.array_equal(stairs.sample(0.1), np.arange(50.0))
    assert np.array_equal(stairs.sample(0.05), np.repeat(np.arange(50.0), 2))


def test_at_rate_takes_the_time_the_rate_says():
    play = Excitation.at_rate([0.0, 2.0, 1.0], rate_per_s=0.5, hold_s=1.0)
    assert play.duration_s == pytest.approx(6.0 + 3.0)
    assert np.max(np.abs(np.diff(play.sample(0.01)))) == pytest.approx(0.005)


def test_chirp_sweeps_the_stated_band():
    wave = chirp(1.0, 0.5, (2.0, 40.0), 4.0, 1e-3)
    assert wave.size == 4000 and wave.max() <= 1.5 and wave.min() >= 0.5
    up = np.flatnonzero((wave[:-1] < 1.0) & (wave[1:] >= 1.0))
    # f(t) = 2 exp(g t), so cycle k is complete where 2 (exp(g t) - 1) / g = k
    growth = np.log(20.0) / 4.0
    cycles = np.arange(1, int(2.0 * 19.0 / growth) + 1)
    assert up[-cycles.size :] * 1e-3 == pytest.approx(np.log1p(growth * cycles / 2.0) / growth, abs=1.1e-3)


@pytest.mark.parametrize(
    ("cold", "hot", "transition", "period"),
    [(3.68e-3, 8.49e-3, (5.5e-3, 7e-3), 1e-3), (0.05, -1.15, (-0.6, -0.9), 0.125)],
)
def test_composite_recording_covers_the_range_and_names_its_segments(cold, hot, transition, period):
    play = composite_recording(
        cold, hot, transition=transition, duration_s=20000 * period, sample_period_s=period
    )
    current = play.sample(period)
    assert current.size == pytest.approx(20000, rel=0.01)
    assert current.min() == pytest.approx(min(cold, hot)) and current.max() == pytest.approx(max(cold, hot))
    names = [name for name, _, _ in play.segments]
    assert {name.split(",")[0] for name in names} == {
        "major loop",
        "steps",
        "reversal fan",
        "chirp",
        "random levels",
        "hold",
    }
    assert all(stop == first for (_, _, stop), (_, first, _) in pairwise(play.segments))
    _, first, stop = play.segments[names.index("chirp, inside the transition")]
    inside = play.levels[first:stop]
    assert min(transition) < inside.min() and inside.max() < max(transition)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: damped_oscillation([0.0, 0.0, 1.0]), r"walls: found 0 after 0 at index 1"),
        (lambda: damped_oscillation([0.0]), r"walls: found 1 value\(s\), need at least 2"),
        (lambda: first_order_reversal_fan([0.0, np.nan]), r"walls: found nan at index \(1,\)"),
        (lambda: random_levels(0, 1, 0, seed=1), r"count: found 0"),
        (lambda: chirp(0, 1, (1.0, 900.0), 1.0, 1e-3), r"frequency_hz: found 900, need at most half"),
        (lambda: Excitation(np.zeros(2), np.zeros(2), np.array([1.0, -1.0])), r"hold_s: found -1 at index 1"),
        (lambda: Excitation(np.zeros(2), np.zeros(2), np.zeros(2)), r"summed: found 0"),
        (
            lambda: composite_recording(0, 1, transition=(0.8, 0.2), duration_s=99, sample_period_s=0.01),
            r"transition: found \(0.8, 0.2\), need two levels in the order",
        ),
        (
            lambda: composite_recording(0, 1, transition=(0.2, 0.8), duration_s=1, sample_period_s=0.01),
            r"duration_s: found 1 s",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
