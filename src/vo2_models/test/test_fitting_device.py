"""The whole fit on simulated devices it shares no hysteresis law with, judged on a sequence it has not seen."""

import os
import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from vo2_models.device import preset, truth
from vo2_models.diagnosis.noise import level_from_differences
from vo2_models.identification.completion import noise_of_recordings
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.identification.grid import on_grid
from vo2_models.identification.model_fit import fit_model
from vo2_models.identification.problem import Problem
from vo2_models.numerics import parallel
from vo2_models.prediction import predict
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording


def _calibration(name: str) -> np.ndarray:
    if name == "integrated":
        return np.repeat(damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 21)), 10)
    turns = [0.05, -1.15, -0.2, -1.1, -0.3, -1.0, -0.4, -0.95, -0.5, -0.9, -0.6, -0.8]
    return np.interp(np.arange(6000), np.linspace(0, 6000, 12), turns)


def _unseen(name: str) -> np.ndarray:
    low, high = sorted(preset(name).operating_range)
    count, hold = (400, 10) if name == "integrated" else (40, 120)
    return np.repeat(random_levels(low, high, count, seed=77), hold)


@pytest.fixture(scope="module", params=["integrated", "peltier"])
def fitted(request):
    name = request.param
    device = truth(name, seed=6)
    return name, device, fit_device([device.simulate(_calibration(name), seed=1)], name)


def test_prediction_of_an_unseen_sequence(fitted):
    name, device, result = fitted
    measured = device.simulate(_unseen(name), noise=False)
    model = result.model.simulate(_unseen(name), noise=False)
    deflection = np.abs(model[TIP_DEFLECTION] - measured[TIP_DEFLECTION]) / preset(name).deflection_range
    resistance = np.log10(model[RESISTANCE] / measured[RESISTANCE])
    assert deflection.mean() < 0.005
    assert np.sqrt(np.mean(resistance**2)) < 0.012
    if name == "peltier":
        assert np.abs(model[STAGE_TEMPERATURE] - measured[STAGE_TEMPERATURE]).max() < 0.05


@pytest.mark.parametrize("difference", [-0.8, 0.5])
def test_the_loops_of_a_model_are_as_wide_as_those_of_its_device(difference):
    effects = {"loop_width_difference": {"difference": difference}}
    device = truth("peltier", seed=6, effects=effects)
    model = fit_device([device.simulate(_calibration("peltier"), seed=1)], "peltier").model
    assert model.deflection.loop_width - model.resistance.loop_width == pytest.approx(difference, abs=0.05)


def test_noise_and_time_constant(fitted):
    name, device, result = fitted
    for channel, level in preset(name).noise.items():
        assert result.model.sensors[channel].noise == pytest.approx(level, rel=0.12)
        assert result.model.sensors[channel].colour == ()
    tau = device.prepared(preset(name).sample_period)
    from vo2_models.device.coefficients import Coefficient

    true = tau[Coefficient.TIME_CONSTANT]
    assert result.model.scalars["thermal.time_constant"] == pytest.approx(true, rel=0.03)
    assert not result.settled
    assert set(result.model.uncertainty) >= {
        "thermal.time_constant",
        "resistance.weights",
        "deflection.weights",
    }


def test_time_constant_is_as_uncertain_as_the_excitation_leaves_it():
    """A staircase of small steps says little about it and the fit says so; large steps settle it."""
    from vo2_models.device.coefficients import Coefficient

    device = truth("integrated", seed=5)
    stairs = _calibration("integrated")
    steps = np.r_[stairs, np.repeat(random_levels(3.68e-3, 8.49e-3, 60, seed=99), 10)]
    true = device.coefficients[Coefficient.TIME_CONSTANT]
    for current, tolerance, warned in ((stairs, 0.05, True), (steps, 0.004, False)):
        result = fit_device([device.simulate(current, seed=1)], "integrated")
        found = result.model.scalars["thermal.time_constant"]
        assert abs(found / true - 1.0) < tolerance
        assert any("no step of the drive is large" in note for note in result.notes) == warned
        assert (result.model.uncertainty["thermal.time_constant"][0] > 0.01 * true) == warned


def test_missing_channels(fitted):
    name, device, _ = fitted
    run = device.simulate(_calibration(name), seed=1)
    part = Recording(run.time_s, {k: run[k] for k in (HEATER_CURRENT, RESISTANCE)}, name)
    result = fit_device([part], name, plays=6)
    assert not result.model.deflection.present
    assert any("tip_deflection" in note for note in result.notes)
    again = result.model.simulate(_unseen(name), noise=False)[RESISTANCE]
    expected = device.simulate(_unseen(name), noise=False)[RESISTANCE]
    assert np.std(np.log10(again / expected)) < (0.02 if name == "integrated" else 0.12)


def test_recording_that_starts_settled():
    """A bag that begins with a warm device: the fit notices and says so."""
    device = truth("integrated", seed=3)
    current = np.repeat(damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 16))[::-1][:100], 10)
    run = device.simulate(current, seed=1, settled=True)
    result = fit_device([run], "integrated", plays=8)
    assert result.settled
    assert any("settled" in note for note in result.notes)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda r: Recording(r.time_s, {HEATER_CURRENT: r[HEATER_CURRENT]}), "film_resistance"),
        (lambda r: Recording(r.time_s, {RESISTANCE: r[RESISTANCE]}), "heater_current"),
        (
            lambda r: Recording(r.time_s, {HEATER_CURRENT: np.full(len(r), 5e-3), RESISTANCE: r[RESISTANCE]}),
            "operating range",
        ),
        (lambda r: r.slice(0, 60), "measured|operating range"),
    ],
)
def test_unusable_recordings_are_refused(change, word):
    run = truth("integrated", seed=3).simulate(_calibration("integrated"), seed=1)
    with pytest.raises(ValueError, match=word):
        fit_device([change(run)], "integrated")


EFFECTS: dict[str, tuple[dict[str, float], float]] = {
    "latent_heat": ({"latent": 12.0}, 0.08),
    "creep": ({"share": 0.08, "time_constant": 0.2}, 0.08),
    "transition_kinetics": ({"time_constant": 1e-3}, 0.1),
    "cooling_asymmetry": ({"ratio": 0.25}, 0.08),
    "series_resistance": ({"resistance": 900.0}, 0.08),
}


@pytest.fixture(scope="module")
def calibrated():
    device = truth("integrated", seed=6)
    return fit_device([device.simulate(_calibration("integrated"), seed=1)], "integrated").model


@pytest.mark.parametrize("name", EFFECTS)
def test_problem_finds_an_effect_of_the_ground_truth(name, calibrated):
    values, tolerance = EFFECTS[name]
    levels = np.r_[
        damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 9)), random_levels(3.68e-3, 8.49e-3, 150, seed=2)
    ]
    run = truth("integrated", seed=6, effects={name: values}).simulate(np.repeat(levels, 20), seed=5)
    free = [f"effects.{name}.{parameter}" for parameter in values]
    problem = Problem(calibrated, [on_grid(run)], ["thermal.time_constant", *free])
    start = problem.start.copy()
    for k, coordinate in enumerate(problem.coordinates[1:], start=1):
        start[k] = np.log(0.05) if coordinate.logarithmic else coordinate.scale
    found = problem.solve(start)
    assert found.cost < 0.2 * np.sum(problem.residual(problem.start) ** 2)
    model = problem.model_at(found.theta)
    for parameter, value in values.items():
        assert float(model.effects[name][parameter]) == pytest.approx(value, rel=tolerance)


def test_problem_is_flat_at_the_neutral_value_and_columns_are_exact(calibrated, monkeypatch):
    """The forced feedback steps change nothing when every effect is neutral, and threads do not mix columns."""
    run = truth("integrated", seed=6).simulate(
        np.repeat(random_levels(3.68e-3, 8.49e-3, 60, seed=2), 10), seed=5
    )
    grid = on_grid(run)
    plain = Problem(calibrated, [grid], ["thermal.time_constant"])
    many = Problem(
        calibrated,
        [grid],
        ["thermal.time_constant", "driver.dead_time", "deflection", "effects.latent_heat.latent"],
    )
    assert np.allclose(plain.residual(plain.start), many.residual(many.start), atol=1e-3)
    places = set()

    class Watched(Problem):
        def residual(self, theta):
            places.add(threading.current_thread())
            return super().residual(theta)

    monkeypatch.setattr(parallel, "CORES", 2)
    jacobian = many.jacobian(many.start)
    parallel.use_cores(1)
    assert np.array_equal(Watched(calibrated, [grid], many.free).jacobian(many.start), jacobian)
    assert places == {threading.current_thread()}  # the one core that the process may take
    assert jacobian.shape == (2 * len(run), many.start.size)
    # the deflection bank reaches the deflection alone
    half = len(run)
    first = next(k for k, c in enumerate(many.coordinates) if c.name.startswith("deflection"))
    assert np.all(jacobian[:half, first : first + 10] == 0.0)
    assert np.any(jacobian[half:, first : first + 10] != 0.0)


@pytest.mark.parametrize(("given", "cores"), [("1", 1), ("3", 3), ("", None), ("0", None), ("two", None)])
def test_the_environment_may_say_how_many_cores_a_process_takes(monkeypatch, recwarn, given, cores):
    monkeypatch.setenv("VO2_CORES", given)
    assert parallel._cores() == (cores or min(len(os.sched_getaffinity(0)), 8))
    assert [str(one.message)[:16] for one in recwarn] == (
        ["VO2_CORES: found"] if given in ("0", "two") else []
    )


def test_problem_refuses_unknown_names(calibrated):
    grid = on_grid(truth("integrated").simulate(np.linspace(4e-3, 8e-3, 50), seed=1))
    for name, word in (("thermal.colour", "thermal.colour"), ("effects.creep.sharee", "sharee")):
        with pytest.raises(ValueError, match=word):
            Problem(calibrated, [grid], [name])


@pytest.mark.slow
def test_outliers_are_left_out_and_the_recordings_need_not_have_the_same_channels():
    device = truth("integrated", seed=6)
    first, second = (device.simulate(_calibration("integrated"), seed=seed) for seed in (1, 2))
    film = {name: second[name] for name in (HEATER_CURRENT, RESISTANCE)}
    film[RESISTANCE] = film[RESISTANCE] * np.where(np.arange(len(second)) % 301 == 300, 3.0, 1.0)
    threads = set()

    def look(_what, _share):
        threads.update(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

    with threadpool_limits(2, user_api="blas"):
        result, _ = fit_model(
            [first, Recording(second.time_s, film, "integrated")],
            "integrated",
            self_sensing=False,
            progress=look,
        )
    assert threads == {1}
    (told,) = [note for note in result.notes if "outliers" in note]
    assert f"outliers in {RESISTANCE}" in told and f" {len(second) // 301} of them" in told


def test_a_stage_tells_that_a_recording_began_at_rest_at_its_first_current():
    """The film is far below its transition there and does not tell; a cold start would show in the stage alone."""
    drive = _calibration("peltier")
    drive = np.concatenate([np.full(600, -0.1), drive[drive < -0.1]])
    device = truth("peltier", seed=6)
    warm = fit_device([device.simulate(drive, seed=1, settled=True)], "peltier")
    assert warm.settled and any("settled at its first current" in note for note in warm.notes)
    noise = preset("peltier").noise[STAGE_TEMPERATURE]
    assert warm.model.sensors[STAGE_TEMPERATURE].residual < 1.5 * noise
    cold = fit_device([device.simulate(drive, seed=1)], "peltier")
    assert not cold.settled and cold.model.sensors[STAGE_TEMPERATURE].residual < 1.5 * noise


def test_transients_that_the_loops_hide_are_not_called_missing():
    device = truth("integrated", seed=6)
    current = np.repeat(random_levels(*preset("integrated").operating_range, 30, seed=3), 10)
    clean = device.simulate(current, seed=1)
    wander = np.repeat(np.random.default_rng(3).standard_normal(3), 100)
    channels = dict(clean.channels)
    channels[RESISTANCE] = channels[RESISTANCE] * 10.0**wander
    channels[TIP_DEFLECTION] = channels[TIP_DEFLECTION] + 40e-6 * wander
    (note,) = fit_device([Recording(clean.time_s, channels, "integrated")], "integrated").notes
    assert note.startswith("the recording has transients, but what the loops leave over hides the lag")
    slow = device.simulate(np.repeat(damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 8)), 20), dt=0.04)
    (note,) = fit_device([slow], "integrated").notes
    assert note.startswith("no transients in the recording")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 7])
def test_bounds_are_wider_where_a_loop_is_steep_and_hold_on_drives_that_the_fit_has_not_seen(seed):
    device = truth("integrated", seed=seed)
    calibration = np.concatenate([_calibration("integrated"), _unseen("integrated")])
    result, _ = fit_model([device.simulate(calibration, seed=1)], "integrated", self_sensing=False)
    sensor = result.model.sensors[TIP_DEFLECTION]
    assert sensor.misfit > 0.9 * sensor.residual
    low, high = preset("integrated").operating_range
    levels = np.repeat(random_levels(low, high, 200, seed=5), 20)
    small = np.repeat(random_levels(0.65 * high + 0.35 * low, 0.75 * high + 0.25 * low, 100, seed=5), 20)
    for drive, least in ((levels, 0.93), (np.concatenate([[low, high], small]), 0.7)):
        found = predict(result.model, device.simulate(drive, seed=9))
        for role, channel in found.channels.items():
            size = (
                np.log10(channel.upper / channel.lower) / 2
                if role == RESISTANCE
                else (channel.upper - channel.lower) / 2
            )
            kept = result.model.sensors[role]
            noise = kept.noise / np.log(10.0) if role == RESISTANCE else kept.noise
            assert channel.inside > least
            assert size.min() > 1.95 * noise and size.max() > 1.3 * size.min()


def test_noise_is_taken_where_a_response_moves_least():
    rng = np.random.default_rng(8)
    phase = np.linspace(0.0, 12.0 * np.pi, 300)
    y = 1e-3 * np.tanh(3.0 * np.sin(phase)) + 4e-6 * rng.standard_normal(300)
    known = Recording(np.arange(300.0), {TIP_DEFLECTION: y}, "")
    assert noise_of_recordings([known], TIP_DEFLECTION) == pytest.approx(4e-6, rel=0.25)
    assert level_from_differences(y) > 8e-6
    steps = Recording(np.arange(300.0), {TIP_DEFLECTION: 1e-5 * np.round(y / 1e-5)}, "")
    assert noise_of_recordings([steps], TIP_DEFLECTION) == level_from_differences(steps[TIP_DEFLECTION])
