"""Laws of relaxation: on made-up courses the law that made them wins, on measured ones the logarithm loses."""

import json
from pathlib import Path

import numpy as np
import pytest
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, Recording
from vo2_studies.measured.cases import Case, cases_of
from vo2_studies.measured.command import main
from vo2_studies.measured.laws import LAWS, compare_laws
from vo2_studies.measured.sources import SOURCES, as_bags
from vo2_studies.preisach.measured import data_folder

FOUND = data_folder()
DATA = FOUND or Path()
needs_data = pytest.mark.skipif(FOUND is None, reason="no measured recordings at ../shared/data or $VO2_DATA")

COURSES = {
    "logarithm": lambda t: 3.0 + 0.2 * np.log1p(t / 0.003),
    "exponential": lambda t: 4.5 - 1.5 * np.exp(-t / 0.02),
    "two exponentials": lambda t: 4.5 - 1.0 * np.exp(-t / 0.004) - 0.5 * np.exp(-t / 0.1),
    "stretched exponential": lambda t: 4.5 - 1.5 * np.exp(-np.sqrt(t / 0.02)),
    "power": lambda t: 4.5 - 1.5 * (1.0 + t / 0.003) ** -0.6,
}


@pytest.mark.parametrize("law", list(COURSES))
def test_the_law_that_made_a_course_predicts_it_best(law):
    time = 1e-3 * np.arange(1000)
    since = np.where(time > 0.1, time - 0.1, np.nan)
    y = COURSES[law](np.nan_to_num(since)) + 1e-4 * np.random.default_rng(3).normal(size=time.size)
    values = np.where(time > 0.101, 10.0**y, np.nan)
    recording = Recording(time, {HEATER_CURRENT: np.zeros(time.size), RESISTANCE: values}, "integrated")
    result = compare_laws(Case("made up", recording, RESISTANCE, since, time, "W"))
    for errors in (result.between, result.later):
        assert set(errors) == set(LAWS)
        # laws with more parameters contain some of the others and may tie
        assert errors[law] < 3e-4
        others = {"exponential"} if law != "exponential" else {"logarithm"}
        others |= {"logarithm"} if law != "logarithm" else set()
        assert all(errors[other] > 2.0 * errors[law] for other in others - {law})


@needs_data
def test_measured_relaxations_do_not_follow_the_logarithm_of_time(tmp_path):
    cases = cases_of("slow", as_bags(SOURCES["slow"], DATA, tmp_path))
    assert [case.label for case in cases] == ["10 mA", "20 mA", "30 mA", "40 mA", "50 mA", "60 mA", "70 mA"]
    results = [compare_laws(case) for case in cases[::3]]
    for result in results:
        assert result.later["logarithm"] > 2.0 * result.later["power"]
        assert result.between["logarithm"] > result.between["power"]


@needs_data
def test_sets_become_bags_with_labels_and_one_scale_of_the_drive(tmp_path):
    traces = as_bags(SOURCES["pulses"], DATA, tmp_path)
    assert [trace.label for trace in traces] == ["4.25 V", "4.75 V", "5 V", "5.5 V", "6 V", "6.5 V"]
    assert all(trace.bag.is_dir() for trace in traces)
    cases = cases_of("pulses", traces)
    # 0.34 W at 6.5 V, as voltage times current of the file say
    assert max(float(case.drive.max()) for case in cases) == pytest.approx(0.34, abs=0.01)


def test_missing_data_is_told(tmp_path, capsys):
    assert main(["--output", str(tmp_path / "out"), "--data", str(tmp_path / "nowhere")]) == 2
    assert "found no folder" in capsys.readouterr().err
    assert main(["--output", str(tmp_path / "out"), "--data", str(tmp_path)]) == 2
    assert "found none of" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@needs_data
@pytest.mark.slow
def test_command_on_a_measured_set(tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["--output", str(out), "--data", str(DATA), "--only", "fast", "--no-diagnosis", "--quiet"]
    assert main(arguments) == 0
    assert "second_thermal_mode" in capsys.readouterr().out
    found = json.loads((out / "measured.json").read_text())["sets"]["fast"]
    held = {candidate["id"]: candidate["rms_held_out"] for candidate in found["candidates"]}
    # a second heat path, or a spread of them, predicts pulses that were not fitted; a drift with the logarithm of time does not
    assert held["second_thermal_mode"] < 0.6 * held[found["reference"]]
    assert held["spread_of_lags"] < 0.6 * held[found["reference"]]
    assert held["slow_relaxation"] > held["second_thermal_mode"]
    assert "<figure" in (out / "report.html").read_text()
