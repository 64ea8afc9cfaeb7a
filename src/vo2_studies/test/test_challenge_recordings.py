"""Changes concealed in measurements: exact, of the wanted size, reversible; the sets as their README says."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from vo2_identification.bags import read_recording
from vo2_models.device.description import described
from vo2_models.recording import Recording
from vo2_studies.challenge import command
from vo2_studies.challenge.families import FAMILIES
from vo2_studies.challenge.judging import judge
from vo2_studies.challenge.recordings import separable
from vo2_studies.challenge.recordings.bodyless import SAMPLES, BodylessSettings
from vo2_studies.challenge.recordings.changes import CHANGES, changed
from vo2_studies.challenge.recordings.draw import MeasuredSettings, conceal
from vo2_studies.challenge.recordings.separable import nearest_rival
from vo2_studies.challenge.recordings.sets import MOST, MeasuredSet, repeat_spread
from vo2_studies.challenge.runner import Paths, load_json, write_case

TIME = np.arange(4000) * 0.01
LOOP = 50.0 + 30.0 * np.sin(TIME / 2) + 3.0 * np.sin(3.3 * TIME)


def rms(values):
    return float(np.sqrt(np.mean((values - LOOP) ** 2)))


@pytest.mark.parametrize("change", CHANGES, ids=[change.id for change in CHANGES])
def test_changes_have_the_wanted_size_and_grow(change):
    small, large = (changed(change, TIME, LOOP, wanted, rms) for wanted in (0.01, 0.03))
    assert rms(small[0]) == pytest.approx(0.01, rel=0.05)
    assert rms(large[0]) == pytest.approx(0.03, rel=0.05)
    assert large[1] > small[1]


def by_id(name):
    (found,) = (change for change in CHANGES if change.id == name)
    return found


def nearest(own, strength, values=LOOP, unit="m"):
    return nearest_rival(TIME, values, by_id(own).alter(TIME, values, strength), unit, own)


def test_what_others_imitate_is_told_from_what_they_do_not():
    # a drift of the gain is one of the zero where nearly all of a signal is its mean, and none where it has none
    far = 5000.0 + LOOP
    name, drift_of_a_mean = nearest("sensor_gain_drift", 0.01, far)
    assert name == "sensor_zero_drift"
    of_its_own = nearest("sensor_gain_drift", 0.1, LOOP - 50.0)[1]
    plain = 0.1 * float(np.std(LOOP)) / 2
    assert drift_of_a_mean < 0.02 * 0.01 * 5050.0
    assert of_its_own > 0.2 * plain
    # a late clock is not told from a dead time, and is from an average as it grows
    name, small = nearest("clock_offset", 0.05)
    assert name not in ("clock_offset", "dead_time")
    assert nearest("clock_offset", 0.4)[1] > 3.0 * small


def test_what_constants_do_is_no_change():
    moved = nearest_rival(TIME, LOOP, 1.02 * LOOP + 3.0, "m", "none")
    assert moved[1] == pytest.approx(0.0, abs=1e-9)
    # a resistance is judged by its logarithm, in which a gain is a zero
    assert nearest_rival(TIME, LOOP, 1.02 * LOOP, "ohm", "none")[1] == pytest.approx(0.0, abs=1e-9)


def test_changes_are_exact():
    lagging = by_id("sensor_lag").alter(TIME, LOOP, 0.5)
    assert np.allclose((0.5 * np.gradient(lagging, TIME) + lagging)[5:-5], LOOP[5:-5], atol=0.1)
    assert np.allclose(by_id("clock_offset").alter(TIME, LOOP, 0.05)[5:], LOOP[:-5])
    # what was stated, behind the dead time or with the drift, is what was applied
    stated = by_id("dead_time").alter(TIME, LOOP, 0.05)
    assert np.allclose(stated[:-5], LOOP[5:])
    drifted = by_id("drive_gain_drift").alter(TIME, LOOP, 0.1)
    assert np.allclose(drifted * (1 + 0.1 * TIME / TIME[-1]), LOOP)
    film = by_id("leakage_resistance").alter(TIME, LOOP, 1e-3)
    assert np.allclose(1 / film, 1 / LOOP + 1e-3)


@pytest.mark.parametrize("change", CHANGES, ids=[change.id for change in CHANGES])
def test_what_wasconcealed_can_be_judged(change):
    """The answer holds all that a diagnosis is compared with: a mode's frequency too, not its share alone."""
    whole = Recording(TIME, {"drive": LOOP, "out": LOOP}, "rig")
    rig = MeasuredSet("rig", {}, "drive", "out", "ohm" if "ohm" in change.units else "m", whole, {}, 0.01)
    _, entry = conceal(rig, whole, change, 2.0)
    place = {"signal": "out", "share": 1.0, "branch": "both", "frequency_hz": [7.8, 8.2]}
    told = {"id": change.id, "family": entry["families"][0], "probability": 0.9, "signal": entry["signal"]}
    told["parameters"] = {n: {**p, "std": 0.1 * abs(p["value"])} for n, p in entry["parameters"].items()}
    diagnosis = {
        "verdict": "differs", "effects": [told], "candidates": [{"id": change.id, "probability": 0.9}],
        "location": [place], "indistinguishable": [], "next_experiment": None,
        "fit": {"out": {"nrmse_before": 0.02, "nrmse_after": 0.01, "noise_floor": 0.01}},
    }  # fmt: skip
    answer = {
        "index": 0, "kind": "one", "device": "rig", "family": "measured", "condition": "rerun", "excitation": "own",
        "moved": [], "effects": [entry], "counted": True,
    }  # fmt: skip
    judged = judge(answer, {"failure": "", "diagnosis": diagnosis, "seconds": 1.0, "follow_up": None})
    assert judged.top1 and judged.parameters is not None
    assert judged.frequency is (True if change.id == "cantilever_resonance" else None)


def test_a_size_out_of_reach_is_the_largest():
    after, strength = changed(by_id("adc_saturation"), TIME, LOOP, 1e3, rms)
    assert strength == pytest.approx(0.3 * np.ptp(LOOP), rel=1e-6)
    assert rms(after) < 1e3


def test_spread_of_repeats():
    rng = np.random.default_rng(0)
    drive = np.concatenate(
        [np.linspace(a, b, 500) for a, b in itertools.pairwise([0, 1, 0, 1, 0, 1, 0, 1, 0])]
    )

    def run(offset):
        channels = {"u": drive, "y": drive**2 + offset + 1e-4 * rng.standard_normal(drive.size)}
        return Recording(TIME, channels, "x")

    assert repeat_spread(run(0.0), run(0.02), "u", "y", "m") == pytest.approx(0.02, rel=0.02)
    once = run(0.0)
    assert repeat_spread(once, once, "u", "y", "m") == pytest.approx(1e-4, rel=0.15)


DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data beside the repository")


@needs_data
def test_separable_counts_what_challenge_conceals(capsys):
    assert separable.main(["--recordings", str(DATA), "--cases", "12", "--seed", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    plans = [MeasuredSettings(3, str(DATA)).plan(k) for k in range(12)]
    asked = [p for p in plans if p.effects and p.effects[0] != "drive_gain_drift"]
    assert len(lines) == len(asked) + 1
    assert all(p.effects[0] in line for p, line in zip(asked, lines, strict=False))
    assert lines[-1].startswith("of ")
    assert separable.main(["--recordings", str(DATA / "none"), "--cases", "1"]) == 2


@needs_data
def test_cases_of_the_measured_sets(tmp_path):
    settings = MeasuredSettings(3, str(DATA))
    plans = [settings.plan(k) for k in range(840)]
    assert {plan.device for plan in plans} == {one.name for one in settings.sets}
    assert sum(not plan.effects for plan in plans) == 280, "a third is unchanged"
    assert {plan.kind for plan in plans} == {"none", "day", "one"}
    assert all((plan.condition == "remounted") == (plan.kind == "day") for plan in plans if not plan.effects)
    assert len({plan.effects for plan in plans}) == len(CHANGES) + 1
    seen = set()
    for plan in plans:
        if plan.device in seen or not plan.effects:
            continue
        seen.add(plan.device)
        case = settings.case(plan)
        assert case.answer["effects"][0]["ratio"] > 0
        (measured,) = (one for one in settings.sets if one.name == plan.device)
        channel = case.answer["effects"][0]["channels"][0]
        names = described(measured.document, plan.device).names
        assert {measured.drive, measured.response} == set(names.values())
        assert not np.array_equal(case.test.measurement[channel], measured.others[plan.condition][channel])
        assert case.shared == plan.device and len(case.test.measurement) <= MOST
        assert write_case(case, Paths(tmp_path)) == "device.yaml"
        recording, _ = read_recording(tmp_path / "cases" / f"{plan.index:04d}" / "test")
        assert len(recording) == len(case.test.measurement)
    assert seen == {one.name for one in settings.sets}


@needs_data
def test_some_of_the_sets(tmp_path):
    settings = MeasuredSettings(3, str(DATA), ("piezo", "magnet"))
    assert {settings.plan(k).device for k in range(6)} == {"piezo", "magnet"}
    with pytest.raises(ValueError, match="sets: found bell, need some of piezo, seal_1_bar"):
        MeasuredSettings(3, str(DATA), ("bell",)).plan(0)


@needs_data
def test_the_command_draws_measured_cases(tmp_path):
    arguments = ["--cases", "2", "--seed", "3", "--output", str(tmp_path / "out"), "--bags-only"]
    assert command.main([*arguments, "--recordings", str(DATA)]) == 0
    assert load_json(tmp_path / "out" / "settings.json")["recordings"] == str(DATA.resolve())
    assert (tmp_path / "out" / "cases" / "0001" / "device.yaml").exists()


def test_a_folder_that_is_not_the_data_folder(tmp_path, capsys):
    arguments = ["--cases", "2", "--seed", "3", "--output", str(tmp_path / "out")]
    assert command.main([*arguments, "--recordings", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "piezo" in error and error.count("\n") == 1


def test_cases_of_drawn_devices_without_body(tmp_path):
    settings = BodylessSettings(5, "all")
    plans = [settings.plan(k) for k in range(3 * len(CHANGES))]
    assert [plan.kind for plan in plans[:3]] == ["none", "moved", "one"]
    assert {plan.effects for plan in plans if plan.kind == "one"} == {(change.id,) for change in CHANGES}
    assert {plan.family for plan in plans} == set(FAMILIES)
    moved = {}
    for plan in plans[:30]:
        case = settings.case(plan)
        recording = case.test.measurement
        names = described(case.document, "bodyless").names
        drive, response = (recording[name] for name in names.values())
        if plan.index < 3:  # one of each kind
            again = settings.case(plan).test.measurement
            assert np.array_equal(response, again[list(names.values())[1]]), "the seed decides"
        assert len(recording) == SAMPLES and np.all(np.isfinite(response))
        low, high = case.document["drive"]["operating"]
        if plan.effects != ("drive_gain_drift",):
            assert low - 1e-9 <= drive.min() and drive.max() <= high + 1e-9
        calibration = case.calibration.measurement
        assert not np.array_equal(calibration[next(iter(names.values()))], drive), "another path"
        for entry in case.answer["moved"]:
            moved.setdefault(entry["constant"], []).append(entry["by"])
        assert bool(case.answer["moved"]) == (plan.kind == "moved")
        assert len(case.answer["effects"]) == (plan.kind == "one")
        write_case(case, Paths(tmp_path))
        read, problems = read_recording(
            tmp_path / "cases" / f"{plan.index:04d}" / "test", device=described(case.document, "bodyless")
        )
        assert len(read) == SAMPLES and [problem.kind for problem in problems] == ["missing_topic"]
    assert set(moved) == {"deflection_scale", "deflection_zero", "film_scale"}
    assert all(0.02 <= abs(by) <= 0.2 for by in itertools.chain(*moved.values()))


def test_a_gain_moves_the_response_and_nothing_else():
    drawing = BodylessSettings(6, "duhem", ("moved",))
    cases = (drawing.case(drawing.plan(k)) for k in range(9))
    moved = next(c for c in cases if c.answer["moved"][0]["constant"] == "deflection_scale")
    settings = BodylessSettings(6, "duhem", ("none",))
    plan = settings.plan(moved.plan.index)
    plain = settings.case(plan).test.measurement
    ratio = moved.test.measurement["response"] / plain["response"]
    assert np.allclose(ratio, 1.0 + moved.answer["moved"][0]["by"])
    assert np.array_equal(moved.test.measurement["drive"], plain["drive"])


def test_the_command_draws_devices_without_body(tmp_path, capsys):
    arguments = ["--cases", "3", "--seed", "3", "--output", str(tmp_path / "out"), "--bags-only"]
    assert command.main([*arguments, "--rigs", "bodyless", "--family", "duhem"]) == 0
    assert load_json(tmp_path / "out" / "settings.json")["family"] == "duhem"
    assert (tmp_path / "out" / "cases" / "0002" / "device.yaml").exists()
    for wrong in (["--family", "bell"], ["--kinds", "outside"]):
        there = [*arguments[:4], "--output", str(tmp_path / "other"), "--rigs", "bodyless", *wrong]
        assert command.main(there) == 2
        assert f"found {wrong[1]!r}" in capsys.readouterr().err
