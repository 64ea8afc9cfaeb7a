"""Recordings of devices without body that begin relaxed: fit and judgement begin where that is forgotten."""

import numpy as np
import pytest
import yaml
from vo2_models.device.description import described
from vo2_models.diagnosis import diagnose
from vo2_models.identification.loops_fit import COLD
from vo2_models.identification.model_fit import fit_model
from vo2_models.identification.rig_start import _is_unknown, known_from
from vo2_models.prediction import predict
from vo2_models.recording import Recording

DEVICE = {
    "schema": "vo2-device/1",
    "id": "magnet",
    "drive": {"channel": "field", "unit": "V", "limits": [-10.0, 10.0]},
    "responses": {"flux": {"unit": "C", "scale": "linear"}},
}


def magnet(drive, *, relaxed, seed):
    """Plays of all radii, which a demagnetised material begins with at rest; none is the law's own density."""
    radii = np.linspace(0.05, 6.0, 60)
    state = np.zeros(radii.size) if relaxed else drive[0] + radii
    out = np.empty(drive.size)
    for k, u in enumerate(drive):
        state = np.clip(state, u - radii, u + radii)
        out[k] = np.tanh(state / 4.0) @ np.exp(-radii / 3.0) / 20.0
    return out + np.random.default_rng(seed).normal(0.0, 2e-4, drive.size)


def recording(levels, *, relaxed=True, seed=0):
    drive = np.interp(np.arange((len(levels) - 1) * 40), np.arange(len(levels)) * 40, levels)
    channels = {"field": drive, "flux": magnet(drive, relaxed=relaxed, seed=seed)}
    return described(DEVICE, "magnet").in_roles(Recording(0.01 * np.arange(drive.size), channels, "magnet"))


def levels(seed):
    random = np.random.default_rng(seed)
    falling = [10.0 * (-1) ** k * (1.0 - k / 20.0) for k in range(18)]
    return [0.0, *falling, *random.uniform(-10.0, 10.0, 24)]


@pytest.fixture(scope="module")
def device(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "magnet.yaml"
    path.write_text(yaml.safe_dump(DEVICE))
    return str(path)


@pytest.fixture(scope="module")
def fitted(device):
    return fit_model([recording(levels(1))], device)


def test_the_past_is_forgotten_at_an_end_of_the_range() -> None:
    assert known_from(np.array([0.0, 1.0, 0.0, -1.0])) == 1
    assert known_from(np.array([-1.0, 1.0, 0.0])) == 0


def test_a_relaxed_beginning_is_left_out(fitted) -> None:
    (note,) = [note for note in fitted[0].notes if "begins at a state" in note]
    assert "field has been at an end of its range" in note


@pytest.mark.slow
def test_behind_a_relaxed_beginning_the_rest_fits_as_well_as_a_saturated_one(device, fitted) -> None:
    fits = [fitted[0], fit_model([recording(levels(1), relaxed=False)], device)[0]]
    left = [np.sqrt(np.nanmean(fit.residuals["tip_deflection"] ** 2)) for fit in fits]
    assert left[0] < 1.3 * left[1]


@pytest.mark.slow
def test_of_few_samples_none_is_left_out(device) -> None:
    whole = recording(levels(1)[:20])
    few = Recording(whole.time_s[::16], {c: v[::16] for c, v in whole.channels.items()}, "magnet")
    assert len(few) < 50
    notes = fit_model([few], device)[0].notes
    assert notes and not any("begins at a state" in note for note in notes)


@pytest.mark.slow
def test_what_begins_relaxed_is_judged_from_where_that_is_forgotten(fitted) -> None:
    parameters = fitted[1]
    answer = diagnose([recording(levels(2), seed=3)], parameters)
    assert answer.verdict == "agrees"
    (told,) = [text for text in answer.limits if "begins at a state" in text]
    assert "the first 3" in told and "are not judged" in told


@pytest.mark.slow
def test_a_gain_that_has_moved_is_told_beside_a_relaxed_beginning(fitted) -> None:
    parameters = fitted[1]
    later = recording(levels(2), seed=3)
    louder = {name: 1.1 * y if name == "tip_deflection" else y for name, y in later.channels.items()}
    answer = diagnose([Recording(later.time_s, louder, "magnet")], parameters)
    assert answer.verdict == "drifted"
    (moved,) = answer.moved
    assert moved.constant == "deflection.gain" and moved.now == pytest.approx(1.1, abs=3 * moved.std)
    assert any("begins at a state" in text for text in answer.limits)


def test_a_prediction_is_judged_from_where_the_beginning_is_forgotten(fitted) -> None:
    model = fitted[0].model
    relaxed = recording(levels(2), seed=3)
    from_an_end = recording([10.0, *levels(2)[1:]], seed=3)
    one, other = (predict(model, each).channels["tip_deflection"] for each in (relaxed, from_an_end))
    assert one.unknown and not other.unknown
    assert one.error == pytest.approx(other.error, rel=0.3)


def test_a_relaxed_start_is_seen_where_loops_are_narrow_beside_the_way_from_saturation() -> None:
    drive = np.interp(np.arange(1200), np.arange(31) * 40, levels(2)[:31])
    radii = np.linspace(0.02, 1.5, 40)
    state = np.zeros(radii.size)
    response = np.empty(drive.size)
    for k, u in enumerate(drive):
        state = np.clip(state, u - radii, u + radii)
        response[k] = np.mean(np.tanh(state / 0.4))
    path = np.concatenate([[COLD], 60.0 + 3.0 * drive])
    before = np.arange(path.size) <= known_from(drive)
    assert _is_unknown(path, np.concatenate([[np.nan], response]), before)
