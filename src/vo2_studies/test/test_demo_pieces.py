"""The demo's own pieces: errors as the contract defines them, the sample log, the page, the acts' list."""

import json
import re
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml
from vo2_identification.sample_log import SampleLog
from vo2_models.device import truth
from vo2_models.effects import effect_ids
from vo2_models.page.figures import figure_html, new_figure
from vo2_models.page.page import page, section, table
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, TIP_DEFLECTION, Recording
from vo2_studies.demo import seeds
from vo2_studies.demo.acts import ACTS, act
from vo2_studies.demo.acts.change import start_diagnosis
from vo2_studies.demo.concealed import Concealed, check_choice, conceal, diagnosis_section, judge
from vo2_studies.demo.errors import TRUE_DEFLECTION, estimation_error, phase_data, tracking_error
from vo2_studies.demo.graph import Graph, NodeProcess
from vo2_studies.demo.stage import Phase, Stage

PHASE = Phase("steps", "/vo2", 2.0, 2.1)


def loop(estimate_error=0.0, reference_error=0.0, drop=()):
    """A loop of 1 kHz from 1 s to 3 s whose true deflection is a ramp, with constant errors of estimate and reference."""
    time = 1.0 + np.arange(2001) * 1e-3
    kept = np.setdiff1d(np.arange(time.size), drop)
    true = time * 1e-5
    return {
        "measurement": Recording(time, {TRUE_DEFLECTION: true, HEATER_CURRENT: np.full(time.size, 0.006)}),
        "estimate": Recording(time[kept], {TIP_DEFLECTION: true[kept] + estimate_error}),
        "reference": Recording(time, {TIP_DEFLECTION: true + np.where(time < 2.0055, 1.0, reference_error)}),
    }


def test_errors_of_a_phase_are_mean_absolute_and_leave_out_the_first_five_per_cent():
    data = phase_data(loop(estimate_error=-2e-6, reference_error=3e-6), PHASE)
    assert data.time_s.size == 100
    assert data.time_s[0] == pytest.approx(1e-3)
    assert estimation_error(data) == pytest.approx(2e-6)
    # the reference is a metre off in the first five samples of a hundred
    assert tracking_error(data) == pytest.approx(3e-6)


def test_a_missing_sample_is_an_error_with_its_place_and_not_a_smaller_mean():
    with pytest.raises(ValueError, match=r"steps: estimate lacks 2 samples, the first at 2\.01"):
        phase_data(loop(drop=(1010, 1011)), PHASE)


def test_a_missing_topic_is_named():
    recordings = loop()
    del recordings["estimate"]
    with pytest.raises(ValueError, match="found no estimate"):
        phase_data(recordings, PHASE)


def test_an_estimate_that_is_not_a_number_is_not_averaged_away():
    with pytest.raises(ValueError, match="100 samples have no estimate"):
        estimation_error(phase_data(loop(estimate_error=np.nan), PHASE))


def test_sample_log_files_a_command_under_the_interval_that_it_governs():
    log = SampleLog(("heater_current", "film_resistance", "tip_deflection"))
    for k in range(3):
        log.append(k * 1_000_000, (0.1 * k, 5.0 + k, float("nan")), command_a=10.0 + k)
    recording = log.recording("integrated")
    assert set(recording.channels) == {"heater_current", "film_resistance", COMMANDED_CURRENT}
    np.testing.assert_array_equal(recording[COMMANDED_CURRENT], [np.nan, 10.0, 11.0])
    np.testing.assert_allclose(recording.time_s, [0.0, 1e-3, 2e-3])


def test_sample_log_of_one_sample_is_refused():
    log = SampleLog(("heater_current",))
    log.append(0, (0.0,))
    with pytest.raises(ValueError, match="need at least 2"):
        log.recording("integrated")


def test_page_is_self_contained_and_escapes_what_it_is_given():
    with new_figure() as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [1, 0])
        svg = figure_html(figure, 'A "line" & more')
    text = page("<title>", "a & b", [section("S", table("cap", ["x"], [["<td>"]]), svg)])
    assert text.startswith("<!doctype html>")
    assert "&lt;title&gt;" in text
    assert "<td>&lt;td&gt;</td>" in text
    assert "<svg role=" in text
    assert "src=" not in text
    assert "<link" not in text


def test_every_act_can_be_found():
    assert len(set(ACTS)) == len(ACTS) > 4
    assert all(callable(act(name)) for name in ACTS)


def test_what_is_concealed_comes_from_the_seed_alone_and_from_the_whole_catalogue():
    assert conceal("random", "integrated", 7) == conceal("random", "integrated", 7)
    drawn = {conceal("random", "integrated", seed).id for seed in range(300)}
    assert drawn == set(effect_ids("integrated"))
    name = conceal("random", "peltier", 7).id
    assert conceal(name, "peltier", 7) == conceal("random", "peltier", 7)
    assert conceal("none", "integrated", 7) == Concealed()


@pytest.mark.parametrize("name", effect_ids("integrated"))
def test_every_drawn_effect_can_be_given_to_the_device_and_told(name):
    concealed = conceal(name, "integrated", 3)
    truth("integrated", seed=1, effects=concealed.plain)
    assert "\n" not in concealed.as_parameter
    assert yaml.safe_load(concealed.as_parameter) == concealed.plain
    assert name in concealed.in_words


def test_an_effect_of_the_other_device_is_refused_with_a_list():
    with pytest.raises(ValueError, match=r"found 'peltier_joule_heating', need one of .*creep.*none"):
        check_choice("peltier_joule_heating", "integrated")


def answer(*named, verdict="differs", pairs=(), not_excited=()):
    """A diagnosis that names effects, each (id, signal)."""
    return {
        "verdict": verdict,
        "summary": "They differ <most>.",
        "location": [{"signal": "tip_deflection", "share": 1.0, "branch": "both", "temperature_degC": None,
                      "frequency_hz": [1.0, 80.0]}],
        "effects": [
            {"id": name, "probability": 0.9, "statement": "Late.", "equation": "tau dx/dt = D - x", "signal": signal,
             "parameters": {"tau": {"value": 0.25, "std": 0.01, "unit": "s"}}} for name, signal in named
        ],
        "fit": {"tip_deflection": {"nrmse_before": 0.02, "nrmse_after": 0.002, "noise_floor": 0.001}},
        "indistinguishable": [list(pair) for pair in pairs],
        "not_excited": list(not_excited),
    }  # fmt: skip


CREEP = Concealed("creep", {"share": 0.06, "time_constant": 0.2})
LAG = Concealed("sensor_lag", {"time_constant": 0.01, "signal": "tip_deflection"})


@pytest.mark.parametrize(
    ("told", "concealed", "right", "limit"),
    [
        (answer(("creep", None)), CREEP, True, False),
        (answer(("creep", None), ("dead_time", None)), CREEP, False, False),
        (answer(("dead_time", None)), CREEP, False, False),
        (answer(("unknown", None)), CREEP, False, False),
        (answer(("sensor_lag", "film_resistance")), LAG, False, False),
        (answer(("sensor_lag", "tip_deflection")), LAG, True, False),
        (answer(("dead_time", None), pairs=[("dead_time", "creep")]), CREEP, False, True),
        (answer(("dead_time", None), not_excited=["creep"]), CREEP, False, True),
        (answer(verdict="agrees"), CREEP, False, False),
        (answer(verdict="agrees"), Concealed(), True, False),
        (answer(("creep", None)), Concealed(), False, False),
    ],
)
def test_an_answer_is_right_only_if_it_names_what_was_concealed_and_nothing_else(
    told, concealed, right, limit
):
    outcome = judge(told, concealed)
    assert (outcome.right, outcome.limit_stated) == (right, limit)
    assert (concealed.id or "nothing was concealed") in outcome.sentence
    assert outcome.sentence.startswith("Right") == right


def test_the_section_tells_verdict_place_physics_gain_and_last_the_truth():
    told = answer(("creep", None))
    text = diagnosis_section(told, CREEP, judge(told, CREEP), 5)
    places = [
        text.index(part)
        for part in ("They differ &lt;most&gt;", "80", "tau dx/dt", "0.25", "2.000", "Right:")
    ]
    assert places == sorted(places)
    assert "0.200" in text
    assert "share 0.06" in text


@pytest.fixture
def stage(tmp_path):
    graph = Graph(1, tmp_path / "logs")
    graph.log_folder.mkdir()
    return Stage(tmp_path, "integrated", 3, "creep", graph, None)


def test_recorders_end_before_what_they_still_hear(tmp_path):
    program = (
        "import signal, sys, time\n"
        "def end(*_):\n"
        "    print(time.monotonic(), flush=True)\n"
        "    time.sleep(float(sys.argv[1]))\n"
        "    print(time.monotonic(), flush=True)\n"
        "    sys.exit()\n"
        "signal.signal(signal.SIGINT, end)\n"
        "print('ready', flush=True)\n"
        "time.sleep(60)\n"
    )
    graph = Graph(1, tmp_path)
    for executable, lag in (("record", "0.5"), ("estimator", "0")):
        log = tmp_path / executable
        with log.open("wb") as stream:
            process = subprocess.Popen([sys.executable, "-c", program, lag], stdout=stream)
        graph.processes.append(NodeProcess(executable, process, log, executable))
    while not all("ready" in each.log.read_text() for each in graph.processes):
        time.sleep(0.01)
    graph.end()
    (_, recorded), (told, _) = (
        [float(line) for line in (tmp_path / name).read_text().split()[1:]]
        for name in ("record", "estimator")
    )
    assert recorded < told and not graph.processes


def test_a_diagnosis_that_fails_is_told_with_its_own_words(stage, tmp_path):
    stage.diagnosing = start_diagnosis(stage, tmp_path / "no_bag", conceal("creep", "integrated", 3))
    act("diagnosis")(stage)
    assert re.search(r"diagnose ended with status 2: .*model\.yaml", stage.failures[0])
    assert "FAILED" in stage.sections[0]
    assert stage.metrics["diagnosis"]["failed"]


def test_a_change_that_cannot_be_recorded_leaves_a_section_a_metric_and_a_failure(stage):
    act("change")(stage)
    act("diagnosis")(stage)
    assert "model.yaml" in stage.failures[0] and len(stage.failures) == 1
    assert "FAILED" in stage.sections[0]
    assert stage.metrics["diagnosis"]["failed"]
    assert list(stage.metrics["diagnosis"]["concealed"]) == ["creep"]


def test_an_interrupt_after_some_devices_loses_none_of_them(tmp_path, monkeypatch):
    def errors(_device, seed):
        if seed == 3:
            raise KeyboardInterrupt
        return {scheme: dict.fromkeys(("random", "steps", "sine", "multisine"), float(seed))
                for scheme in seeds.SCHEMES}  # fmt: skip

    monkeypatch.setattr(seeds, "device_errors", errors)
    with pytest.raises(KeyboardInterrupt):
        seeds.run_seeds("integrated", range(1, 9), tmp_path, lambda _text: None)
    kept = json.loads((tmp_path / "seeds.json").read_text())
    assert [each["composite"]["sine"] for each in kept["devices"]] == [1.0, 2.0]
    assert kept["summary"]["composite"]["sine"] == {"mean": 1.5, "std": 0.7071, "largest": 2.0}
