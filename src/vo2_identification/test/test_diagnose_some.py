"""Several recordings in which not the same has changed: each has its own answer."""

import numpy as np
import pytest
from concealed_devices import DEVICE, calibrated, concealed
from vo2_models.device.coefficients import Coefficient
from vo2_models.diagnosis import diagnose, study, validate
from vo2_models.diagnosis.page import report_page
from vo2_models.diagnosis.report import assemble_diagnosis
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import Recording

SAMPLES = 2500
LATE = {"sensor_lag": {"signal": "tip_deflection", "time_constant": 4e-3}}


@pytest.fixture(scope="module")
def unchanged():
    return concealed(samples=SAMPLES, seed=5)


@pytest.mark.slow
def test_what_only_one_recording_shows_is_named_for_it(unchanged) -> None:
    seen = study([unchanged, concealed(LATE, samples=SAMPLES, seed=6)], calibrated())
    answer = assemble_diagnosis(seen)
    page = report_page(seen, answer)
    assert "By recording" in page and "sensor_lag on tip_deflection (" in page
    assert [(e.id, e.signal) for e in answer.effects] == [("sensor_lag", "tip_deflection")]
    assert [(one.recording, one.verdict) for one in answer.recordings] == [
        ("recording 1", "agrees"),
        ("recording 2", "differs"),
    ]
    assert "recording 1 agrees; recording 2 differs (sensor_lag on tip_deflection" in answer.summary
    assert "All else here is of recording 2" in answer.summary
    plain = answer.to_dict()
    validate(plain)
    assert [e["id"] for e in plain["recordings"][1]["effects"]] == ["sensor_lag"]


@pytest.mark.slow
def test_constants_of_one_day_are_those_of_its_recording(unchanged) -> None:
    slower = concealed(samples=SAMPLES, seed=6, moved=[(Coefficient.TIME_CONSTANT, 1.1, 0.0)])
    answer = diagnose([unchanged, slower], calibrated())
    assert answer.verdict == "drifted" and answer.effects == []
    (moved,) = answer.moved
    assert moved.constant == "thermal.time_constant"
    assert moved.now / moved.was == pytest.approx(1.1, abs=0.02)
    assert "recording 1 agrees; recording 2 drifted (thermal.time_constant" in answer.summary
    assert "All else here is of recording 2" in answer.summary


@pytest.mark.slow
def test_two_recordings_may_have_an_effect_each() -> None:
    first = concealed({"series_resistance": {"resistance": 3000.0}}, samples=SAMPLES, seed=5)
    second = concealed({"creep": {"share": 0.05, "time_constant": 0.2}}, samples=SAMPLES, seed=6)
    answer = diagnose([first, second], calibrated())
    assert [e.id for e in answer.effects] == ["series_resistance"]
    assert "recording 2 differs (creep" in answer.summary
    assert answer.recordings[1].effects[0].id == "creep" and answer.recordings[1].effects[0].parameters


@pytest.mark.slow
def test_an_effect_of_all_recordings_is_one_answer() -> None:
    both = [concealed(LATE, samples=SAMPLES, seed=seed) for seed in (5, 6)]
    answer = diagnose(both, calibrated())
    assert [e.id for e in answer.effects] == ["sensor_lag"]
    assert answer.summary.startswith("Simulation and recording differ")


@pytest.mark.slow
def test_what_came_after_the_calibration_is_named_with_it_given_too() -> None:
    recording = concealed(samples=4000, seed=3)
    parameters = fit_model([recording], DEVICE, plays=12, self_sensing=False)[1]
    answer = diagnose([concealed(LATE, samples=SAMPLES, seed=6)], parameters, calibration=[recording])
    assert [e.id for e in answer.effects] == ["sensor_lag"]
    assert answer.effects[0].parameters["time_constant"].value == pytest.approx(4e-3, rel=0.05)
    assert "recording 1 agrees; recording 2 differs (sensor_lag" in answer.summary


@pytest.mark.slow
def test_a_room_of_its_own_for_each_recording_is_no_room_that_drifts() -> None:
    rooms = [
        concealed(samples=SAMPLES, seed=5 + k, room=np.full(SAMPLES, r)) for k, r in enumerate((-0.8, 1.5))
    ]
    answer = diagnose(rooms, calibrated())
    assert answer.verdict == "drifted" and answer.recordings == []
    moved = {one.recording: one for one in answer.moved}
    assert {one.constant for one in answer.moved} == {"thermal.ambient"}
    for name, room in (("recording 1", -0.8), ("recording 2", 1.5)):
        assert moved[name].now - moved[name].was == pytest.approx(room, abs=0.1)
    plain = answer.to_dict()
    validate(plain)
    assert {one["recording"] for one in plain["moved"]} == {"recording 1", "recording 2"}


@pytest.mark.slow
def test_an_effect_of_all_recordings_is_named_though_each_has_a_room_of_its_own() -> None:
    series = {"series_resistance": {"resistance": 300.0}}
    rooms = [
        concealed(series, samples=SAMPLES, seed=5 + k, room=np.full(SAMPLES, r))
        for k, r in enumerate((-0.7, 0.6))
    ]
    answer = diagnose(rooms, calibrated())
    (named,) = answer.effects
    assert named.id == "series_resistance" and answer.recordings == []
    assert named.parameters["resistance"].value == pytest.approx(300.0, rel=0.1)


@pytest.mark.slow
def test_a_gain_of_one_day_is_told_beside_an_effect_of_another() -> None:
    late = concealed(LATE, samples=SAMPLES, seed=6)
    turned = concealed(samples=SAMPLES, seed=5)
    channels = {**turned.channels, "tip_deflection": 0.9 * turned["tip_deflection"]}
    answer = diagnose([Recording(turned.time_s, channels, turned.device), late], calibrated())
    first, second = answer.recordings
    assert [e.id for e in second.effects] == ["sensor_lag"] and first.verdict == "drifted"
    (moved,) = first.moved
    assert moved.constant == "deflection.gain" and moved.now == pytest.approx(0.9, abs=0.02)
