"""Which constants have moved: the fewest that explain what all of them together do."""

from __future__ import annotations

import numpy as np
import pytest
from vo2_models.diagnosis.drift import Drift
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nuisance import Constant
from vo2_models.diagnosis.report import _powers_of_ten
from vo2_models.diagnosis.result import MovedConstant

LIMITS = Limits()
NAMES = ("thermal.ambient", "deflection.zero", "deflection.gain", "thermal.time_constant")
SPREADS = (2.0, 1e-7, 0.01, 1e-4)


def drift_of_steps(steps, columns) -> Drift:
    """The posterior of moves (d,) by columns (n, d) in noise of unit variance, a drawn noise added."""
    noise = np.random.default_rng(5).normal(size=columns.shape[0])
    covariance = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1]))
    constants = tuple(Constant(n, "1", 0.0, s, drifts=True) for n, s in zip(NAMES, SPREADS, strict=True))
    found = covariance @ columns.T @ (columns @ np.asarray(steps) + noise)
    return Drift(constants, found, covariance, found)


@pytest.fixture(scope="module")
def columns():
    """Room, zero and gain of one response do nearly the same; a time constant does something else."""
    rng = np.random.default_rng(3)
    common, own = rng.normal(size=(800, 1)), rng.normal(size=(800, 4))
    return np.hstack(
        [common + 0.02 * own[:, :1], common + 0.02 * own[:, 1:2], common + 0.02 * own[:, 2:3], own[:, 3:]]
    )


def fewest(drift: Drift) -> list[Drift]:
    return drift.fewest(LIMITS.drift_p, LIMITS.rival)


@pytest.mark.parametrize("place", range(4))
def test_one_constant_that_moved_is_told_as_one_and_more_exactly(columns, place):
    steps = np.zeros(4)
    steps[place] = 4.0
    drift = drift_of_steps(steps, columns)
    found = fewest(drift)
    assert [c.name for c in found[0].constants] == [NAMES[place]]
    assert abs(found[0].move[0] - 4.0 * SPREADS[place]) < 4.0 * found[0].std[0]
    assert found[0].std[0] <= drift.std[place]
    if place < 3:  # free together, each of the three is uncertain
        assert found[0].std[0] < 0.2 * drift.std[place]


def test_two_that_moved_apart_are_both_told(columns):
    found = fewest(drift_of_steps([0.0, 4.0, 0.0, -3.0], columns))
    assert {c.name for c in found[0].constants} == {"deflection.zero", "thermal.time_constant"}


def test_what_is_not_told_apart_is_listed_beside_it(columns):
    """A small move of one of three that do nearly the same, and of one that does not."""
    small = fewest(drift_of_steps([0.0, 1.0, 0.0, 0.0], columns))
    assert {d.constants[0].name for d in small} == set(NAMES[:3])
    assert [d.constants[0].name for d in fewest(drift_of_steps([0.0, 0.0, 0.0, 1.0], columns))] == [NAMES[3]]


def test_as_many_as_there_are_where_all_have_moved():
    drift = drift_of_steps([4.0, -3.0, 3.0, 2.0], np.random.default_rng(4).normal(size=(800, 4)))
    (found,) = fewest(drift)
    assert found.constants == drift.constants
    assert np.allclose(found.move, drift.move) and np.allclose(found.std, drift.std)


def test_of_a_gain_of_a_resistance_the_logarithm_is_told_as_a_gain():
    gain = Constant("resistance.gain", "1", 1.0, 0.05, drifts=True)
    drift = Drift((gain,), np.array([4.0]), np.array([[0.01]]), np.zeros(1))
    assert drift.move[0] == pytest.approx(np.expm1(0.2))
    assert drift.std[0] == pytest.approx(np.exp(0.2) * 0.05 * 0.1)


def of_three_recordings(room, own, common=(0.0, 0.0)):
    """A room, that of each of three recordings beside it, and a gain; 400 samples of each recording."""
    rng = np.random.default_rng(11)
    line, gain = rng.normal(size=(1200, 2)).T
    parts = np.repeat(np.eye(3), 400, axis=0)
    columns = np.column_stack([line, *(parts * line[:, None]).T, gain])
    constants = [
        Constant("thermal.ambient", "degC", 22.0, 2.0, drifts=True),
        *(Constant("thermal.ambient", "degC", 22.0, 2.0, drifts=True, part=k) for k in range(3)),
        Constant("deflection.gain", "1", 1.0, 0.01, drifts=True),
    ]
    steps = np.array([room, *own, common[0]])
    covariance = np.linalg.inv(columns.T @ columns + np.eye(5))
    found = covariance @ columns.T @ (columns @ steps + rng.normal(size=1200))
    return Drift(tuple(constants), found, covariance, found)


def test_a_room_that_has_moved_in_all_recordings_is_one_constant():
    (found,) = fewest(of_three_recordings(2.0, (0.0, 0.0, 0.0)))
    assert [(c.name, c.part) for c in found.constants] == [("thermal.ambient", None)]


def test_a_room_of_each_recordings_own_is_told_of_each():
    (found,) = fewest(of_three_recordings(0.0, (1.0, -1.5, 0.5)))
    told = found.of_each_recording(LIMITS.constant_moved)
    assert [c.part for c in told.constants] == [0, 1, 2]
    for move, std, true in zip(told.move, told.std, (2.0, -3.0, 1.0), strict=True):
        assert abs(move - true) < 4.0 * std and std < 0.2


def test_what_is_the_same_in_all_recordings_stays_one_beside_what_is_not():
    (found,) = fewest(of_three_recordings(0.0, (1.0, -1.5, 0.5), common=(3.0, 0.0)))
    told = found.of_each_recording(LIMITS.constant_moved)
    assert [(c.name, c.part) for c in told.constants] == [
        ("thermal.ambient", 0),
        ("thermal.ambient", 1),
        ("thermal.ambient", 2),
        ("deflection.gain", None),
    ]


def test_of_recordings_whose_room_has_hardly_moved_none_is_told_but_the_surest():
    drift = of_three_recordings(0.0, (1.0, -1.5, 0.02))
    rooms = drift.of_each_recording(LIMITS.constant_moved)
    assert {c.part for c in rooms.constants if c.name == "thermal.ambient"} == {0, 1}
    (surest,) = (c for c in drift.of_each_recording(1e6).constants if c.part is not None)
    assert surest.part == 1


@pytest.mark.parametrize(
    ("now", "times"), [(10.01, "10"), (0.0999, "0.1"), (1000.0, "1000"), (1.001, ""), (9.5, ""), (-10.0, "")]
)
def test_a_gain_of_another_power_of_ten_is_told_as_a_unit(now, times):
    told = _powers_of_ten([MovedConstant("deflection.gain", 1.0, now, 0.01, "1")], Limits())
    assert bool(told) == bool(times)
    assert not times or f"is {times} times what it was: check the unit" in told[0]
