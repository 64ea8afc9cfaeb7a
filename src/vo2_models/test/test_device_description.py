"""A device is a file: what it says is what the code knows of it, what it leaves open is derived, what is wrong is told."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from vo2_models.device import (
    PRESETS,
    DeviceModel,
    preset,
    surrogate_of_temperature,
    temperature_of_surrogate,
    truth,
)
from vo2_models.device.description import described
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

STACK = {
    "schema": "vo2-device/1",
    "id": "stack_07",
    "drive": {"channel": "drive_voltage", "unit": "V", "limits": [0, 120], "operating": [5, 100]},
    "responses": {"extension": {"unit": "m"}},
}


def _written(folder: Path, **changes: object) -> Path:
    path = folder / "device.yaml"
    path.write_text(yaml.safe_dump(STACK | changes), encoding="utf-8")
    return path


def test_shipped_files_hold_the_numbers_of_the_contract():
    one, other = preset("integrated"), preset("peltier")
    assert set(PRESETS) >= {"integrated", "peltier", "peltier_chapter8"}
    assert (one.current_range, one.operating_range) == ((0.0, 12.78e-3), (3.68e-3, 8.49e-3))
    assert (one.ambient, one.linear_gain, one.square_gain) == (22.0, 0.0, 1.01e6)
    assert (one.time_constant, one.dead_time) == (1.8e-3, 0.0)
    assert (one.resistance_range, one.deflection_extent) == ((11.19e3, 231.75e3), (1.62e-6, 58.65e-6))
    assert (one.deflection_range, one.length) == (57.03e-6, 425e-6)
    assert (one.heating, one.width, one.offset) == ((62.0, 3.5), (7.0, 2.0), (0.8, 1.8))
    assert one.noise == {RESISTANCE: 2e-3, TIP_DEFLECTION: 0.05e-6}
    assert (one.sample_period, one.shortest_period) == (1e-3, 50e-6)
    assert one.channels == (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)
    assert one.sites is not None and one.sites.activation == 1740.0 and one.sites.expansion == (1.4, 2.15)
    assert (other.current_range, other.operating_range) == ((-1.2, 1.2), (0.05, -1.15))
    assert (other.ambient, other.linear_gain, other.square_gain) == (25.0, -50.0, 0.0)
    assert (other.time_constant, other.dead_time, other.deflection_range) == (25.0, 0.375, 70e-6)
    assert other.resistance_range == (1.2e3, 120e3)
    assert (other.heating, other.width, other.offset) == ((64.0, 2.5), (7.0, 1.8), (0.7, 1.4))
    assert other.noise == {RESISTANCE: 3e-3, TIP_DEFLECTION: 0.08e-6, STAGE_TEMPERATURE: 0.05}
    assert (other.sample_period, other.shortest_period) == (0.125, 1e-3)
    assert other.channels == (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
    assert (one.key, other.key) == ("integrated", "peltier")


def test_a_copy_of_a_shipped_file_is_the_same_device(tmp_path):
    import vo2_models.device as package

    text = (Path(package.__file__).parent / "files" / "integrated.yaml").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    assert preset(tmp_path / "mine.yaml") == preset("integrated")
    (tmp_path / "mine.yaml").write_text(text.replace("1.8e-3", "2.4e-3"), encoding="utf-8")
    changed = preset(str(tmp_path / "mine.yaml"))
    assert changed.time_constant == 2.4e-3
    # the same id, other numbers: it must not be taken for the shipped one
    assert changed.key != "integrated" and preset(changed.key) == changed
    current = np.full(5, 8e-3)
    rises = [
        truth(name).simulate(current, noise=False)["true_temperature"] for name in (changed.key, "integrated")
    ]
    assert rises[0][-1] < rises[1][-1]


def test_a_file_may_leave_almost_everything_open(tmp_path):
    device = preset(_written(tmp_path))
    assert device.channels == (HEATER_CURRENT, TIP_DEFLECTION)
    assert device.names == {HEATER_CURRENT: "drive_voltage", TIP_DEFLECTION: "extension"}
    assert device.units == {HEATER_CURRENT: "V", TIP_DEFLECTION: "m"}
    assert not device.has_body and not device.has_resistance
    assert device.sites is None and not device.measures_temperature
    assert not device.tells("responses", "extension", "range") and device.tells("drive", "operating")
    # loops lie over the drive: its operating span is as long as a film's transition in kelvin
    assert [device.steady_temperature(v) for v in (5.0, 100.0)] == pytest.approx([30.0, 90.0])
    volts = np.array([5.0, 50.0, 100.0])
    assert surrogate_of_temperature(device.key, temperature_of_surrogate(device.key, volts)) == pytest.approx(
        volts
    )
    assert device.time_constant < 0.1 * device.sample_period


def test_completing_fills_what_is_open_and_nothing_else(tmp_path):
    device = preset(_written(tmp_path, sampling={"period": 0.01}))
    full = device.completed(
        {"responses": {"extension": {"range": [1e-6, 9e-6], "noise": 2e-9}}, "sampling": {"period": 5.0}}
    )
    assert full.deflection_range == pytest.approx(8e-6) and full.noise == {TIP_DEFLECTION: 2e-9}
    assert full.sample_period == 0.01
    shipped = preset("integrated")
    assert shipped.completed({"sampling": {"period": 5.0}, "magnitudes": {}}).key != "integrated"
    assert shipped.completed({"sampling": {"period": 5.0}}).key == "integrated"


def test_a_driving_temperature_is_the_temperature(tmp_path):
    drive = {"channel": "stage_temperature", "unit": "degC", "limits": [20, 100]}
    device = preset(_written(tmp_path, drive=drive, responses={"film_resistance": {"unit": "ohm"}}))
    assert device.steady_temperature(60.0) == 60.0 and device.has_resistance


def test_recordings_are_translated_to_roles_and_back(tmp_path):
    device = preset(_written(tmp_path))
    values = np.arange(4.0)
    own = {
        "drive_voltage": values,
        "extension": 2 * values,
        "commanded_drive_voltage": 3 * values,
        "other": values,
    }
    recording = Recording(np.arange(4.0), own, "stack_07")
    inside = device.in_roles(recording)
    assert set(inside.channels) == {HEATER_CURRENT, TIP_DEFLECTION, COMMANDED_CURRENT, "other"}
    assert np.array_equal(inside[TIP_DEFLECTION], 2 * values)
    outside = device.in_channels(inside)
    assert set(outside.channels) == set(own) and outside.device == "stack_07"
    # the device has no resistance: a channel of this name is not a role of it
    with_more = Recording(np.arange(4.0), {**own, RESISTANCE: values})
    assert RESISTANCE not in device.in_roles(with_more)


def test_a_model_loads_where_its_device_file_is_gone(tmp_path):
    path = _written(tmp_path)
    bank = PlayBank([1e-6], [0.0], [0.2], [-12.8], [0.2], [-11.2], [4e-6])
    model = DeviceModel(str(path), deflection=bank)
    model.save(tmp_path / "model.yaml")
    path.unlink()
    again = DeviceModel.load(tmp_path / "model.yaml")
    assert again.description.id == "stack_07" and again.description.drive_unit == "V"
    volts = np.concatenate([np.linspace(5, 100, 50), np.linspace(100, 5, 50)])
    found = [m.simulate(volts, noise=False)[TIP_DEFLECTION] for m in (model, again)]
    assert np.array_equal(*found) and np.ptp(found[0]) > 1e-6


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"colour": "red"}, "found the key 'colour', need one of schema, id"),
        ({"schema": "vo2-device/2"}, "schema: found 'vo2-device/2', need vo2-device/1"),
        ({"drive": {"channel": "v", "unit": "V"}}, "drive: found no limits"),
        (
            {"drive": {**STACK["drive"], "limits": [120, 0]}},
            "drive: limits: found 120 to 0, need the lower end first",
        ),
        ({"drive": {**STACK["drive"], "operating": [5, 300]}}, "operating: found 300, need 0 to 120 V"),
        ({"drive": {**STACK["drive"], "unit": "kV"}}, "drive: unit: found 'kV', need V"),
        ({"drive": {**STACK["drive"], "unit": "furlong"}}, "drive: unit: found 'furlong', need m, s, A"),
        (
            {"drive": {**STACK["drive"], "channel": "heater_current"}},
            "unit: found 'V', need A, the unit of heater_current",
        ),
        ({"responses": {}}, "responses: found none"),
        ({"responses": {"a": {"unit": "m"}, "b": {"unit": "N"}}}, "found a and b with scale linear"),
        (
            {"responses": {"r": {"unit": "ohm", "range": [-1, 5]}}},
            "range: found -1, need above 0 for scale log10",
        ),
        ({"responses": {"a": {"unit": "m", "noise": "loud"}}}, "noise: found 'loud', need a finite number"),
        (
            {"sensing": {"from": "x", "to": "extension"}},
            "sensing: from: found 'x', need a response: extension",
        ),
        ({"body": {"kind": "none", "ambient": 20}}, "found ambient with kind none"),
        ({"sampling": {"period": 0}}, "sampling: period: found 0, need a finite number above 0"),
        (
            {"sampling": {"period": 1e-3, "shortest": 2e-3}},
            "sampling: shortest: found 0.002, need at most the period, 0.001 s",
        ),
        ({"id": "a b"}, "id: found 'a b', need a name without blanks"),
        ({"transition": {"width": [-8.0, 2.0]}}, "width: found -8.0, need a finite number of at least 0"),
        (
            {"transition": {"heating": [62.0, -3.0]}},
            "heating: found -3.0, need a finite number of at least 0",
        ),
    ],
)
def test_what_is_wrong_is_told_with_file_key_found_and_needed(tmp_path, changes, words):
    path = _written(tmp_path, **changes)
    with pytest.raises(ValueError) as error:
        preset(path)
    assert str(error.value).startswith(str(path)) and words in str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"body": {"ambient": 297.15}}, "transition: heating: found 62, need what the body gets to over the operating range"),
        ({"body": {"square_gain": 1.01}}, "transition: heating: found 62, need what the body gets to"),
        ({"transition": {"heating": [335.0, 3.5]}}, "35.68 to 94.8 degC: ambient (22) and heating in degC"),
        (
            {"drive": {"limits": [0.0, 12.78], "operating": [3.68, 8.49]}},
            "body: found 1.368e+07 to 7.28e+07 degC over the operating range, need -273.15 to 4000 degC",
        ),
        ({"body": {"ambient": -295.0}}, "need -273.15 to 4000 degC: ambient in degC, drive in A, gains in K/A and K/A^2"),
    ],
)  # fmt: skip
def test_numbers_in_another_unit_are_told_as_the_file_is_read(tmp_path, changes, words):
    document = json.loads(preset("integrated").document) | {"id": "mine"}
    for key, values in changes.items():
        document[key] |= values
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(ValueError) as error:
        preset(path)
    assert str(error.value).startswith(f"{path}: ") and words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_material_that_cannot_bend_as_the_file_says_is_told(tmp_path):
    document = json.loads(preset("integrated").document) | {"id": "mine"}
    document["structure"]["length"] = 425.0  # micrometres
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(ValueError, match=r"device mine: found no bending .* need .* length and range in m"):
        truth(str(path), domains=100)


def test_files_that_are_none(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        preset(tmp_path / "absent.yaml")
    (tmp_path / "list.yaml").write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(ValueError, match="found list, need keys and values"):
        preset(tmp_path / "list.yaml")
    with pytest.raises(ValueError, match=f"{', '.join(PRESETS)}, or the path"):
        preset("nowhere")
    with pytest.raises(ValueError, match="cannot be simulated"):
        truth(described(STACK, "stack").key)
