"""Several recordings in which not the same has changed: each has its own answer."""

import numpy as np
import pytest
from concealed_devices import DEVICE, calibrated, concealed
from vo2_models.device.coefficients import Coefficient
from vo2_models.diagnosis import diagnose, validate
from vo2_models.identification.model_fit import fit_model

SAMPLES = 2500
LATE = {"sensor_lag": {"signal": "tip_deflection", "time_constant": 4e-3}}


@pytest.fixture(scope="module")
def unchanged():
    return concealed(samples=SAMPLES, seed=5)


def test_what_only_one_recording_shows_is_named_for_it(unchanged) -> None:
    answer = diagnose([unchanged, concealed(LATE, samples=SAMPLES, seed=6)], calibrated())
    assert [(e.id, e.signal) for e in answer.effects] == [("sensor_lag", "tip_deflection")]
    assert answer.summary.startswith("recording 1 agrees with the simulation")
    assert "what differs is in recording 2 only" in answer.summary
    validate(answer.to_dict())


@pytest.mark.slow
def test_constants_of_one_day_are_those_of_its_recording(unchanged) -> None:
    slower = concealed(samples=SAMPLES, seed=6, moved=[(Coefficient.TIME_CONSTANT, 1.1, 0.0)])
    answer = diagnose([unchanged, slower], calibrated())
    assert answer.verdict == "drifted" and answer.effects == []
    (moved,) = answer.moved
    assert moved.constant == "thermal.time_constant"
    assert moved.now / moved.was == pytest.approx(1.1, abs=0.02)
    assert "all else here is of recording 2" in answer.summary
    assert "recording 1, by itself: Simulation and recording agree" in answer.summary


@pytest.mark.slow
def test_two_recordings_may_have_an_effect_each() -> None:
    first = concealed({"series_resistance": {"resistance": 3000.0}}, samples=SAMPLES, seed=5)
    second = concealed({"creep": {"share": 0.05, "time_constant": 0.2}}, samples=SAMPLES, seed=6)
    answer = diagnose([first, second], calibrated())
    assert [e.id for e in answer.effects] == ["series_resistance"]
    assert "recording 2, by itself" in answer.summary and "Left out: creep" in answer.summary


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
    assert answer.summary.startswith("recording 1 agrees with the simulation")


@pytest.mark.slow
def test_a_room_of_its_own_for_each_recording_is_no_room_that_drifts() -> None:
    rooms = [
        concealed(samples=SAMPLES, seed=5 + k, room=np.full(SAMPLES, r)) for k, r in enumerate((-0.8, 1.5))
    ]
    answer = diagnose(rooms, calibrated())
    assert answer.verdict == "drifted"
    (moved,) = answer.moved
    assert moved.constant == "thermal.ambient" and moved.now - moved.was == pytest.approx(1.5, abs=0.2)
