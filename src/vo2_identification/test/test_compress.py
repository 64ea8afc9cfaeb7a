"""`compress`: a model file in, a smaller one out that the estimator loads; bad input in one line."""

import re

import numpy as np
import pytest
from vo2_identification.compress import main
from vo2_models.device.description import described
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis import PlayBank, PreisachOperator
from vo2_models.hysteresis.compress_model import compress_plays_of
from vo2_models.model_file import load_model_parameters, save_model_parameters
from vo2_models.self_sensing.direct_preisach import DirectPreisachSelfSensing
from vo2_models.self_sensing.records import BOUND_KNOTS
from vo2_models.self_sensing.scheme import self_sensing

import vo2_models as vo2

TEMPERATURE = np.interp(
    np.arange(0, 12, 0.01), np.arange(13), [25, 95, 25, 85, 40, 80, 45, 75, 50, 70, 55, 90, 25]
)


def _bank(plays, weight, polynomial, own=True):
    """Half a dozen domains a play: wide loops of one pair of envelopes, or one pair for each play."""
    k = np.arange(plays)
    slope, centre = np.full(plays, 0.25), 60.0 + own * (1.5 * k - plays)
    radii = np.zeros(plays) if own else 0.8 * k / plays
    weights = weight * (1.0 + np.sin(k)) + weight
    return PlayBank(
        weights, radii, slope, -slope * (centre + 4.0), slope, -slope * (centre - 4.0), polynomial
    )


@pytest.fixture
def model(tmp_path):
    device = DeviceModel(
        "integrated",
        resistance=_bank(8, 0.1, [-4.7, 0.001]),
        deflection=_bank(6, 4e-6, [3e-5, -1e-7], own=False),
        uncertainty={
            "resistance.weights": (0.01,) * 8,
            "resistance.rising_slopes": (0.02,) * 8,
            "thermal.time_constant": (1e-4,),
        },
    )
    resistance = 10.0 ** -device.resistance.run(TEMPERATURE)
    deflection = device.deflection.run(TEMPERATURE)
    direct = DirectPreisachSelfSensing.fit(resistance, deflection, level=16)
    save_model_parameters(tmp_path / "model.yaml", device.to_parameters() | direct.to_parameters())
    return tmp_path / "model.yaml", resistance, deflection


def test_fewer_plays_load_into_the_plant_and_stay_near(model, tmp_path, capsys):
    path, resistance, deflection = model
    assert main(["--model", str(path), "--output", str(tmp_path / "small.yaml"), "--plays", "4"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"model.resistance: 8 plays to [1-4], output changed by at most", said)
    assert "model.deflection: 6 plays to 4" in said
    small = DeviceModel.load(tmp_path / "small.yaml")
    for section, wanted in (("resistance", -np.log10(resistance)), ("deflection", deflection)):
        law = getattr(small, section)
        assert 1 <= np.size(law.weights) <= 4
        assert np.max(np.abs(law.run(TEMPERATURE) - wanted)) < 0.05 * np.ptp(wanted)
    # deviations of parameters that are gone are gone, the others stay
    assert set(small.uncertainty) == {"thermal.time_constant"}
    assert (
        load_model_parameters(tmp_path / "small.yaml")["model.self_sensing.preisach.weights"]
        == load_model_parameters(path)["model.self_sensing.preisach.weights"]
    )


def test_a_file_of_somebody_else_is_not_replaced(model, tmp_path, capsys):
    (tmp_path / "mine.yaml").write_text("kept")
    assert main(["--model", str(model[0]), "--output", str(tmp_path / "mine.yaml"), "--plays", "4"]) == 2
    assert (tmp_path / "mine.yaml").read_text() == "kept"
    assert "mine.yaml: exists and was not compressed by `compress`" in capsys.readouterr().err
    again = ["--model", str(model[0]), "--output", str(tmp_path / "own.yaml"), "--plays", "4"]
    assert main(again) == main(again) == 0


def test_a_coarser_grid_loads_into_the_estimator_and_stays_near(model, tmp_path, capsys):
    path, resistance, deflection = model
    assert main(["--model", str(path), "--output", str(tmp_path / "small.yaml"), "--levels", "6"]) == 0
    assert "model.self_sensing.preisach: 16 levels to 6" in capsys.readouterr().out
    parameters = load_model_parameters(tmp_path / "small.yaml")
    assert np.size(parameters["model.self_sensing.preisach.walls"]) == 7
    assert np.size(parameters["model.self_sensing.preisach.weights"]) == 21
    scheme = self_sensing("preisach", parameters)
    state = scheme.initial_state()
    estimate = np.array([scheme.step(r, state)[0] for r in resistance])
    assert np.mean(np.abs(estimate - deflection)) < 0.05 * np.ptp(deflection)


def test_a_preisach_law_of_a_response_is_compressed_too(tmp_path):
    operator = PreisachOperator(np.linspace(40.0, 80.0, 13), np.full(78, 0.01), 0.5)
    save_model_parameters(tmp_path / "model.yaml", operator.to_parameters("model.resistance"))
    assert (
        main(["--model", str(tmp_path / "model.yaml"), "--output", str(tmp_path / "s.yaml"), "--levels", "4"])
        == 0
    )
    small = PreisachOperator.from_parameters("model.resistance", load_model_parameters(tmp_path / "s.yaml"))
    assert small.level == 4
    # a density that is the same everywhere loses nothing
    assert small.run(TEMPERATURE) == pytest.approx(operator.run(TEMPERATURE), abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--plays", "8"], "plays: found 8, need 1 to 7: the largest bank has 8"),
        (["--plays", "0"], "plays: found 0, need 1 to 7"),
        (["--levels", "16"], "levels: found 16, need 1 to 15: the finest grid has 16"),
    ],
)
def test_too_many_are_refused_in_one_line(model, tmp_path, capsys, arguments, message):
    assert main(["--model", str(model[0]), "--output", str(tmp_path / "s.yaml"), *arguments]) == 2
    assert not (tmp_path / "s.yaml").exists()
    error = capsys.readouterr().err
    assert error.startswith(f"compress: {message}") and error.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "value", "arguments", "message"),
    [
        (
            "model.self_sensing.preisach.walls",
            None,
            ["--levels", "4"],
            "model.self_sensing.preisach.walls: found",
        ),
        (
            "model.resistance.rising_slopes",
            -0.25,
            ["--plays", "4"],
            "model.resistance.rising_slopes: found -0.25",
        ),
        (
            "model.resistance.weights",
            -1.0,
            ["--plays", "4"],
            "model.resistance.weights: found -1, need weights >= 0",
        ),
    ],
)
def test_what_is_not_monotone_is_named(model, tmp_path, capsys, name, value, arguments, message):
    values = load_model_parameters(model[0])
    numbers = np.array(values[name])
    numbers[2] = numbers[1] if value is None else value
    save_model_parameters(tmp_path / "bad.yaml", values | {name: numbers.tolist()})
    assert (
        main(["--model", str(tmp_path / "bad.yaml"), "--output", str(tmp_path / "s.yaml"), *arguments]) == 2
    )
    error = capsys.readouterr().err
    assert error.startswith(f"compress: {message}") and error.count("\n") == 1


def test_missing_files_and_laws_are_named(tmp_path, capsys):
    assert main(["--model", str(tmp_path / "none.yaml"), "--output", "x.yaml", "--plays", "2"]) == 2
    assert "none.yaml: cannot be read" in capsys.readouterr().err
    save_model_parameters(tmp_path / "bare.yaml", {"model.device": "integrated"})
    for arguments, what in ((["--plays", "2"], "no bank of plays"), (["--levels", "2"], "no Preisach grid")):
        assert (
            main(["--model", str(tmp_path / "bare.yaml"), "--output", str(tmp_path / "x.yaml"), *arguments])
            == 2
        )
        assert what in capsys.readouterr().err


@pytest.mark.slow
def test_bounds_of_a_compressed_model_hold_as_often(tmp_path):
    """On random levels, where the bounds of the model as it was would hold in half of the samples."""
    current = 3.68e-3 + 4.81e-3 * np.repeat(vo2.damped_oscillation(np.linspace(0.0, 1.0, 13)), 10)
    whole = vo2.fit(vo2.simulate("integrated", current, seed=1), "integrated")
    save_model_parameters(tmp_path / "model.yaml", whole)
    levels = np.repeat(np.random.default_rng(1).uniform(size=300), 5)
    fresh = vo2.simulate("integrated", 3.68e-3 + 4.81e-3 * levels, seed=91)
    for plays in (10, 6):
        small = tmp_path / f"{plays}.yaml"
        assert (
            main(["--model", str(tmp_path / "model.yaml"), "--plays", str(plays), "--output", str(small)])
            == 0
        )
        found = vo2.estimate(load_model_parameters(small), fresh["film_resistance"])
        error = np.abs(found.deflection - fresh["true_tip_deflection"])
        assert np.mean(error > found.bound) < 0.05
        before = whole["model.self_sensing.bounds.composite"]
        old = np.interp(np.log10(fresh["film_resistance"]), whole[BOUND_KNOTS], before)
        assert np.mean(error > old) > 0.2
        after = load_model_parameters(small)["model.self_sensing.bounds.composite"]
        assert np.all(np.asarray(after) >= np.asarray(before))


def test_plays_are_compressed_and_compared_on_the_operating_range(tmp_path, capsys):
    """As in table 6.3: envelopes that saturate at 3000, on a device that is driven from -10 to 10."""
    device = {
        "schema": "vo2-device/1", "id": "narrow",
        "drive": {"channel": "input", "unit": "1", "limits": [-10.0, 10.0]},
        "body": {"kind": "first_order", "ambient": 0.0, "linear_gain": 1.0, "time_constant": 0.001},
        "responses": {"output": {"unit": "1"}},
    }  # fmt: skip
    slopes, none = np.full(6, 1e-3), np.zeros(6)
    radii = 1e-3 * np.array([0.0, 0.2, 0.4, 0.6, 0.8, 2.0])
    bank = PlayBank(1e3 * np.array([6, 2, 1, 2, 4, 4]), radii, slopes, none, slopes, none)
    DeviceModel(described(device, "narrow").key, deflection=bank).save(tmp_path / "model.yaml")
    arguments = [
        "--model",
        str(tmp_path / "model.yaml"),
        "--output",
        str(tmp_path / "s.yaml"),
        "--plays",
        "3",
    ]
    assert main(arguments) == 0
    told = re.search(
        r"at most ([\d.e-]+) % of its range on a damped oscillation over the device's operating range, input -10 to 10$",
        capsys.readouterr().out.strip(),
    )
    small = DeviceModel.load(tmp_path / "s.yaml").deflection
    for amplitude in (10.0, 5.0, 2.0, 1.0):
        path = amplitude * np.sin(np.linspace(0.0, 60.0, 6000)) * np.exp(-np.linspace(0.0, 1.5, 6000))
        change = 100.0 * np.max(np.abs(small.run(path) - bank.run(path))) / np.ptp(bank.run([-10.0, 10.0]))
        assert 0.5 * float(told[1]) < change < 1.1 * float(told[1])


def test_a_grid_of_too_many_choices_stays_and_the_others_are_compressed(tmp_path, capsys):
    fine, coarse = (
        PreisachOperator(np.linspace(40.0, 80.0, level + 1), np.full(level * (level + 1) // 2, 0.01))
        for level in (40, 14)
    )
    both = fine.to_parameters("model.resistance") | coarse.to_parameters("model.deflection")
    save_model_parameters(tmp_path / "both.yaml", both)
    levels = ["--output", str(tmp_path / "s.yaml"), "--levels", "12", "--model"]
    assert main([*levels, str(tmp_path / "both.yaml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("model.deflection: 14 levels to 12, output changed by at most")
    assert lines[1].startswith(
        "model.resistance: stays at 40 levels: found 1.7e+09 choices of 12 from 40 levels"
    )
    assert lines[1].endswith("1 to 11 or 30 to 39 levels")
    small = load_model_parameters(tmp_path / "s.yaml")
    assert small["model.resistance.walls"] == both["model.resistance.walls"]
    save_model_parameters(tmp_path / "one.yaml", fine.to_parameters("model.resistance"))
    assert main([*levels, str(tmp_path / "one.yaml")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("compress: model.resistance: found 1.7e+09 choices") and error.count("\n") == 1
    assert "1 to 11 or 30 to 39 levels" in error


def test_no_more_plays_than_come_nearer():
    """A fit of eleven plays that ends farther off than one of eight is not what is written."""
    bank = _bank(12, 0.1, [-4.7, 0.001])
    errors = []
    for plays in (11, 8, 5):
        _, (change,) = compress_plays_of(bank.to_parameters("model.resistance"), plays)
        assert 1 <= change.after <= plays
        errors.append(change.error)
    assert errors[0] <= 1.05 * min(errors)
