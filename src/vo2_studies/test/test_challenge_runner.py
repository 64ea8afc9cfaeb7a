"""The blind protocol with stand-in programs for fit and diagnose: isolation, failures, resuming, the command line."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from vo2_identification.bags import raw_messages, read_recording
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION
from vo2_studies.challenge import command
from vo2_studies.challenge.draw import draw_case
from vo2_studies.challenge.plan import Choice, plan_case
from vo2_studies.challenge.runner import CaseRunner, Paths, Settings, finished, load_json, write_case

FIT = """
import sys, pathlib
a = sys.argv
assert a[1::2] == ["--bag", "--device", "--output"], a
assert pathlib.Path(a[2], "metadata.yaml").exists()
pathlib.Path(a[6]).write_text("model")
"""
DIAGNOSE = """
import sys, json, pathlib
a = sys.argv
assert pathlib.Path("model.yaml").exists() and pathlib.Path("test/metadata.yaml").exists()
here = pathlib.Path.cwd()
assert not list(here.rglob("*answer*")), "the answer lies open"
out = pathlib.Path(a[a.index("--output") + 1]); out.mkdir()
bags = a.count("--bag")
(out / "diagnosis.json").write_text(json.dumps({"schema": "vo2-diagnosis/1", "verdict": "differs", "location": [],
  "effects": [{"id": "creep" if bags > 1 else "dead_time", "probability": 1, "parameters": {}}],
  "candidates": [], "fit": {}, "indistinguishable": [["creep", "dead_time"]],
  "next_experiment": {"why": "", "separates": ["creep", "dead_time"], "kind": "excitation", "instruction": "",
                      "excitation": {"kind": "levels", "levels_a": [0.004, 0.006], "hold_s": 0.05}}}))
with open(here.parent.parent / "count.txt", "a") as f: f.write("x")
"""


def program(folder, name, text):
    file = folder / name
    file.write_text(text)
    return (sys.executable, str(file))


@pytest.fixture
def runner(tmp_path):
    def make(fit=FIT, diagnose=DIAGNOSE, **options):
        programs = tmp_path / "programs"
        programs.mkdir(exist_ok=True)
        return CaseRunner(
            Settings(3),
            Paths(tmp_path / "run"),
            fit=program(programs, "fit.py", fit),
            diagnose=program(programs, "diagnose.py", diagnose),
            **options,
        )

    return make


PLAN = plan_case(3, 1, Choice("plays", kinds=("one",)))


def test_case_runs_blindly_and_is_kept(runner):
    blind = runner(keep_bags=True)
    result = blind.run(PLAN)
    assert result["failure"] == ""
    assert result["diagnosis"]["effects"][0]["id"] == "dead_time"
    assert result["seconds"] > 0
    assert finished(blind.paths, PLAN.index)
    answer = load_json(blind.paths.answer(PLAN.index))
    assert [effect["id"] for effect in answer["effects"]] == list(PLAN.effects)
    recording, problems = read_recording(blind.paths.case(PLAN.index) / "test")
    assert len(recording) == 10_000
    assert not problems
    # nothing that the diagnosing process is given names the effect
    for file in blind.paths.case(PLAN.index).rglob("*"):
        if file.is_file():
            assert PLAN.effects[0].encode() not in file.read_bytes()


def test_finished_case_is_not_run_again_and_bags_go(runner):
    blind = runner()
    blind.run(PLAN)
    assert not (blind.paths.case(PLAN.index) / "test").exists()
    again = runner(diagnose="raise SystemExit(9)").run(PLAN)
    assert again["failure"] == ""
    assert (blind.paths.root / "count.txt").read_text() == "x"


@pytest.fixture(scope="module")
def strange_rig():
    """A rig that is no preset, in each of the conditions that change what is in a bag."""
    return {
        condition: (plan, draw_case(3, plan))
        for condition in ("late", "rates", "missing")
        for plan in [plan_case(3, 0, Choice("plays", kinds=("always",), condition=condition, rigs="range"))]
    }


@pytest.mark.parametrize("condition", ["late", "rates", "missing"])
def test_bags_hold_what_the_rig_recorded(tmp_path, strange_rig, condition):
    plan, case = strange_rig[condition]
    paths = Paths(tmp_path)
    assert write_case(case, paths) == "device.yaml"
    recording, problems = read_recording(paths.case(plan.index) / "test")
    measured = case.test.measurement
    assert np.allclose(recording.time_s, measured.time_s, atol=1e-9)
    for name in (RESISTANCE, TIP_DEFLECTION):
        assert np.array_equal(np.isnan(recording[name]), np.isnan(measured[name]))
        assert np.allclose(recording[name], measured[name], rtol=1e-12, equal_nan=True)
    kinds = {problem.kind for problem in problems}
    assert "nan" not in kinds, "a sample that was not taken is absent, not a number"
    if condition == "late":
        messages = raw_messages(paths.case(plan.index) / "test", [])
        stamps = [m.log_time_ns / 1e9 for m in messages if m.channel.topic == "/vo2/command"]
        assert np.allclose(stamps, case.test.commands[0], atol=1e-9)
    document = yaml.safe_load((paths.case(plan.index) / "device.yaml").read_text())
    assert document["schema"] == "vo2-device/1"
    assert document["id"] == recording.device == case.preset.name
    assert document["body"]["time_constant"] == case.preset.time_constant


def test_the_device_file_is_one(tmp_path, strange_rig):
    """`fit` gets as far as the recording with it: what it refuses is the bag, not the device."""
    plan, case = strange_rig["late"]
    write_case(case, Paths(tmp_path))
    device = tmp_path / "cases" / f"{plan.index:04d}" / "device.yaml"
    done = subprocess.run(
        [sys.executable, "-m", "vo2_identification.fit", "--bag", "nowhere", "--device", device, "--output", "m.yaml"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "nowhere" in done.stderr
    assert "device" not in done.stderr


def test_an_old_effect_is_looked_for_with_the_calibration(runner):
    wants = (
        "import sys\nassert sys.argv[sys.argv.index('--calibration') + 1] == 'calibration', sys.argv\n"
        "assert sys.argv.count('--bag') == 1\n" + DIAGNOSE
    )
    plan = plan_case(3, 0, Choice("plays", kinds=("always",)))
    assert runner(diagnose=wants).run(plan)["failure"] == ""
    assert runner(diagnose=wants).run(PLAN)["failure"] == "diagnose: exit status 1"


def test_failures_are_recorded(runner, tmp_path):
    cases = {
        "fit: exit status 2": {"fit": "raise SystemExit(2)"},
        "fit: wrote no model": {"fit": "pass"},
        "diagnose: exit status 1": {"diagnose": "raise SystemExit(1)"},
        "diagnose: wrote no diagnosis.json": {"diagnose": "pass"},
        "diagnose: diagnosis.json is not JSON": {
            "diagnose": "import os; os.mkdir('diagnosis'); open('diagnosis/diagnosis.json', 'w').write('{')"
        },
        "diagnose: diagnosis.json lacks": {
            "diagnose": "import os; os.mkdir('diagnosis');"
            """open('diagnosis/diagnosis.json', 'w').write('{"schema": "vo2-diagnosis/1"}')"""
        },
    }
    for reason, programs in cases.items():
        blind = runner(**programs)
        result = blind.run(PLAN)
        assert result["failure"].startswith(reason)
        assert result["diagnosis"] is None
        blind.paths.result(PLAN.index).unlink()


def test_timeout_ends_the_process_and_its_children(runner, tmp_path):
    text = (
        "import subprocess, sys, time, pathlib\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        f"pathlib.Path({str(tmp_path / 'child')!r}).write_text(str(child.pid))\ntime.sleep(60)\n"
    )
    start = time.monotonic()
    result = runner(diagnose=text, timeout_s=2.0).run(PLAN)
    assert result["failure"] == "diagnose: no result within 2 s"
    assert time.monotonic() - start < 20
    child = int((tmp_path / "child").read_text())
    for _ in range(50):
        state = Path(f"/proc/{child}/stat")
        if not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z":
            break
        time.sleep(0.1)
    else:
        raise AssertionError("the child still runs")


def test_proposed_experiment_is_played_on_the_concealed_device(runner):
    plan = plan_case(3, 0, Choice("plays", only_effects=("creep",), device="integrated"))
    result = runner(follow_up=True).run(plan)
    assert result["follow_up_failure"] == ""
    assert result["follow_up"]["effects"][0]["id"] == "creep"


def arguments(folder, *more):
    return ["--cases", "4", "--seed", "3", "--output", str(folder), "--samples", "2000", *more]


def stand_in(monkeypatch, runner):
    """Let the command line use the stand-in programs."""

    def make(settings, paths, **options):
        blind = runner(**options)
        blind.settings, blind.paths = settings, paths
        return blind

    monkeypatch.setattr(command, "CaseRunner", make)


def test_command_scores_and_continues(runner, monkeypatch, tmp_path, capsys):
    stand_in(monkeypatch, runner)
    folder = tmp_path / "out"
    assert command.main(arguments(folder, "--jobs", "2")) == 0
    printed = capsys.readouterr()
    assert "[4/4]" in printed.err and "left" in printed.err
    assert "change since calibration: right first name" in printed.out
    scores = load_json(folder / "challenge.json")
    assert scores["cases"] == 4
    assert scores["false_alarm"] == 1.0
    assert scores["drawn"]["choice"]["family"] == "all"
    assert "<html" in (folder / "challenge.html").read_text()
    count = len((folder / "count.txt").read_text())
    assert count == 4
    # a longer run keeps what is there
    longer = arguments(folder)
    longer[1] = "5"
    assert command.main(longer) == 0
    assert "4 finished cases kept" in capsys.readouterr().err
    assert len((folder / "count.txt").read_text()) == 5
    # a case without result is run again, the others are not
    (folder / "results" / "0002.json").unlink()
    assert command.main(longer) == 0
    assert len((folder / "count.txt").read_text()) == 6
    other = arguments(folder)
    other[3] = "4"
    assert command.main(other) == 2
    assert "another seed" in capsys.readouterr().err
    # settings that are younger than the folder have their defaults there
    settings = load_json(folder / "settings.json")
    del settings["choice"]["excitation"], settings["choice"]["kinds"]
    (folder / "settings.json").write_text(json.dumps(settings))
    assert command.main(longer) == 0
    assert command.main([*longer, "--excitation", "triangle"]) == 2
    assert "another excitation" in capsys.readouterr().err


def test_quick_is_one_round_of_short_recordings(runner, monkeypatch, tmp_path):
    folder = tmp_path / "out"
    stand_in(monkeypatch, lambda **options: runner(fit="raise SystemExit(2)", **options))
    monkeypatch.setattr(command, "ROUND", ("none",))  # all sixteen would take a minute to draw
    assert command.main(["--quick", "--seed", "3", "--output", str(folder)]) == 0
    assert load_json(folder / "challenge.json")["cases"] == 1
    assert load_json(folder / "answers" / "0000.json")["samples"] == command.QUICK_SAMPLES
    assert command.main(["--seed", "3", "--output", str(folder)]) == 2


def test_failed_cases_are_tried_again_on_request(runner, monkeypatch, tmp_path):
    folder = tmp_path / "out"
    stand_in(monkeypatch, lambda **options: runner(fit="raise SystemExit(2)", **options))
    short = ["--cases", "1", "--seed", "3", "--output", str(folder), "--samples", "2000"]
    assert command.main(short) == 0
    assert load_json(folder / "challenge.json")["failures"] == {"fit: exit status 2": 1}
    stand_in(monkeypatch, runner)
    assert command.main(short) == 0
    assert load_json(folder / "challenge.json")["failures"]
    assert command.main([*short, "--retry-failed"]) == 0
    assert not load_json(folder / "challenge.json")["failures"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--cases", "0"], "cases"),
        (["--device", "toaster"], "device"),
        (["--only-effects", "perpetual_motion"], "effect"),
        (["--misfit", "0.9"], "misfit"),
        (["--family", "balls"], "family"),
        (["--kinds", "three"], "kinds"),
        (["--leave-out", "balls"], "leave-out"),
        (["--condition", "rain"], "condition"),
        (["--excitation", "dance"], "excitation"),
        (["--samples", "many"], "samples"),
        (["--rigs", "toys"], "rigs"),
    ],
)
def test_unusable_arguments(tmp_path, capsys, change, message):
    assert command.main([*arguments(tmp_path / "out"), *change]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_interrupted_run_leaves_no_process_and_continues(tmp_path):
    """SIGTERM while a diagnosis runs: exit 130, its process ended, the case not finished."""
    slow = tmp_path / "slow.py"
    mark = tmp_path / "pid"
    slow.write_text(f"import os, time\nopen({str(mark)!r}, 'w').write(str(os.getpid()))\ntime.sleep(60)\n")
    main = tmp_path / "main.py"
    main.write_text(
        "import sys\nfrom vo2_studies.challenge import command\n"
        "from vo2_studies.challenge.runner import CaseRunner\n"
        "def make(*a, **k):\n"
        f"    return CaseRunner(*a, fit=(sys.executable, {str(slow)!r}), **k)\n"
        "command.CaseRunner = make\n"
        f"sys.exit(command.main({arguments(tmp_path / 'out')!r}))\n"
    )
    process = subprocess.Popen([sys.executable, str(main)], stderr=subprocess.PIPE, text=True)
    try:
        for _ in range(600):
            assert process.poll() is None
            if mark.exists() and mark.read_text():
                break
            time.sleep(0.1)
        process.send_signal(signal.SIGTERM)
        _, error = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "the same command continues" in error
    with pytest.raises(ProcessLookupError):
        os.kill(int(mark.read_text()), 0)
    assert not (tmp_path / "out" / "results" / "0000.json").exists()
    assert json.loads((tmp_path / "out" / "settings.json").read_text())["seed"] == 3


def test_bags_only_writes_bags_and_answers(tmp_path):
    folder = tmp_path / "out"
    assert command.main(["--cases", "1", "--seed", "3", "--output", str(folder), "--bags-only"]) == 0
    recording, problems = read_recording(folder / "cases" / "0000" / "calibration")
    assert len(recording) > 5000 and not problems
    assert load_json(folder / "answers" / "0000.json")["kind"] == "none"
    # bags from an earlier session do not count as results
    assert not finished(Paths(folder), 0)
