"""An effect that was there in the calibration too: nominal device and effect are fitted together."""

from dataclasses import replace

import numpy as np
import pytest
from concealed_devices import DEVICE, SEED, calibration, concealed, measured
from vo2_identification.bags import write_bag
from vo2_identification.diagnose import main
from vo2_models.device import truth
from vo2_models.device.coefficients import Coefficient
from vo2_models.diagnosis import corrected_model, pipeline, study
from vo2_models.diagnosis.corrected_model import distance
from vo2_models.diagnosis.report import assemble_diagnosis
from vo2_models.hysteresis.laws import scaled_law
from vo2_models.identification.model_fit import fit_model
from vo2_models.model_file import save_model_parameters
from vo2_models.recording import Recording

ALL_ALONG = {"creep": {"share": 0.06, "time_constant": 0.2}}


@pytest.fixture(scope="module")
def known():
    """Calibration of a device that creeps, and the model that was fitted to it."""
    recording = measured(calibration(SEED, DEVICE, ALL_ALONG, samples=6000))
    return recording, fit_model([recording], DEVICE, plays=12, self_sensing=False)[1]


@pytest.fixture(scope="module")
def seen(known):
    recording, parameters = known
    return study([concealed(ALL_ALONG, seed=21, samples=2500)], parameters, calibration=[recording])


def test_a_creep_that_was_there_all_along_is_named(seen) -> None:
    assert seen.reading.first_use and len(seen.located.problem.parts) == 2
    answer = assemble_diagnosis(seen)
    assert [(e.id, e.family) for e in answer.effects] == [("creep", "structure")]
    # the film is refitted to noise as well; where the effect acts is the tip
    assert "most in tip_deflection" in answer.summary


def test_a_creep_that_was_there_all_along_is_measured(seen) -> None:
    found = assemble_diagnosis(seen).effects[0].parameters
    assert found["share"].value == pytest.approx(0.06, rel=0.1)
    assert found["time_constant"].value == pytest.approx(0.2, rel=0.1)
    # the height of the refitted loop is what would come with it
    assert "gain" not in found


def test_a_model_with_the_name_comes_nearer_and_one_with_a_false_name_does_not(seen) -> None:
    assert distance(seen) < 0.5
    chosen = seen.decision.chosen
    leak = next(h for h in seen.search.candidates if h.key == "leakage_resistance")
    false = replace(chosen, hypotheses=(leak,), values=({"conductance": 1e-4},))
    assert distance(replace(seen, decision=replace(seen.decision, chosen=false))) > seen.limits.farther


def test_loops_fitted_along_stand_where_the_recordings_are(seen) -> None:
    model = seen.located.nominal.model
    as_it_is = corrected_model._off(seen, corrected_model._Written(seen.located.nominal.parameters))
    shifted = replace(
        model,
        deflection=scaled_law(model.deflection, 1.0, 1e-6),
        resistance=scaled_law(model.resistance, 1.0, 0.01),
    )
    written = {**seen.located.nominal.parameters, **shifted.to_parameters()}
    off = corrected_model._off(seen, corrected_model._Written(written))
    # a law of -log10 R that is too high by 0.01 is to come down by as much
    assert off["deflection"] - as_it_is["deflection"] == pytest.approx(-1e-6, rel=1e-3)
    assert off["resistance"] - as_it_is["resistance"] == pytest.approx(-0.01, rel=1e-3)


@pytest.mark.slow
def test_a_creep_that_outlasts_the_recordings_is_named_too() -> None:
    """It goes on from the state in which each begins, so that the loops that were fitted along must hold there as well."""
    all_along = {"log_creep": {"rate": 0.016, "onset": 0.04}}
    recording = measured(calibration(SEED, DEVICE, all_along, samples=6000))
    parameters = fit_model([recording], DEVICE, plays=12, self_sensing=False)[1]
    later = [concealed(all_along, seed=seed, samples=2500) for seed in (21, 22)]
    answer = study(later, parameters, calibration=[recording])
    (effect,) = assemble_diagnosis(answer).effects
    assert effect.id in ("creep", "log_creep") and distance(answer) < 1.0


@pytest.mark.slow
def test_a_name_with_which_no_model_comes_near_is_not_given(known, monkeypatch) -> None:
    recording, parameters = known
    tried = []
    monkeypatch.setattr(pipeline, "distance", lambda some: tried.append(some.decision.chosen.keys) or 9.0)
    answer = study([concealed(ALL_ALONG, seed=21, samples=2500)], parameters, calibration=[recording])
    assert tried[0] == ("creep",) and len(set(tried)) == len(tried)
    assert answer.decision.chosen is None
    assert all(effect.id == "unknown" for effect in assemble_diagnosis(answer).effects)


def test_what_the_calibration_had_taken_up_is_told_before_and_after(seen) -> None:
    moved = {m.constant: m for m in assemble_diagnosis(seen).moved}["thermal.time_constant"]
    true = float(truth(DEVICE, seed=SEED).coefficients[Coefficient.TIME_CONSTANT])
    assert abs(moved.was / true - 1) > 0.1
    assert moved.now == pytest.approx(true, rel=0.005)


def test_the_command_takes_the_calibration_bag(known, tmp_path, capsys) -> None:
    recording, parameters = known
    write_bag(tmp_path / "calibration", recording)
    write_bag(tmp_path / "short", concealed(samples=1000).slice(0, 40))
    save_model_parameters(tmp_path / "model.yaml", parameters)
    bags = ["--bag", str(tmp_path / "short"), "--calibration", str(tmp_path / "calibration")]
    status = main([*bags, "--model", str(tmp_path / "model.yaml"), "--output", str(tmp_path / "o")])
    assert status == 2
    # both are read, and the one that cannot be used is named
    assert f"{tmp_path / 'short'}: found 40 samples" in capsys.readouterr().err


@pytest.mark.slow
def test_a_laser_that_was_on_for_a_while_in_both_is_no_room_that_drifts() -> None:
    laser = {"laser_heating": {"rise": 1.0, "start": 0.8, "stop": 2.0}}
    recording = measured(calibration(SEED, DEVICE, laser, samples=6000))
    parameters = fit_model([recording], DEVICE, plays=12, self_sensing=False)[1]
    answer = assemble_diagnosis(
        study([concealed(laser, seed=21, samples=3000)], parameters, calibration=[recording])
    )
    (effect,) = answer.effects
    assert effect.id == "laser_heating"
    assert effect.parameters["stop"].value == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow
def test_a_room_that_wanders_in_every_recording_has_a_course_in_each() -> None:
    def seen(seed: int, samples: int) -> Recording:
        past = np.linspace(0.0, 1.0, samples)
        return concealed(room=np.sin(2.0 * np.pi * (1.7 * past + 0.3 * seed)), seed=seed, samples=samples)

    before = seen(5, 5000)
    parameters = fit_model([before], DEVICE, plays=12, self_sensing=False)[1]
    answer = study([seen(6, 2500), seen(7, 2500)], parameters, calibration=[before])
    # left-out recordings would not tell their own course
    found = assemble_diagnosis(answer)
    (effect,) = found.effects
    assert effect.id == "unknown" and set(effect.siblings) == {"ambient_drift", "drive_gain_drift"}
    worth = [c.probability for c in found.candidates if c.id in effect.siblings]
    assert len(set(worth)) == 1, "they are not compared"
    assert not answer.days
