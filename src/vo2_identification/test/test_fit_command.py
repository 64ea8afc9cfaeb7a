"""`fit` from bag to model file, and what it says to bad input."""

import re

import numpy as np
import pytest
from vo2_identification.bags import read_recording, write_bag
from vo2_identification.fit import main
from vo2_models.device import DeviceModel, truth
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.model_file import load_model_parameters
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    current = np.repeat(damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 16)), 10)
    path = tmp_path_factory.mktemp("bags") / "calibration"
    write_bag(path, truth("integrated", seed=2).simulate(current, seed=1))
    return path


def test_bag_to_model_file(bag, tmp_path, capsys):
    output = tmp_path / "model.yaml"
    arguments = [
        "--bag",
        str(bag),
        "--device",
        "integrated",
        "--output",
        str(output),
        "--plays",
        "8",
    ]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert "tip_deflection: residual" in printed.out and str(output) in printed.out
    shown = printed.err.splitlines()
    assert len(shown) > 3 and all(
        re.fullmatch(r"fit: +\d+ %  .*, about \d+ s left", line) for line in shown[1:]
    )
    model = DeviceModel.load(output)
    current = np.repeat(random_levels(3.68e-3, 8.49e-3, 100, seed=9), 10)
    device = truth("integrated", seed=2).simulate(current, noise=False)
    gap = model.simulate(current, noise=False)[TIP_DEFLECTION] - device[TIP_DEFLECTION]
    assert np.mean(np.abs(gap)) < 0.01 * 57.03e-6
    parameters = load_model_parameters(output)
    assert parameters["model.device"] == "integrated"
    assert any(name.startswith("model.self_sensing.") for name in parameters)
    assert any(name.startswith("model.uncertainty.resistance.") for name in parameters)


def _refused(capsys, *arguments: str) -> str:
    assert main(list(arguments)) == 2
    error = capsys.readouterr().err
    message = error.strip().splitlines()[-1]
    assert message.startswith("fit: ")
    return message


def test_bad_input(bag, tmp_path, capsys):
    output = str(tmp_path / "model.yaml")
    assert "nowhere" in _refused(capsys, "--bag", str(bag), "--device", "nowhere", "--output", output)
    other = _refused(capsys, "--bag", str(bag), "--device", "peltier", "--output", output)
    assert "--device integrated" in other
    assert "absent" in _refused(
        capsys, "--bag", str(tmp_path / "absent"), "--device", "integrated", "--output", output
    )
    time = 1e-3 * np.arange(2000, dtype=np.float64)
    noise = np.random.default_rng(0).standard_normal(time.size)
    cases = {
        "constant": (
            {HEATER_CURRENT: np.full(time.size, 5e-3), RESISTANCE: 1e5 * np.exp(0.01 * noise)},
            "operating range",
        ),
        "blind": ({HEATER_CURRENT: np.linspace(4e-3, 8e-3, time.size)}, "film_resistance"),
    }
    for name, (channels, word) in cases.items():
        write_bag(tmp_path / name, Recording(time, channels, "integrated"))
        message = _refused(
            capsys, "--bag", str(tmp_path / name), "--device", "integrated", "--output", output
        )
        assert word in message
    assert not (tmp_path / "model.yaml").exists()


def test_another_law_has_its_own_plays_and_leaves_self_sensing_alone(bag, tmp_path, capsys):
    output = tmp_path / "model.yaml"
    arguments = ["--bag", str(bag), "--device", "integrated", "--output", str(output), "--quiet"]
    assert main([*arguments, "--law", "gpi", "--plays", "4"]) == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("self-sensing: law")]
    assert "law gpi is that of the simulation" in said and "does not depend on --law" in said
    assert said.endswith("(composite: 24 plays)")
    parameters = load_model_parameters(output)
    for section, count in (("resistance", 4), ("deflection", 4), ("self_sensing.composite.deflection", 24)):
        assert np.size(parameters[f"model.{section}.weights"]) == count
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "estimate of the estimator does not depend on LAW" in " ".join(capsys.readouterr().out.split())


_BODYLESS = """
schema: vo2-device/1
id: stack
drive: {channel: drive_voltage, unit: V, limits: [0.0, 60.0]}
responses: {extension: {unit: m}}
"""


def test_plays_are_refused_where_there_is_no_number_of_them(bag, tmp_path, capsys):
    (tmp_path / "stack.yaml").write_text(_BODYLESS)
    plays = ["--bag", str(bag), "--output", str(tmp_path / "model.yaml"), "--plays", "6", "--device"]
    for given, words in (
        (
            ["integrated", "--law", "preisach"],
            "law preisach on device integrated, need one of --law gpi, egpi, plays, auto",
        ),
        (
            [str(tmp_path / "stack.yaml")],
            "the law that held-out parts choose on device stack, need one of --law gpi, egpi;",
        ),
    ):
        assert f"--plays: found 6 with {words}" in _refused(capsys, *plays, *given)
    folder = ["--bags", str(tmp_path), "--output", str(tmp_path / "out"), "--device"]
    assert "--plays: found 6" in _refused(capsys, *folder, str(tmp_path / "stack.yaml"), "--plays", "6")
    with pytest.raises(SystemExit):
        main([*folder, "integrated", "--law", "gpi"])
    assert "--law is of --bag" in capsys.readouterr().err


def test_unwritable_output(bag, capsys, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    output = str(tmp_path / "file" / "model.yaml")
    arguments = ["--bag", str(bag), "--device", "integrated", "--output", output, "--plays", "2", "--quiet"]
    assert "cannot be written" in _refused(capsys, *arguments)


def test_a_place_that_cannot_be_written_is_told_before_the_work(capsys, tmp_path, monkeypatch):
    def work(*_arguments, **_options):
        raise AssertionError("worked before it looked at the place")

    monkeypatch.setattr("vo2_identification.bags.read_recording", work)
    device = ["--bag", str(tmp_path / "bag"), "--device", "integrated", "--output"]
    assert "is a folder, need the name of a file" in _refused(capsys, *device, str(tmp_path))
    (tmp_path / "file").write_text("not a folder")
    message = _refused(capsys, *device, str(tmp_path / "file" / "deeper" / "model.yaml"))
    assert "cannot be written" in message


def test_a_wrong_unit_makes_no_model(bag, capsys, tmp_path):
    recording, _ = read_recording(bag)
    milli = {**recording.channels, HEATER_CURRENT: 1e3 * recording[HEATER_CURRENT]}
    write_bag(tmp_path / "milli", Recording(recording.time_s, milli, recording.device))
    output = str(tmp_path / "model.yaml")
    device = ["--device", "integrated", "--output", output]
    message = _refused(capsys, "--bag", str(tmp_path / "milli"), *device)
    assert "milli: heater_current runs from" in message and "off by a factor of 1 000, " in message
    assert not (tmp_path / "model.yaml").exists()


def test_a_recording_of_gaps_is_refused_and_fitted_where_one_insists(bag, capsys, tmp_path):
    whole = read_recording(bag)[0]
    kept = np.random.default_rng(5).uniform(size=len(whole)) < 0.7
    channels = {name: values[kept] for name, values in whole.channels.items()}
    write_bag(tmp_path / "lossy", Recording(whole.time_s[kept], channels, "integrated"))
    output = tmp_path / "model.yaml"
    arguments = ["--bag", str(tmp_path / "lossy"), "--device", "integrated", "--output", str(output)]
    assert "of the recording, need at most 30 % (fit: --gap-limit)" in _refused(capsys, *arguments)
    assert not output.exists()
    assert main([*arguments, "--plays", "4", "--simulation-only", "--gap-limit", "0.7"]) == 0
    assert "% of the time: where no command is known" in capsys.readouterr().out and output.exists()
    for wrong in (["--gap-limit", "30"], ["--bags", str(tmp_path), "--gap-limit", "0.5"]):
        given = wrong if "--bags" in wrong else [*arguments[:2], *wrong]
        with pytest.raises(SystemExit):
            main([*given, *arguments[2:]])
        assert "--gap-limit" in capsys.readouterr().err


def test_interrupting_is_one_line(bag, capsys, tmp_path, monkeypatch):
    def interrupt(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("vo2_models.identification.model_fit.fit_device", interrupt)
    output = str(tmp_path / "model.yaml")
    assert main(["--bag", str(bag), "--device", "integrated", "--output", output, "--quiet"]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"fit: interrupted; {output} is not written"
    assert not (tmp_path / "model.yaml").exists()
