"""Commands stamped at either end of their interval, or late by a constant: found, and undone."""

import numpy as np
import pytest
from vo2_models.device import DeviceModel, truth
from vo2_models.identification.command_delay import command_delay
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, TIP_DEFLECTION, Recording, aligned

PERIOD = 1e-3


@pytest.fixture(scope="module")
def recording() -> Recording:
    rng = np.random.default_rng(3)
    current = np.repeat(rng.uniform(4e-3, 8e-3, 60), 7)
    return truth("integrated", seed=1).simulate(current, seed=2)


def _stamped(recording: Recording, shift: int) -> Recording:
    """The recording of a rig whose commands stand `shift` samples before where they act."""
    command = np.roll(recording[COMMANDED_CURRENT], -shift)
    return Recording(recording.time_s, {**recording.channels, COMMANDED_CURRENT: command}, recording.device)


@pytest.mark.parametrize("shift", [-1, 0, 1, 4])
def test_a_shift_of_whole_samples_is_found_and_undone(recording, shift):
    stamped = _stamped(recording, shift)
    delay = command_delay([stamped])
    assert delay == pytest.approx(shift * PERIOD, abs=2e-3 * PERIOD)
    inside = slice(10, -10)
    again = aligned(stamped, shift * PERIOD)[COMMANDED_CURRENT][inside]
    assert again == pytest.approx(recording[COMMANDED_CURRENT][inside], rel=1e-9)


def test_a_constant_between_samples_is_found(recording):
    late = aligned(recording, 2.4 * PERIOD)
    channels = {
        COMMANDED_CURRENT: recording[COMMANDED_CURRENT],
        HEATER_CURRENT: late[COMMANDED_CURRENT] + np.random.default_rng(0).normal(0, 1e-6, len(recording)),
    }
    assert command_delay([Recording(recording.time_s, channels)]) == pytest.approx(2.4 * PERIOD, rel=0.02)


def test_nothing_to_tell_it_from_is_no_delay(recording):
    channels = {name: values for name, values in recording.channels.items() if name != HEATER_CURRENT}
    assert command_delay([Recording(recording.time_s, channels)]) == 0.0
    still = {COMMANDED_CURRENT: np.full(50, 1.0), HEATER_CURRENT: np.full(50, 1.0)}
    assert command_delay([Recording(np.arange(50.0), still)]) == 0.0


def test_what_is_before_the_first_command_stays_unknown():
    command = np.array([np.nan, np.nan, 1.0, 2.0, 3.0])
    moved = aligned(Recording(np.arange(5.0), {COMMANDED_CURRENT: command}), 1.0)[COMMANDED_CURRENT]
    assert np.isnan(moved[:3]).all() and moved[3:] == pytest.approx([1.0, 2.0])


def test_the_model_file_carries_the_delay(tmp_path):
    model = DeviceModel("integrated", command_delay=-PERIOD)
    model.save(tmp_path / "model.yaml")
    assert "model.recording.command_delay: -0.001" in (tmp_path / "model.yaml").read_text(encoding="utf-8")
    assert DeviceModel.load(tmp_path / "model.yaml").command_delay == -PERIOD
    assert TIP_DEFLECTION not in DeviceModel.load(tmp_path / "model.yaml").sensors
