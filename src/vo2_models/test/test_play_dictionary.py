"""Plays at few samples of a long path are those of the whole path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.hysteresis.fitting_kernels import without_closed_loops
from vo2_models.identification import play_dictionary
from vo2_models.identification.bank_fit import Late
from vo2_models.identification.play_dictionary import PlayDictionary

PLAYS = PlayDictionary.over(20.0, 90.0, centres=6, widths=5)


def _needed(path, rows):
    needed = np.zeros(path.size, dtype=np.bool_)
    needed[rows] = True
    return needed


@settings(max_examples=200, deadline=None)
@given(
    path=st.lists(st.integers(0, 12), min_size=1, max_size=60).map(lambda x: 20.0 + 6.0 * np.array(x)),
    data=st.data(),
)
def test_what_is_left_out_changes_no_play(path, data):
    rows = np.unique(data.draw(st.lists(st.integers(0, path.size - 1), min_size=1, max_size=8)))
    few = without_closed_loops(path, _needed(path, rows))
    assert set(rows) <= set(few.tolist()) and few[0] == 0 and np.all(np.diff(few) > 0)
    np.testing.assert_array_equal(PLAYS.at(path, rows, None), PLAYS.features(path)[rows])


def test_of_a_long_path_with_a_noisy_drive_little_is_left():
    t = np.arange(20_000)
    path = 55.0 + 30.0 * np.cos(t / 500.0) + np.random.default_rng(3).normal(0.0, 0.5, t.size)
    rows = np.arange(0, t.size, 200)
    assert without_closed_loops(path, _needed(path, rows)).size < 0.05 * t.size
    np.testing.assert_array_equal(PLAYS.at(path, rows, None), PLAYS.features(path)[rows])


def test_what_comes_behind_the_plays_takes_every_sample(monkeypatch):
    path = 55.0 + 30.0 * np.cos(np.arange(900) / 40.0)
    late = Late(lambda columns: np.cumsum(columns, axis=0))
    rows = np.array([3, 500, 899])
    monkeypatch.setattr(play_dictionary, "_ELEMENTS", 2_000)
    expected = np.cumsum(PLAYS.features(path), axis=0)[rows]
    assert PLAYS.at(path, rows, late) == pytest.approx(expected, rel=1e-12)
