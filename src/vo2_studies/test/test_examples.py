"""The examples: what is held out, the yardstick, and one case from its file to its error."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from vo2_models.device import preset
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_studies.examples.cases import Case, Example, held_out, read_examples
from vo2_studies.examples.command import main
from vo2_studies.examples.conditions import AGREEMENT, agreement, ask, read_conditions
from vo2_studies.examples.plain_preisach import plain_preisach
from vo2_studies.examples.run import run_case

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def _signal(count: int) -> tuple[np.ndarray, np.ndarray]:
    phase = np.arange(count) / 120
    volts = 5.0 * (1.0 - np.linspace(1.0, 0.4, count) * np.cos(2 * np.pi * (phase + 0.15 * np.sin(phase))))
    high, low = np.tril_indices(25)
    law = PreisachOperator(np.linspace(0.0, 10.0, 26), np.exp(-0.5 * ((high - low - 4) / 3) ** 2) * 1e-7)
    return volts, law(volts)


def test_every_example_has_a_device_file_and_a_map():
    examples = read_examples(EXAMPLES)
    assert {one.folder.name for one in examples} >= {"magnetic_forc", "piezo", "seal_friction", "vo2_sweep"}
    for one in examples:
        assert preset(one.folder / "device.yaml").id == one.folder.name
        assert (one.folder / "map.yaml").is_file()
        assert all(bool(case.hold) != bool(case.predict) for case in one.cases)


def test_what_is_held_out():
    drive = np.tile([1.0, 0.1, 0.4, 0.7], 4)
    assert held_out(drive, {"after": 0.75}).tolist() == [False] * 12 + [True] * 4
    assert held_out(drive, {"blocks": 2, "of": 4}).tolist() == ([False] * 4 + [True] * 4) * 2
    assert held_out(drive, {"curves": 2}).tolist() == ([True] * 4 + [False] * 4) * 2
    with pytest.raises(ValueError, match="need one of after, blocks, curves"):
        held_out(drive, {"some": 1})


def test_the_yardstick_finds_its_own_kind():
    volts, values = _signal(700)
    hidden = np.arange(700) > 500
    found = plain_preisach([volts], [values], [hidden], 0.01)
    assert found.error < 0.01 * np.ptp(values) and found.lag_s == 0.0


def test_a_case_from_its_file_to_its_error(tmp_path):
    volts, values = _signal(700)
    rows = np.column_stack([volts, 1e6 * values + np.random.default_rng(1).normal(0, 1e-3, 700)])
    (tmp_path / "data").mkdir()
    np.savetxt(tmp_path / "data" / "rig.dat", rows)
    folder = tmp_path / "rig"
    folder.mkdir()
    (folder / "device.yaml").write_text(
        "schema: vo2-device/1\nid: rig\ndrive: {channel: v, unit: V, limits: [0, 10]}\nresponses: {x: {unit: m}}\n"
    )
    (folder / "map.yaml").write_text(
        "files: rig.dat\nformat: csv\ndelimiter: whitespace\ndevice: device.yaml\ntime: {rate_hz: 100}\n"
        "channels:\n  v: {column: 1, unit: V}\n  x: {column: 2, unit: um}\n"
    )
    case = Case(("rig.dat",), (), {"after": 0.7})
    outcome = run_case(Example(folder, "A rig", "", (case,)), case, tmp_path / "data", tmp_path / "out")
    assert outcome.samples == 210 and outcome.error < 0.02 * outcome.span
    assert {path.name for path in (tmp_path / "out" / "rig_rig").iterdir()} == {
        "calibration", "draft.yaml", "model.yaml", "report.html",
    }  # fmt: skip


def test_the_command_without_data(tmp_path, capsys):
    assert main(["--output", str(tmp_path), "--data", str(tmp_path / "nowhere")]) == 2
    assert "nowhere, need the folder of measured recordings" in capsys.readouterr().err
    assert main(["--output", str(tmp_path), "--data", str(tmp_path), "--only", "nothing"]) == 2
    assert "--only: found 'nothing'" in capsys.readouterr().err


def _said(verdict, *effects):
    return SimpleNamespace(
        verdict=verdict, effects=[SimpleNamespace(id=name, family=family) for name, family in effects]
    )


def test_how_an_answer_stands_to_an_experts():
    conditions = {one.id: one for one in read_conditions(EXAMPLES / "conditions.yaml")}
    rerun, pulses = conditions["seal_rerun"], conditions["vo2_pulse_amplitude"]
    drift = conditions["magnetometer_drift"]
    for condition, said, word in (
        (rerun, _said("agrees"), "same"),
        (rerun, _said("drifted"), "another verdict"),
        (rerun, _said("differs", ("creep", "structure")), "wrong name"),
        (pulses, _said("differs", ("log_creep", "structure")), "same"),
        (pulses, _said("differs", ("creep", "structure")), "wrong name"),
        (pulses, _said("differs", ("unknown", "heat")), "unknown, same family"),
        (pulses, _said("differs", ("unknown", "drive")), "another family"),
        (drift, _said("agrees"), "same"),
        (drift, _said("drifted"), "another verdict"),
        (drift, _said("differs", ("unknown", "sensor:moment")), "another verdict"),
        (drift, _said("differs", ("sensor_gain_drift", "sensor:moment")), "wrong name"),
    ):
        assert agreement(condition, said) == word
        assert word in AGREEMENT


def test_an_expert_does_not_take_both_that_something_differs_and_that_nothing_does():
    for one in read_conditions(EXAMPLES / "conditions.yaml"):
        assert "differs" not in one.verdict or one.verdict == ("differs",), one.id
        assert "differs" in one.verdict or (not one.names and not one.families), one.id


def test_a_condition_without_a_drive_is_not_asked(tmp_path):
    (tmp_path / "vo2_device").mkdir()
    (tmp_path / "vo2_device" / "relaxation_timescales.xlsx").touch()
    (condition,) = (
        one for one in read_conditions(EXAMPLES / "conditions.yaml") if one.id == "vo2_relaxation_depth"
    )
    found = ask(condition, read_examples(EXAMPLES), tmp_path, tmp_path / "out")
    assert found.agreement == "not asked" and "has no column for a drive" in found.said
