"""Fit of a device that is only a file: no current, no heat, no resistance."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import StateSpace, lfilter, lsim
from vo2_models.device.description import described
from vo2_models.device.mode import mode_step
from vo2_models.hysteresis.laws.bounded_plays import BoundedPlays
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.identification.model_fit import fit_model
from vo2_models.identification.rig_dynamics import RigDynamics, relaxing, ringing
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

VOLTS = (0.0, 60.0)


def _device(**response: object):
    entry = {"unit": "m", **response}
    return described(
        {
            "schema": "vo2-device/1",
            "id": "stack_07",
            "drive": {"channel": "drive_voltage", "unit": "V", "limits": list(VOLTS)},
            "responses": {"film_resistance" if response.get("unit") == "ohm" else "extension": entry},
        },
        "stack",
    )


def _drive(count: int, period: int, *, shrink: bool = True) -> np.ndarray:
    phase = np.arange(count) / period
    size = np.linspace(1.0, 0.2, count) if shrink else np.ones(count)
    rate = phase + 0.15 * np.sin(phase) if shrink else phase
    return 30.0 * (1.0 - size * np.cos(2 * np.pi * rate))


def _law() -> PreisachOperator:
    walls = np.linspace(*VOLTS, 31)
    high, low = np.tril_indices(30)
    density = np.exp(-0.5 * ((high - low - 4) / 4) ** 2)
    return PreisachOperator(walls, density * 2e-8 / density.mean())


def _measured(drive: np.ndarray, *, lag: float = 0.0, sign: float = 1.0) -> np.ndarray:
    felt = drive
    if lag:
        keep = np.exp(-1.0 / lag)
        felt = lfilter([1 - keep], [1, -keep], drive, zi=[keep * drive[0]])[0]
    law = _law()
    clean = law(felt if sign > 0 else VOLTS[1] - felt)
    return clean + np.random.default_rng(4).normal(0.0, 0.002 * np.ptp(clean), clean.size)


def _recording(drive: np.ndarray, values: np.ndarray, dt: float = 0.01) -> Recording:
    return Recording(dt * np.arange(drive.size), {HEATER_CURRENT: drive, TIP_DEFLECTION: values}, "stack_07")


def _error(model, drive: np.ndarray, values: np.ndarray, dt: float = 0.01) -> float:
    found = model.simulate(drive, dt=dt, noise=False, settled=True)[TIP_DEFLECTION]
    return float(np.sqrt(np.mean((found - values) ** 2)) / np.ptp(values))


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_an_open_file_is_fitted_in_lag_loop_and_sense(sign):
    drive = _drive(1500, 150)
    values = _measured(drive, lag=6.0, sign=sign)
    seen = np.where(np.arange(1500) < 1000, values, np.nan)
    result, parameters = fit_model([_recording(drive, seen)], _device().key)
    model = result.model
    assert model.scalars["thermal.time_constant"] == pytest.approx(0.06, rel=0.05)
    assert np.sign(model.description.operating_range[1] - model.description.operating_range[0]) == sign
    # range, noise and sampling are the recording's
    assert model.description.deflection_range == pytest.approx(np.nanmax(seen) - np.nanmin(seen), rel=1e-3)
    assert model.description.sample_period == pytest.approx(0.01)
    assert model.sensors[TIP_DEFLECTION].noise == pytest.approx(0.002 * np.ptp(values), rel=0.3)
    assert _error(model, drive, values) < 0.01
    misfit = model.sensors[TIP_DEFLECTION].misfit
    # what is left of held-out blocks is more than noise, and no part of the loop
    assert 0.8 * 0.002 * np.ptp(values) < misfit < 0.01 * np.ptp(values)
    assert parameters["model.sensors.tip_deflection.misfit"] == misfit
    assert not any("one rate" in note or "same size" in note for note in result.notes)


@pytest.mark.slow
def test_a_lag_that_begins_with_the_next_sample_is_a_lag_and_a_delay():
    """A logger writes a drive as it is set, and the response before that acts."""
    drive = np.concatenate([_drive(1000, 150), np.repeat(np.random.default_rng(6).uniform(*VOLTS, 100), 10)])
    values = np.concatenate([[np.nan], _measured(drive, lag=4.0)[:-1]])
    result, _ = fit_model([_recording(drive, values)], _device().key)
    assert result.model.scalars["driver.dead_time"] == pytest.approx(0.01)
    assert result.model.scalars["thermal.time_constant"] == pytest.approx(0.04, rel=0.05)
    assert result.model.uncertainty["thermal.time_constant"][0] < 0.002
    assert not result.model.effects


@pytest.mark.slow
def test_the_lag_of_a_butterfly_is_found():
    """An elongation goes as the square of the magnetisation: no sum of plays of one sign turns within the loop."""
    drive = np.concatenate([_drive(1000, 150), np.repeat(np.random.default_rng(6).uniform(*VOLTS, 100), 10)])
    keep = np.exp(-1.0 / 4.0)
    felt = lfilter([1 - keep], [1, -keep], drive, zi=[keep * drive[0]])[0]
    high, low = np.tril_indices(30)
    density = np.exp(-0.5 * ((high - low - 10) / 2) ** 2 - 0.5 * ((high + low - 30) / 8) ** 2)
    magnetised = PreisachOperator(np.linspace(*VOLTS, 31), density)(felt)
    magnetised = 2.0 * (magnetised - magnetised.min()) / np.ptp(magnetised) - 1.0
    values = 1e-5 * (magnetised**2 + np.random.default_rng(4).normal(0.0, 0.002, drive.size))
    result, _ = fit_model([_recording(drive, values)], _device().key)
    assert result.model.scalars["thermal.time_constant"] == pytest.approx(0.04, rel=0.15)
    assert result.model.scalars["driver.dead_time"] == 0.0
    assert any("of both signs" in note for note in result.notes)
    # with the lag that plays of one sign find, 2.7 % are left
    assert np.nanstd(result.residuals[TIP_DEFLECTION]) < 0.02 * np.ptp(values)


@pytest.mark.slow
def test_loops_that_relax_are_told_from_a_slow_drive():
    """What has hysteresis comes late, what has none at once: a lag of the drive and a slow sensor make both late."""
    drive = np.repeat(np.random.default_rng(6).uniform(*VOLTS, 150), 10)
    law, keep = _law()(drive), np.exp(-1.0 / 4.0)
    late = lfilter([1 - keep], [1, -keep], law, zi=[keep * law[0]])[0]
    clean = late + 0.3 * np.ptp(law) * drive / VOLTS[1]
    values = clean + np.random.default_rng(4).normal(0.0, 0.002 * np.ptp(clean), clean.size)
    result, parameters = fit_model([_recording(drive, values)], _device().key)
    name = "model.effects.transition_kinetics.time_constant"
    assert parameters[name] == pytest.approx(0.04, rel=0.1)
    assert any("relaxes with a time constant" in note for note in result.notes)
    assert not any("rings" in note for note in result.notes)
    assert result.model.scalars["driver.dead_time"] == 0.0
    # the simulation is what was fitted
    error = _error(result.model, drive, values) * np.ptp(values)
    assert error == pytest.approx(np.std(result.residuals[TIP_DEFLECTION][1:]), rel=0.05)
    assert error < 0.006 * np.ptp(values)


@pytest.mark.slow
def test_a_response_that_rings_is_fitted_with_its_mode():
    """A stack with a mass: steps make it overshoot. The mode acts behind the loops, on all of the response."""
    drive = np.concatenate([_drive(1000, 150), np.repeat(np.random.default_rng(6).uniform(*VOLTS, 50), 20)])
    times, law = np.arange(drive.size), _law()(drive)
    mode = StateSpace([[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])  # w = 1, zeta = 0.1
    turn = 2.0 * np.pi * 12.0 * 0.01  # rad a sample at 12 Hz
    clean = law[0] + lsim(mode, law - law[0], turn * times)[1]
    values = clean + np.random.default_rng(4).normal(0.0, 0.002 * np.ptp(clean), clean.size)
    result, parameters = fit_model([_recording(drive, values)], _device().key)
    name = "model.effects.cantilever_resonance"
    assert parameters[f"{name}.frequency"] == pytest.approx(12.0, rel=0.02)
    assert parameters[f"{name}.damping"] == pytest.approx(0.1, rel=0.15)
    assert any("extension rings at 1" in note for note in result.notes)
    # the simulation is what was fitted, and no ring is left
    error = _error(result.model, drive, values) * np.ptp(values)
    assert error == pytest.approx(np.std(result.residuals[TIP_DEFLECTION][1:]), rel=0.05)
    assert error < 0.01 * np.ptp(values)


@pytest.mark.slow
def test_a_drive_that_is_held_is_told_where_a_fast_mode_shows_it():
    """A converter at 1 kHz, an amplifier of 0.3 ms and a mode at 210 Hz: a response goes far from straight between samples."""
    radii = np.array([0.02, 0.05, 0.1, 0.2, 0.35])
    law = BoundedPlays(1e-5 * np.array([0.3, 0.2, 0.2, 0.2, 0.1]), radii, *VOLTS, 1.0, [0.0, 1e-7, 4e-10])
    fine, dt = 20, 1e-3
    mode = StateSpace([[0.0, 1.0], [-1.0, -0.08]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])

    def measured(drive, seed):
        keep = np.exp(-dt / fine / 0.3e-3)
        held = np.repeat(drive, fine)
        free = law.run(lfilter([1 - keep], [1, -keep], held, zi=[keep * held[0]])[0])
        times = 2.0 * np.pi * 210.0 * dt / fine * np.arange(free.size)
        values = free[0] + lsim(mode, free - free[0], times)[1]
        return values[fine - 1 :: fine] + 3e-9 * np.random.default_rng(seed).normal(size=drive.size)

    def levels(seed):
        return np.repeat(np.random.default_rng(seed).uniform(*VOLTS, 25), 60)

    drive, later = np.concatenate([_ramps(1, 1000), levels(6)]), levels(7)
    model = fit_model([_recording(drive, measured(drive, 11), dt)], _device().key)[0].model
    again = type(model).from_parameters(model.to_parameters())
    assert again.scalars["driver.held"] == 1.0
    assert again.effects["cantilever_resonance"]["frequency"] == pytest.approx(210.0, rel=0.005)
    assert again.scalars["thermal.time_constant"] == pytest.approx(0.3e-3, rel=0.1)
    straight = replace(again, scalars={**again.scalars, "driver.held": 0.0})
    left = [
        np.std(one.simulate(later, dt=dt, noise=False, settled=True)[TIP_DEFLECTION] - measured(later, 12))
        for one in (again, straight)
    ]
    # what plays do after a reversal within a sample is not followed: 0.3 % of the span
    assert left[0] < 3e-8 and left[0] < 0.1 * left[1]


def test_a_mode_moves_as_its_effect_does_in_the_simulation():
    dynamics = RigDynamics(frequency=12.0, damping=0.1)
    grid = SimpleNamespace(dt=0.01, current=np.zeros(60))
    columns = np.random.default_rng(3).normal(size=(61, 2))
    found, powers = ringing([grid], dynamics)(columns, columns)
    assert np.array_equal(found, powers)
    step = mode_step(12.0, 0.1, 0.01)
    z, last = np.array([columns[1], np.zeros(2)]), columns[1]
    for row, want in zip(columns[1:], found[1:], strict=True):
        z = step @ np.vstack([z, last, row])
        last = row
        assert np.allclose(want, z[0])


def test_each_recording_relaxes_from_rest_in_its_own_time():
    device, dynamics = _device(), RigDynamics(relaxation=0.05)
    rng = np.random.default_rng(3)
    grids = [SimpleNamespace(dt=dt, current=rng.normal(size=n)) for dt, n in ((0.01, 40), (0.03, 25))]
    columns = rng.normal(size=(67, 3))
    found = relaxing(grids, device, dynamics).through(columns)
    for grid, rows in zip(grids, (slice(0, 41), slice(41, 67)), strict=True):
        assert np.array_equal(found[rows], relaxing([grid], device, dynamics).through(columns[rows]))
        first, left = columns[rows][1], np.exp(-grid.dt / 0.05)
        assert np.allclose(found[rows][1], first)  # settled
        # the loop coordinate is quick against the samples here: a step relaxes by itself
        step = np.r_[np.zeros((1, 1)), np.zeros((1, 1)), np.ones((grid.current.size - 1, 1))]
        shown = relaxing([grid], replace(device, time_constant=1e-9), dynamics).through(step)[1:, 0]
        assert np.allclose(shown, 1.0 - left ** np.arange(shown.size))


def test_without_a_lag_none_is_found_and_one_loop_is_said_to_be_one():
    drive = _drive(600, 150, shrink=False)
    result, _ = fit_model([_recording(drive, _measured(drive))], _device().key)
    assert result.model.scalars["thermal.time_constant"] < 0.002
    assert result.model.scalars["driver.dead_time"] == 0.0
    notes = " ".join(result.notes)
    assert "every swing of drive_voltage has the same size, 60 V" in notes
    assert "drive_voltage has one rate" in notes


def test_fifty_samples_of_a_resistance_are_enough_to_say_so():
    drive = np.concatenate([np.linspace(0, 60, 25), np.linspace(60, 0, 25)])
    ohm = 10.0 ** (5.0 - 2e5 * _measured(drive))
    recording = Recording(np.arange(50.0), {HEATER_CURRENT: drive, RESISTANCE: ohm})
    result, _ = fit_model([recording], _device(unit="ohm").key, names=["sweep"])
    assert "sweep: 50 samples are few" in " ".join(result.notes)
    gap = np.log10(result.model.simulate(drive, dt=1.0, noise=False, settled=True)[RESISTANCE] / ohm)
    assert np.sqrt(np.mean(gap**2)) < 0.03 * np.ptp(np.log10(ohm))


def test_where_the_calibration_is_not_represented_is_told():
    drive = _drive(1200, 150)
    values = _measured(drive)
    values[700:760] += 0.3 * np.ptp(values)
    result, _ = fit_model([_recording(drive, values)], _device().key)
    (note,) = [note for note in result.notes if "does not represent its own calibration" in note]
    assert "lies between 6.61 and 7.2" in note or "lies between 7.2" in note


@pytest.mark.slow
def test_commands_stamped_at_the_end_of_their_interval_are_found():
    steps = np.repeat(np.random.default_rng(1).uniform(*VOLTS, 120), 8)
    recording = _recording(steps, _measured(steps))
    channels = {**recording.channels, COMMANDED_CURRENT: np.roll(steps, 1)}
    late = Recording(recording.time_s, channels, "stack_07")
    result, parameters = fit_model([late], _device().key)
    assert result.model.command_delay == pytest.approx(-0.01, rel=1e-3)
    assert parameters["model.recording.command_delay"] == result.model.command_delay
    assert any("commands act -0.01 s after" in note for note in result.notes)


def test_recordings_that_cannot_be_fitted():
    with pytest.raises(ValueError, match="found 10 samples, need at least 20"):
        fit_model([_recording(np.linspace(0, 60, 10), np.zeros(10))], _device().key)
    drive = np.linspace(0, 60, 100)
    other = Recording(np.arange(100.0), {HEATER_CURRENT: drive, RESISTANCE: drive + 1})
    with pytest.raises(ValueError, match="found none of the responses extension"):
        fit_model([other], _device().key)
    still = _recording(np.full(100, 5.0), np.linspace(0, 1, 100))
    with pytest.raises(ValueError, match="drive_voltage varies by 0 V of an operating range of 60"):
        fit_model([still], _device().key)
    noise = np.random.default_rng(2).normal(size=400)
    with pytest.raises(ValueError, match="extension does not follow drive_voltage in a loop"):
        fit_model([_recording(_drive(400, 50), noise)], _device().key)


def test_a_response_that_stands_still_is_told_with_its_value():
    recording = _recording(_drive(400, 50), np.zeros(400))
    with pytest.raises(
        ValueError, match=r"^sweep: extension stands still at 0 m in every sample, .* check that it is"
    ):
        fit_model([recording], _device().key, names=["sweep"])


@pytest.mark.slow
def test_a_law_with_plays_takes_their_number():
    recording = _recording(drive := _drive(400, 50), _measured(drive))
    result, _ = fit_model([recording], _device().key, law="egpi", plays=3)
    assert np.size(result.model.deflection.weights) == 3


def _ramps(seed: int, count: int) -> np.ndarray:
    """Ramps of three rates between random levels, holds and jumps."""
    rng, at = np.random.default_rng(seed), 60.0
    parts = [np.zeros(20), np.linspace(0.0, at, 60), np.linspace(at, 0.0, 60)]
    at = 0.0
    while sum(part.size for part in parts) < count:
        to, held = rng.uniform(0.0, 60.0, 2)
        parts += [np.linspace(at, to, int(rng.choice([15, 40, 120])))]
        parts += [np.full(int(rng.integers(10, 60)), held if rng.random() < 0.2 else to)]
        at = float(parts[-1][-1])
    return np.concatenate(parts)[:count]


@pytest.mark.slow
@pytest.mark.parametrize(("front", "behind"), [(4.0, 0.0), (3.0, 8.0)])
def test_loops_that_do_not_saturate_are_fitted_to_their_noise_and_tell_both_lags(front, behind):
    """Twenty plays of Prandtl and Ishlinskii behind an amplifier, before a slow sensor; both lags in samples."""
    radii = np.linspace(0.0, 0.3, 20)
    weights = np.exp(-radii / 0.1)
    law = BoundedPlays(1e-5 * weights / weights.sum(), radii, *VOLTS, 1.0, [0.0, 1e-7, 4e-10])

    def lagged(values, samples):
        keep = np.exp(-1.0 / (20 * samples)) if samples else 0.0
        return lfilter([1 - keep], [1, -keep], values, zi=[keep * values[0]])[0]

    def measured(drive, seed):  # twenty steps a sample
        values = lagged(law.run(lagged(np.repeat(drive, 20), front)), behind)[19::20]
        return values + 3e-9 * np.random.default_rng(seed).normal(size=drive.size)

    drive, later = _ramps(1, 3000), _ramps(2, 2500)
    result, _ = fit_model([_recording(drive, measured(drive, 11))], _device().key)
    model = result.model
    assert type(model.deflection) is BoundedPlays
    assert model.scalars["thermal.time_constant"] == pytest.approx(0.01 * front, rel=0.05)
    lag = model.effects.get("sensor_lag:tip_deflection", {"time_constant": 0.0})["time_constant"]
    assert lag == pytest.approx(0.01 * behind, rel=0.02)
    assert any("follows what has hysteresis" in note for note in result.notes) is bool(behind)
    again = type(model).from_parameters(model.to_parameters())
    values = again.simulate(later, dt=0.01, noise=False, settled=True)[TIP_DEFLECTION]
    assert np.std(values - measured(later, 12)) < 1.3 * 3e-9
    assert model.sensors[TIP_DEFLECTION].misfit < 1.3 * 3e-9
