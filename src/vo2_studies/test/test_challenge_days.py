"""Several recordings of a day each: what is drawn, and how an answer is judged."""

import pytest
from vo2_studies.challenge.days import DaySettings, judged
from vo2_studies.challenge.plan import Choice

EFFECT = {"id": "creep", "siblings": ["log_creep"]}


def answer(acts):
    return {"acts": acts, "effects": [] if acts == "none" else [EFFECT]}


def named(*names):
    """One answer for all recordings."""
    return {"effects": [{"id": name, "siblings": []} for name in names]}


def by_day(*days):
    """An answer of each recording; a tuple is a set."""
    effects = [
        [{"id": "unknown", "siblings": list(day)}]
        if isinstance(day, tuple)
        else [{"id": day, "siblings": []}] * bool(day)
        for day in days
    ]
    return {"effects": effects[0], "recordings": [{"effects": one} for one in effects]}


@pytest.mark.parametrize(
    ("acts", "diagnosis", "found"),
    [
        ("none", named(), "right"),
        ("none", named("unknown"), "unknown"),
        ("none", by_day("", "creep", ""), "wrong"),
        ("all", named("creep"), "right"),
        ("all", named("log_creep"), "right"),
        ("all", by_day("creep", ("creep", "backlash"), "creep"), "set"),
        ("all", by_day("creep", "", "creep"), "missed"),
        ("all", named("backlash"), "wrong"),
        ("first", by_day("creep", "", ""), "right"),
        ("first", named("creep"), "wrong"),
        ("first", by_day("unknown", "", ""), "unknown"),
        ("first", named(), "missed"),
    ],
)
def test_an_answer_is_judged_by_the_day(acts, diagnosis, found):
    assert judged(answer(acts), diagnosis)[0] == found


def test_kinds_take_turns_and_each_day_has_another_room():
    settings = DaySettings(5, choice=Choice(family="interacting", device="integrated", samples=(600, 600)))
    for index, kind in enumerate(("none", "all", "first")):
        case = settings.case(settings.plan(index))
        assert case.answer["acts"] == kind and bool(case.answer["effects"]) == (kind != "none")
        assert [name for name, _ in case.others] == ["day_1", "day_2"]
        rooms = [day["ambient"] for day in case.answer["days"]]
        assert all(0.3 <= abs(room) <= 0.7 for room in rooms) and rooms[0] != rooms[1]
