"""What a refitted device leaves of an effect: nothing of what its loops have themselves, most of what they have not."""

import numpy as np
import pytest
from vo2_studies.challenge import identifiable
from vo2_studies.challenge.devices import draw_device
from vo2_studies.challenge.rig import Plan, draw_rig_noise
from vo2_studies.challenge.runner import load_json


@pytest.fixture(scope="module")
def rig():
    rng = np.random.default_rng(4)
    device = draw_device(rng, "peltier", family="accommodating")
    ramp = np.interp(np.arange(1600), [0, 400, 600, 900, 1200, 1600], [0.0, -1.1, -0.6, -1.0, 0.0, -0.9])
    return device, (ramp, -0.5 + 0.5 * np.cos(np.arange(800) / 60.0)), draw_rig_noise(rng, device)


@pytest.mark.slow
def test_another_place_of_the_structures_loop_is_a_constant_of_the_device(rig) -> None:
    device, commands, noise = rig
    size = identifiable.left_after_refit(device, Plan(terms={"structure_offset": 0.8}), commands, noise)
    assert size.before > 10.0
    assert size.left < 0.1
    moved = identifiable.left_after_refit(
        device, Plan(terms={"structure_offset": 0.8}), commands, noise, anew=False
    )
    assert moved.left > 10.0, "since the calibration it is none that another day moves"


def test_a_structure_that_creeps_is_no_other_device(rig) -> None:
    device, commands, noise = rig

    def creep(time, deflection, temperature, fraction, device):
        return deflection + 3e-6 * (1.0 - np.exp(-time / 40.0))

    size = identifiable.left_after_refit(device, Plan(structure=[creep]), commands, noise)
    assert 1.0 < size.left < size.before


@pytest.mark.slow
def test_a_dead_time_shorter_than_a_sample_is_one(rig) -> None:
    device, commands, noise = rig
    late = Plan(dead_time=0.4 * device.preset.sample_period)
    size = identifiable.left_after_refit(device, late, commands, noise)
    since = identifiable.left_after_refit(device, late, commands, noise, anew=False)
    assert size.before > 0.01 > 20.0 * size.left
    assert since.left > size.left


def test_a_law_without_thresholds_is_refused(rig) -> None:
    _, commands, noise = rig
    device = draw_device(np.random.default_rng(4), "peltier", family="bouc_wen")
    with pytest.raises(ValueError, match="no thresholds"):
        identifiable.left_after_refit(device, Plan(), commands, noise)


def test_finished_cases_are_kept_and_counted(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(
        identifiable, "left_after_refit", lambda *given, anew: identifiable.Size(40.0, 12.0 if anew else 0.5)
    )
    arguments = ["--cases", "16", "--family", "accommodating", "--samples", "600", "--output", str(tmp_path)]
    assert identifiable.main(arguments) == 0
    first = load_json(tmp_path / "identifiable.json")
    along = [one for one in first if one["kind"] == "always"]
    since = [one for one in first if one["kind"] == "one"]
    outside = [one for one in first if one["kind"] == "outside"]
    assert along and since and outside and len(along) + len(since) + len(outside) == len(first)
    monkeypatch.setattr(identifiable, "left_after_refit", None)
    assert identifiable.main(arguments) == 0
    assert load_json(tmp_path / "identifiable.json") == first
    told = capsys.readouterr().out
    n = len(along)
    assert (
        f"there all along: of {n} above 10 noise powers constants leave {n} more than 10, {n} more than 1"
        in told
    )
    assert (
        f"since the calibration: of {len(since)} above 10 noise powers constants leave 0 more than 10, 0 more"
        in told
    )
