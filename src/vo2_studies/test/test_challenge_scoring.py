"""From judgements to challenge.json, the confusion matrix and the page."""

import json

import pytest
from vo2_studies.challenge.confusion import confusion, confusion_text
from vo2_studies.challenge.figures import figures, hardest, interval
from vo2_studies.challenge.judging import FAILED, NONE, Judgement
from vo2_studies.challenge.page import challenge_page, score_lines
from vo2_studies.challenge.parameters import Comparison
from vo2_studies.challenge.reliability import reliability
from vo2_studies.challenge.scoring import score

CONTRACT_KEYS = {
    "cases",
    "false_alarm",
    "top1",
    "top3",
    "pair_exact",
    "pair_any",
    "pair_extra",
    "outside_unknown",
    "outside_excess_removed",
    "excess_removed",
    "parameter_error",
    "coverage90",
    "channel",
    "branch",
    "seconds",
    "per_effect",
}


def case(kind, *truth, first=NONE, **changes):
    values = {"device": "integrated", "counted": True, "failure": "", "alarm": first != NONE, "seconds": 4.0}
    values |= {"verdict": (first != NONE) == bool(truth)}
    return Judgement(kind=kind, truth=truth, first=first, **(values | changes))


def one(name, right, **changes):
    first = name if right else "dead_time"
    defaults = {"top1": right, "top3": True, "channel": True, "removed": 0.9}
    return case("one", name, first=first, **(defaults | changes))


def sample():
    compared = Comparison(
        {"share": 0.1, "time_constant": 0.3}, {"share": True, "time_constant": False}, ("z",), ()
    )
    return [
        *[case("none") for _ in range(3)],
        case("none", first="creep"),
        one("creep", True, parameters=compared, branch=True),
        one("creep", True),
        one("creep", False, removed=0.1, channel=False, top3=False),
        one("latent_heat", True, device="peltier"),
        one("latent_heat", False, counted=False),
        case(
            "one",
            "dead_time",
            first=FAILED,
            failure="fit: exit status 2",
            top1=False,
            top3=False,
            channel=False,
        ),
        case("two", "creep", "dead_time", first="creep", both=True, either=True, extra=False),
        case("two", "creep", "dead_time", first="creep", both=False, either=True, extra=True),
        case("outside", "mains_hum", first="unknown", unknown=True, removed=0.8, channel=True),
        case("outside", "stiction", first="creep", unknown=False, removed=0.2, channel=True),
    ]


def test_wilson_interval():
    # Newcombe, Statistics in Medicine 17, 857, 1998, table I: 81 of 263
    assert interval(81, 263) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
    assert interval(0, 20) == (0, pytest.approx(0.1611, abs=1e-4))


def under(condition, right, kind="one"):
    one_case = one(
        "creep", right, settings={"condition": condition, "hysteresis": "plays"}, family=True, verdict=True
    )
    return one_case if kind == "one" else case(kind, verdict=True, settings={"condition": condition})


def test_lines_count_their_kinds_and_say_what_is_wanted():
    cases = (
        [under("clean", True)] * 9
        + [under("end", False)] * 9
        + [under("end", True), under("end", True, "day")]
    )
    lines = {f.key: f for f in figures(cases)}
    assert (lines["change_first_name"].rate, lines["change_first_name"].count) == (pytest.approx(10 / 19), 19)
    assert not lines["change_first_name"].met
    assert lines["unchanged_any_name"].met and lines["unchanged_any_name"].count == 1
    assert "two_both" not in lines
    split = {(f.value_of, f.key): f for f in figures(cases, "condition")}
    assert split["clean", "change_first_name"].rate == 1.0
    assert split["end", "change_first_name"].rate == pytest.approx(0.1)
    first = hardest(cases)[0]
    assert (first.heading, first.value_of, first.key) == ("condition", "end", "change_first_name")
    assert all(f.count >= 8 for f in hardest(cases))
    weak = [one("creep", False, counted=False, settings={"condition": "end"})] * 9
    assert figures(weak) == []


def test_a_case_without_diagnosis_is_no_success():
    failed = [
        case(
            kind,
            *truth,
            first=FAILED,
            failure="fit: exit status 2",
            alarm=False,
            both=False,
            either=False,
            extra=False,
        )
        for kind, truth in (("none", ()), ("two", ("creep", "dead_time")), ("always", ("creep",)))
    ]
    lines = {figure.key: figure.rate for figure in figures(failed)}
    assert lines["two_both"] == 0.0
    assert not {"unchanged_any_name", "two_wrong_name", "always_wrong_name"} & set(lines)


def test_reliability_bins_hold_stated_and_true_shares():
    cases = [one("creep", True, stated=((0.97, True),))] * 9 + [
        one("creep", False, stated=((0.97, False), (0.4, True)))
    ]
    low, high = reliability(cases)
    assert (low["count"], low["stated"], low["observed"]) == (1, pytest.approx(0.4), 1.0)
    assert (high["from"], high["count"], high["observed"]) == (0.95, 10, pytest.approx(0.9))
    assert high["interval"][0] < 0.9 < high["interval"][1]
    assert not high["met"], "0.97 stated, 0.9 true"
    assert not low["met"]
    assert reliability([case("none")]) == []
    # the ends belong to the outer bins
    assert [b["from"] for b in reliability([one("creep", True, stated=((0.0, True), (1.0, True)))])] == [
        0.0,
        0.99,
    ]


def test_everything_that_missed_is_listed():
    missed = score(sample())["missed"]
    kinds = [(m["kind"], m["said"]) for m in missed]
    assert ("none", "creep") in kinds
    assert ("one", "dead_time") in kinds
    assert ("two", "creep") in kinds
    assert len([m for m in missed if m["truth"] == ["creep"] and m["said"] == "creep"]) == 0


def test_scores():
    scores = score(sample())
    assert set(scores) >= CONTRACT_KEYS
    assert scores["cases"] == 14
    assert scores["false_alarm"] == 0.25
    # the mean over effects of 2/3, 1 and 0; pooled 3 of 5
    assert scores["top1"] == pytest.approx((2 / 3 + 1 + 0) / 3)
    assert scores["top1_pooled"] == pytest.approx(3 / 5)
    assert scores["top1_count"] == 5
    assert scores["top1_interval"] == list(interval(3, 5))
    assert scores["top3"] == pytest.approx((2 / 3 + 1 + 0) / 3)
    assert (scores["pair_exact"], scores["pair_any"], scores["pair_extra"]) == (0.5, 1.0, 0.5)
    assert scores["outside_unknown"] == 0.5
    assert scores["outside_excess_removed"] == 0.5
    assert scores["outside_half_removed"] == 0.5
    assert scores["excess_removed"] == pytest.approx(0.9)
    assert scores["parameter_error"] == pytest.approx(0.2)
    assert scores["coverage90"] == 0.5
    assert scores["channel"] == pytest.approx(5 / 7)
    assert (scores["branch"], scores["branch_count"]) == (1.0, 1)
    assert scores["seconds"] == 4.0
    assert scores["weak"]["count"] == 1
    assert scores["failures"] == {"fit: exit status 2": 1}
    assert scores["parameters_unmatched"] == {"creep.z": 1}
    creep = scores["per_effect"]["creep"]
    assert (creep["count"], creep["top1"]) == (3, pytest.approx(2 / 3))
    assert creep["named_instead"] == {"dead_time": 1}
    assert creep["device"]["integrated"]["count"] == 3
    json.dumps(scores, allow_nan=False)


def test_failures_do_not_count_as_alarms_of_clean_cases():
    clean = [case("none"), case("none", first=FAILED, failure="diagnose: exit status 1", alarm=False)]
    scores = score(clean)
    assert scores["false_alarm_count"] == 1
    assert scores["failures"] == {"diagnose: exit status 1": 1}


def test_nothing_to_score_is_null():
    scores = score([case("none")])
    assert scores["top1"] is None
    assert scores["parameter_error"] is None
    assert set(scores) >= CONTRACT_KEYS


def test_confusion_matrix_and_its_views():
    rows, columns, matrix = confusion(sample())
    assert matrix[rows.index("creep"), columns.index("creep")] == 2
    assert matrix[rows.index("creep"), columns.index("dead_time")] == 1
    assert matrix[rows.index(NONE), columns.index(NONE)] == 3
    assert matrix[rows.index("outside catalogue"), columns.index("unknown")] == 1
    assert matrix[rows.index("dead_time"), columns.index(FAILED)] == 1
    # weak cases and those of two effects are no part of it
    assert matrix.sum() == 4 + 5 + 2
    text = confusion_text(sample())
    assert "creep 2, dead_time 1" in text
    html = challenge_page(score(sample()), sample(), "challenge --cases <14>")
    assert "&lt;14&gt;" in html
    assert html.count("<svg") == 3
    assert "src=" not in html
    assert "Everything that missed" in html
    assert any("two effects: both" in line[0] and line[4] == "2" for line in score_lines(score(sample())))
