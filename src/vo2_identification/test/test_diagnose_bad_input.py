"""What only a mistake can make is told as one, in one line, and not as physics."""

from dataclasses import replace

import numpy as np
import pytest
from concealed_devices import calibrated, concealed
from vo2_identification.bags import write_bag
from vo2_identification.diagnose import main
from vo2_models.diagnosis import Unusable, study
from vo2_models.model_file import save_model_parameters
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION


@pytest.fixture(scope="module")
def recording():
    return concealed(samples=1500)


def changed(recording, **channels):
    return replace(recording, channels={**recording.channels, **channels})


def noise_only(recording):
    rng = np.random.default_rng(1)
    film, tip = rng.standard_normal((2, len(recording)))
    return changed(recording, film_resistance=5e4 * (1 + 0.01 * film), tip_deflection=3e-5 + 1e-6 * tip)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda r: changed(r, tip_deflection=-r[TIP_DEFLECTION]),
            "tip_deflection runs against the simulation",
        ),
        (
            lambda r: changed(r, film_resistance=3e9 / r[RESISTANCE]),
            "film_resistance runs against the simulation",
        ),
        (lambda r: changed(r, film_resistance=1e-3 * r[RESISTANCE]), "check the unit"),
        (lambda r: changed(r, heater_current=1e3 * r[HEATER_CURRENT]), "off by a factor of 1 000, "),
        (lambda r: changed(r, tip_deflection=1e3 * r[TIP_DEFLECTION]), "off by a factor of 1 000, "),
        (lambda r: changed(r, tip_deflection=1e-3 * r[TIP_DEFLECTION]), "check the unit"),
        (lambda r: replace(r, time_s=1e3 * r.time_s), "found a sample period of 1 s"),
        (lambda r: changed(r, tip_deflection=1e-9 * r[RESISTANCE]), "is a copy of film_resistance"),
        (
            lambda r: changed(r, tip_deflection=r[RESISTANCE], film_resistance=r[TIP_DEFLECTION]),
            "are swapped",
        ),
        (
            lambda r: changed(r, heater_current=np.full(len(r), 5e-3)),
            r"heater_current varies by 0 A of an operating range of .*: check its unit",
        ),
        (noise_only, "can be used"),
    ],
)
def test_one_bad_recording_is_refused_with_its_name(recording, spoil, said) -> None:
    with pytest.raises(Unusable, match=said) as refused:
        study([spoil(recording)], calibrated(), names=["later"])
    assert str(refused.value).startswith("later: ") and "\n" not in str(refused.value)


def test_one_recording_twice_is_no_second_one(recording) -> None:
    with pytest.raises(Unusable, match="is recording 1 once more"):
        study([recording, recording], calibrated())


def test_recordings_of_two_films_are_not_one_device(recording) -> None:
    other = concealed(samples=1500, seed=5)
    other = changed(other, film_resistance=2.2 * other[RESISTANCE])
    with pytest.raises(Unusable, match=r"recording 2: film_resistance is 2\.\d+ times that of recording 1"):
        study([recording, other], calibrated())


def test_a_calibration_of_another_model_is_told_by_the_command(recording, tmp_path, capsys) -> None:
    # a device of the same kind: its loops are elsewhere
    write_bag(tmp_path / "foreign", concealed(samples=1500, device_seed=3))
    write_bag(tmp_path / "later", recording)
    save_model_parameters(tmp_path / "model.yaml", calibrated())
    bags = ["--bag", str(tmp_path / "later"), "--calibration", str(tmp_path / "foreign")]
    assert main([*bags, "--model", str(tmp_path / "model.yaml"), "--output", str(tmp_path / "o")]) == 2
    said = capsys.readouterr().err
    assert "the model was fitted to another recording" in said and said.count("\n") == 1
