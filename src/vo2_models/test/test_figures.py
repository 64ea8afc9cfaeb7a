"""Long courses in figures."""

import numpy as np
import pytest
from vo2_models.page.figures import STRETCHES, drawn


def test_a_line_through_a_long_course_is_drawn_by_its_ends() -> None:
    course = np.random.default_rng(0).standard_normal(STRETCHES * 250)
    course[123_456], course[77_777], course[5] = 90.0, -90.0, np.nan
    places = drawn(course)
    assert places.size <= 3 * STRETCHES and np.all(np.diff(places) > 0)
    assert {123_456, 77_777} <= set(places.tolist())
    shown = np.full(course.size, np.nan)
    shown[places] = course[places]
    for ends in (np.nanmin, np.nanmax):
        assert ends(shown.reshape(STRETCHES, -1), axis=1) == pytest.approx(
            ends(course.reshape(STRETCHES, -1), axis=1)
        )


def test_all_of_a_short_course_is_drawn() -> None:
    assert drawn(np.zeros(1000)).tolist() == list(range(1000))
