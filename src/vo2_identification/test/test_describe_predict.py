"""A rig of one's own from the bag on: drafted, fitted, predicted; the commands as a person calls them."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import yaml
from vo2_identification.bags import read_bag, write_bag
from vo2_models.device import DeviceModel, preset
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.prediction import predict as predicted
from vo2_models.recording import Recording

import vo2_models as vo2
from vo2_identification import describe, fit, predict

DT = 0.02


def _rig(count: int = 900) -> Recording:
    phase = np.arange(count) / 150
    volts = 30.0 * (1.0 - np.linspace(1.0, 0.3, count) * np.cos(2 * np.pi * (phase + 0.15 * np.sin(phase))))
    walls = np.linspace(0.0, 60.0, 21)
    high, low = np.tril_indices(20)
    law = PreisachOperator(walls, np.exp(-0.5 * ((high - low - 3) / 3) ** 2) * 1e-8)
    noise = np.random.default_rng(5).normal(0.0, 2e-8, count)
    return Recording(
        DT * np.arange(count), {"drive_voltage": volts, "extension": law(volts) + noise}, "rigs/stack_07.yaml"
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the bag of a rig, the drafted device file, and the model fitted with it."""
    place = tmp_path_factory.mktemp("rig")
    write_bag(place / "bag", _rig())
    assert describe.main(["--bag", str(place / "bag"), "--output", str(place / "device.yaml")]) == 0
    arguments = ["--bag", str(place / "bag"), "--device", str(place / "device.yaml"), "--quiet"]
    assert fit.main([*arguments, "--output", str(place / "model.yaml")]) == 0
    return place


def test_the_draft_is_a_device_file(folder):
    text = (folder / "device.yaml").read_text(encoding="utf-8")
    device = preset(folder / "device.yaml")
    assert device.id == "stack_07" and device.names["heater_current"] == "drive_voltage"
    assert device.units == {"heater_current": "V", "tip_deflection": "m"}
    recording = _rig()
    assert device.deflection_range == pytest.approx(np.ptp(recording["extension"]), rel=1e-3)
    assert device.noise["tip_deflection"] == pytest.approx(2e-8, rel=0.3)
    assert device.sample_period == pytest.approx(DT)
    assert "# drive: drive_voltage was taken for the drive" in text
    assert "# units were taken from the names, check them: drive_voltage in V, extension in m" in text


def test_a_drafted_heater_heats_by_the_square_of_its_current(tmp_path, capsys):
    current = 3.68e-3 + 4.81e-3 * np.repeat(vo2.damped_oscillation(np.linspace(0.0, 1.0, 13)), 10)
    write_bag(tmp_path / "bag", vo2.simulate("integrated", current, seed=1))
    assert describe.main(["--bag", str(tmp_path / "bag"), "--output", str(tmp_path / "device.yaml")]) == 0
    device = preset(tmp_path / "device.yaml")
    assert device.linear_gain == 0.0 and device.square_gain * current.max() ** 2 == pytest.approx(
        75.0, rel=0.01
    )
    assert "body: the heat was taken to go as the square" in (tmp_path / "device.yaml").read_text(
        encoding="utf-8"
    )
    arguments = ["--bag", str(tmp_path / "bag"), "--device", str(tmp_path / "device.yaml"), "--quiet"]
    assert fit.main([*arguments, "--simulation-only", "--output", str(tmp_path / "model.yaml")]) == 0
    sensors = vo2.load_model_parameters(tmp_path / "model.yaml")
    # heat that goes as the current left 19 times the noise
    residual, noise = (sensors[f"model.sensors.film_resistance.{key}"] for key in ("residual", "noise"))
    assert residual < 4.0 * noise


def test_drafting_says_how_far_it_is(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(describe, "_EVERY_S", 0.0)
    write_bag(tmp_path / "bag", _rig(600))
    assert describe.main(["--bag", str(tmp_path / "bag")]) == 0
    told = capsys.readouterr()
    assert "extension:\n" in told.out
    shares = [
        int(line.split("%")[0].split()[-1]) for line in told.err.splitlines() if "lag and delay" in line
    ]
    assert len(shares) >= 3 and shares == sorted(shares) and shares[-1] > shares[0]


def test_the_draft_marks_what_it_could_not_know(tmp_path, capsys):
    recording = _rig(300)
    channels = {"knob": recording["drive_voltage"], "answer": recording["extension"]}
    write_bag(tmp_path / "bag", Recording(recording.time_s, channels, ""))
    assert describe.main(["--bag", str(tmp_path / "bag"), "--drive", "knob"]) == 0
    printed = capsys.readouterr().out
    document = yaml.safe_load(printed)
    assert document["drive"]["unit"] == document["responses"]["answer"]["unit"] == "?"
    assert "# answer: unit not known from the name: put one of m, s, A" in printed
    assert describe.main(["--bag", str(tmp_path / "bag"), "--drive", "nob"]) == 2
    assert "found knob, answer, need nob and a response" in capsys.readouterr().err


def test_a_bag_is_predicted_and_compared(folder, capsys):
    output = folder / "predicted"
    assert (
        predict.main(
            ["--model", str(folder / "model.yaml"), "--bag", str(folder / "bag"), "--output", str(output)]
        )
        == 0
    )
    printed = capsys.readouterr().out
    assert "% of the measured span" in printed and "within the bounds" in printed
    with (output / "prediction.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    measured = _rig()
    found = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    gap = measured["extension"] - found["extension"]
    assert np.sqrt(np.mean(gap**2)) < 0.02 * np.ptp(measured["extension"])
    inside = (measured["extension"] > found["extension_lower"]) & (
        measured["extension"] < found["extension_upper"]
    )
    assert inside.mean() > 0.9
    assert found["extension_measured"] == pytest.approx(measured["extension"])
    bag = read_bag(output / "bag", roles=("measurement",), channels=None)[0]["measurement"]
    assert bag["extension"] == pytest.approx(found["extension"]) and bag.device == "stack_07"
    page = (output / "report.html").read_text(encoding="utf-8")
    assert "drive_voltage" in page and page.count("<svg") == 1
    for text in (printed, page):  # nothing is promised that was not measured
        assert (
            "what the fit missed of held-out parts of its calibration" in text and "95 % bounds" not in text
        )


def test_a_prediction_stands_at_the_stamps_of_a_rig_that_counts_anew_behind_a_late_sample(folder):
    recording = _rig(400)
    late = np.cumsum(np.where(np.arange(400) % 20 == 19, 0.3 * DT, 0.0))
    stamps = recording.time_s + late
    model = DeviceModel.load(folder / "model.yaml")
    channels = {"drive_voltage": recording["drive_voltage"], "extension": recording["extension"]}
    rig = model.description.in_roles(Recording(stamps, channels, ""))
    assert predicted(model, rig).time_s == pytest.approx(stamps, abs=1e-9)
    assert late[-1] > 5.0 * DT


def test_a_table_and_a_written_drive_are_predicted(folder, tmp_path):
    table = tmp_path / "drive.csv"
    recording = _rig(200)
    lines = ["time_s,drive_voltage"] + [
        f"{t},{v}" for t, v in zip(recording.time_s, recording["drive_voltage"], strict=True)
    ]
    table.write_text("\n".join(lines), encoding="utf-8")
    common = ["--model", str(folder / "model.yaml"), "--output"]
    assert predict.main([*common, str(tmp_path / "one"), "--csv", str(table)]) == 0
    assert predict.main([*common, str(tmp_path / "two"), "--drive", "0,60,20,60,0", "--rate", "50"]) == 0
    assert predict.main([*common, str(tmp_path / "three"), "--drive", "-5,60,-5"]) == 0
    assert "held-out parts of its calibration" in (tmp_path / "three" / "report.html").read_text("utf-8")
    with (tmp_path / "two" / "prediction.csv").open(encoding="utf-8") as file:
        volts = [float(row["drive_voltage"]) for row in csv.DictReader(file)]
    assert max(volts) == 60.0 and len(volts) == pytest.approx(200 / 50 / DT, rel=0.05)


def test_what_cannot_be_predicted(folder, tmp_path, capsys):
    (tmp_path / "bad.csv").write_text("time_s,voltage\n0,1\n", encoding="utf-8")
    common = ["--model", str(folder / "model.yaml"), "--output", str(tmp_path / "out")]
    assert predict.main([*common, "--csv", str(tmp_path / "bad.csv")]) == 2
    assert "found the columns time_s, voltage, need time_s and drive_voltage" in capsys.readouterr().err
    assert predict.main([*common, "--drive", "0,up"]) == 2
    assert "--drive: found '0,up', need levels" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_recording_of_another_device_is_asked_after(folder, tmp_path, capsys):
    write_bag(
        tmp_path / "bag",
        Recording(_rig().time_s, {"film_resistance": 1e3 + _rig()["drive_voltage"]}, "other"),
    )
    command = [
        "--model",
        str(folder / "model.yaml"),
        "--bag",
        str(tmp_path / "bag"),
        "--output",
        str(tmp_path / "out"),
    ]
    assert predict.main(command) == 2
    said = "need drive_voltage, the drive of device stack_07: is it a recording of another device (it says other)?"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("drive", "response", "said"),
    [
        (1.0, -1.0, "extension runs against the simulation: is its sign reversed"),
        (1.0, 1e3, "check the unit (off by a factor of 1 000, "),
        (
            1e-3,
            1.0,
            "drive_voltage varies by 0.0585 V of an operating range of 58.5: check its unit (off by a factor of 1 000",
        ),
        (1.0, 1.0, ""),
    ],
)
def test_a_sign_and_a_unit_are_doubted_where_the_model_misses(folder, drive, response, said):
    model = DeviceModel.load(folder / "model.yaml")
    rig = _rig()
    channels = {"drive_voltage": drive * rig["drive_voltage"], "extension": response * rig["extension"]}
    found = predicted(model, model.description.in_roles(Recording(rig.time_s, channels)))
    told = predict.summary(found, model.description)[0]
    assert said in told and told.startswith("the recording does not fit the model: ") == bool(said)


@pytest.mark.parametrize("late", [-1, 0, 1])
def test_a_drive_that_is_stamped_at_the_other_end_of_its_interval_is_taken_so_and_told(late):
    model = DeviceModel("integrated", deflection=PlayBank([2e-5], [0.0], [0.2], [-12.4], [0.2], [-11.0]))
    share = np.repeat(np.random.default_rng(2).uniform(0.0, 1.0, 60), 10)
    current = 4e-3 + 4e-3 * share
    run = model.simulate(current, dt=1e-3, seed=3)
    stamped = np.roll(current, -late)
    given = Recording(
        1e-3 * np.arange(current.size),
        {"heater_current": stamped, "tip_deflection": run["tip_deflection"]},
        "integrated",
    )
    found = predicted(model, given)
    assert found.late == pytest.approx(late * 1e-3)
    np.testing.assert_array_equal(found.drive[1:-1], current[1:-1])  # what drove the model
    assert found.channels["tip_deflection"].error < 0.02 * found.channels["tip_deflection"].span
    told = " ".join(predict.summary(found, model.description))
    assert ("taken to act 0.001 s" in told) == (late != 0) and ("after where" in told) == (late > 0)


def test_a_drive_beyond_the_limits_is_told(folder, capsys):
    model = str(folder / "model.yaml")
    for levels, beyond in (("0,30,0", False), ("0,1e6,0", True)):
        output = str(folder / f"drive_{beyond}")
        assert predict.main(["--model", model, "--drive", levels, "--output", output]) == 0
        assert ("drive_voltage: from 0 to 1e+06 V, beyond the limits" in capsys.readouterr().out) is beyond


def test_a_recording_of_another_shipped_device_is_refused(folder, tmp_path, capsys):
    write_bag(tmp_path / "bag", replace(_rig(), device="peltier"))
    arguments = ["--model", str(folder / "model.yaml"), "--bag", str(tmp_path / "bag")]
    assert predict.main([*arguments, "--output", str(tmp_path / "out")]) == 2
    assert "was recorded on device 'peltier', the model is of 'stack_07'" in capsys.readouterr().err


def test_ctrl_c_ends_a_draft_with_one_line_and_status_130(monkeypatch, tmp_path, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(describe, "_text", interrupted)
    assert describe.main(["--bag", "bag", "--output", str(tmp_path / "device.yaml"), "--quiet"]) == 130
    assert capsys.readouterr().err == "describe: interrupted; nothing is written\n"
    assert not (tmp_path / "device.yaml").exists()
