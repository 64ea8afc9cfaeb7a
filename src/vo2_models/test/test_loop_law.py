"""The law of a loop: chosen by what was held out, placed where the response changes, exchanged in a fitted device."""

import numpy as np
import pytest
from vo2_models.device import DeviceModel
from vo2_models.device.ground_truth import truth
from vo2_models.hysteresis.limiting_loop import LimitingLoop
from vo2_models.identification.excitation import (
    damped_oscillation,
    first_order_reversal_fan,
    random_levels,
)
from vo2_models.identification.loop_law import curves_of_fan, fit_loop_law, folds_of_recordings
from vo2_models.identification.model_fit import fit_model
from vo2_models.identification.play_dictionary import fold_of
from vo2_models.identification.preisach_choice import adapted_walls, choose_preisach


def test_walls_stand_closer_where_the_response_changes():
    path = np.concatenate([np.linspace(0, 20, 200), np.linspace(20, 0, 200)])
    values = np.tanh(8.0 * (path - 17.0))
    even, adapted = (adapted_walls(path, values, 20, share) for share in (0.0, 0.8))
    assert np.allclose(np.diff(even), 1.0, atol=0.02)
    assert adapted[0] == 0.0 and adapted[-1] == 20.0 and np.all(np.diff(adapted) > 0)
    assert np.count_nonzero(np.abs(adapted - 17.0) < 0.5) > 8


def test_a_jump_within_one_step_of_the_drive_is_followed():
    """A film that switches at once: evenly spaced cells smear the jump over their width."""
    path = np.concatenate([np.linspace(0, 20, 200), np.linspace(20, 0, 200)])
    law = LimitingLoop(12.0, 17.0, 9.0, 9.0, 0.9, -3.7, -2.3, [0.0, 0.01])
    values = law.run(path)
    # where the jump itself is held out nobody can know its place
    held = (np.arange(400) // 10 % 3 == 1) & (np.abs(np.gradient(values)) < 0.02)
    found = choose_preisach(path, np.where(held, np.nan, values), fold_of(~held))
    assert "closer where the response changes" in found.words
    assert np.sqrt(np.mean((found.law.run(path) - values)[held] ** 2)) < 0.03 * np.ptp(values)


def test_what_lies_between_recordings_is_asked_of_whole_recordings():
    drives = [np.array([0.0, top, 0.0]) for top in (4.0, 5.0, 6.0)]
    blocks = np.tile([-1, 0, 1, 2], 3)
    fold = folds_of_recordings(drives, blocks)
    assert fold.tolist() == [-1, 0, 0, 0, -1, 1, 1, 1, -1, -1, -1, -1], (
        "the largest would be an extrapolation"
    )
    assert folds_of_recordings(drives[:2], blocks[:8]).tolist() == blocks[:8].tolist()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_a_fan_of_reversal_curves_each_is_held_out_with_others_far_from_it(sign):
    fan = sign * np.repeat(first_order_reversal_fan(np.linspace(0.0, 1.0, 31)), 2)
    with_value = np.r_[False, np.ones(fan.size, bool)]
    fold = folds_of_recordings([fan], fold_of(with_value))
    curve = curves_of_fan(fan)
    assert curve.max() == 30 and np.all(fold[0] == -1)
    for number in range(1, 30):
        own, following = (np.unique(fold[1:][curve == k]) for k in (number, number + 1))
        assert own.size == 1 and own != following, "neighbours are held out apart"


@pytest.mark.parametrize(
    "drive",
    [
        damped_oscillation(np.linspace(0.0, 1.0, 31)),
        np.tile([0.0, 1.0], 30),
        random_levels(0.0, 1.0, 60, seed=1),
        np.full(9, 0.3),
    ],
)
def test_what_is_no_fan_is_held_out_by_blocks_of_time(drive):
    blocks = fold_of(np.r_[False, np.ones(drive.size, bool)])
    np.testing.assert_array_equal(folds_of_recordings([drive], blocks), blocks)


def test_a_law_that_does_not_exist_is_told():
    with pytest.raises(ValueError, match=r"law: found 'magic', need one of plays, preisach"):
        fit_loop_law("magic", np.arange(9.0), np.arange(9.0), np.zeros(9, dtype=np.int64))


@pytest.mark.parametrize(
    "law", [*(pytest.param(one, marks=pytest.mark.slow) for one in ("preisach", "cs")), "limiting_loop"]
)
def test_a_device_is_fitted_with_another_law(law, tmp_path):
    steps = 40
    k = np.arange(steps)
    current = np.repeat(6.1e-3 + 2.4e-3 * np.cos(np.pi * k) * (1.0 - k / steps), 13)
    device = truth("integrated", seed=4)
    result, parameters = fit_model(
        [device.simulate(current, seed=1)], "integrated", law=law, self_sensing=False
    )
    stored = "preisach" if law == "cs" else law
    assert (parameters["model.resistance.law"], parameters["model.deflection.law"]) == (stored, stored)
    result.model.save(tmp_path / "model.yaml")
    levels = np.repeat(np.random.default_rng(1).uniform(4e-3, 8e-3, 40), 10)
    ours = DeviceModel.load(tmp_path / "model.yaml").simulate(levels, noise=False)
    true = device.simulate(levels, noise=False)
    gap = np.log10(ours["film_resistance"] / true["film_resistance"])
    assert np.sqrt(np.mean(gap**2)) < 0.03 * np.ptp(np.log10(true["film_resistance"]))
    assert result.model.sensors["film_resistance"].misfit > 0.0
    assert any("held-out error" in note for note in result.notes)
