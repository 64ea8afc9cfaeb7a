"""What the nuisance model of a diagnosis is built of, against plain references written from the definitions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from own_devices import STACK
from scipy.linalg import cholesky_banded, toeplitz
from scipy.signal import lfilter
from vo2_models.device import DeviceModel
from vo2_models.device.coefficients import HUGE, blocks
from vo2_models.device.description import preset
from vo2_models.device.model import SensorModel
from vo2_models.diagnosis.adequacy import adequacy_of, behind_the_loop, reached, sureness
from vo2_models.diagnosis.bend import Bend
from vo2_models.diagnosis.breakdown import branch_words, breakdown, locate
from vo2_models.diagnosis.courses import course_columns, gain_of_course, with_courses, worth_their_price
from vo2_models.diagnosis.current_reading import as_commanded, between_samples, current_reading
from vo2_models.diagnosis.explain import Explanation, Score, fit_jointly, price, score, switched
from vo2_models.diagnosis.hypotheses import MAGNITUDE_STEP, Hypothesis, hypotheses, windowed
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.loop_shape import _block_covariance
from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.diagnosis.nominal import Nominal, basis_of, rounded_with_noise
from vo2_models.diagnosis.nuisance import Constant, Coverage, constants_of, coverage
from vo2_models.diagnosis.pairs import _simplest, _untried, option_of, refit_about, trace
from vo2_models.diagnosis.part import prepare
from vo2_models.diagnosis.problem import LATEST, QUICKEST, linearise_problem
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.propagate_correction import as_sensed, corrected_film, propagate_correction
from vo2_models.diagnosis.report import _further_than_the_calibration, _missed_by_the_law, odds_of_rival
from vo2_models.diagnosis.search import _refitted
from vo2_models.diagnosis.tangent import Tangent
from vo2_models.effects import effects
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.digest import CalibrationDigest
from vo2_models.numerics.parallel import parallel_map
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

BEHIND = ("terminals", "structure", "sensor")
"""Stages of effects that the film does not feel."""


def _model() -> Nominal:
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    return Nominal.from_parameters(DeviceModel("integrated", resistance=bank).to_parameters())


def _with_deflection() -> DeviceModel:
    bend = PlayBank([2e-5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [1e-5, -2e-7])
    return replace(_model().model, deflection=bend)


def _blocks() -> tuple[Tangent, np.ndarray]:
    rng = np.random.default_rng(5)
    first, second, thermal = rng.normal(size=(6, 3)), rng.normal(size=(5, 2)), rng.normal(size=(13, 2))
    dense = np.zeros((13, 7))
    dense[:6, :3], dense[6:11, 3:5], dense[:, 5:] = first, second, thermal
    return Tangent(((slice(0, 6), first), (slice(6, 11), second)), thermal), dense


@pytest.mark.parametrize("bent", [False, True])
def test_a_tangent_in_blocks_is_the_dense_matrix(bent) -> None:
    tangent, dense = _blocks()
    if bent:  # the last of the dense columns are the constants', in both
        tangent = replace(tangent, thermal=dense[:, 6:], courses=dense[:, 5:6])
        weights = np.arange(7.0)
        assert np.allclose(tangent.of_courses(weights), 5.0 * dense[:, 5])
    rng = np.random.default_rng(6)
    vectors, weights = rng.normal(size=(13, 4)), rng.normal(size=(7, 2))
    assert tangent.shape == dense.shape
    assert np.allclose(tangent.gram(), dense.T @ dense)
    for count in (1, 4, 40):
        several = rng.normal(size=(13, count))
        assert np.allclose(tangent.against(several), dense.T @ several)
    silent = np.where(np.arange(13) < 6, 0.0, vectors[:, 0])
    for vector in (vectors[:, 0], silent):
        assert np.allclose(tangent.against(vector), dense.T @ vector)
    assert np.allclose(tangent.times(weights), dense @ weights)
    keep = rng.random(13) > 0.4
    assert np.allclose(tangent.restricted(keep).gram(), (dense * keep[:, None]).T @ (dense * keep[:, None]))
    rows = slice(6, 11)
    padded = np.zeros((13, 4))
    padded[rows] = vectors[rows]
    assert np.allclose(tangent.against_rows(rows, vectors[rows]), dense.T @ padded)
    assert np.allclose(tangent.times_rows(rows, weights), (dense @ weights)[rows])


def _autocovariance(noise: NoiseModel, size: int) -> np.ndarray:
    impulse = np.zeros(4000)
    impulse[0] = noise.innovation
    h = lfilter([1.0], [1.0, *(-a for a in noise.ar)], impulse)
    return np.array([h[: h.size - k] @ h[k:] for k in range(size)])


@pytest.mark.parametrize("ar", [(), (0.6,), (0.3, 0.4)])
def test_variance_of_sums_of_coloured_noise(ar) -> None:
    noise = NoiseModel(0.7, ar)
    full = toeplitz(_autocovariance(noise, 40))
    expected = [full[:n, :n].sum() for n in range(41)]
    assert np.allclose(noise.variance_of_sums(40), expected, rtol=1e-9)


def test_noise_that_fades_slowly_has_a_covariance_over_long_blocks() -> None:
    """Cut off while it fades, what is left is the covariance of nothing."""
    noise = NoiseModel(5e-9, (0.69592625, -0.22417225, -0.05556571, 0.57781745))
    count = np.tile([150.0, 1.0, 183.0, 1.0, 1.0, 102.0], 40)
    assert np.all(np.isfinite(cholesky_banded(_block_covariance(noise, count), lower=True)))


def test_covariance_of_block_means_is_that_of_the_series() -> None:
    noise, count = NoiseModel(0.5, (0.7,)), np.array([3.0, 5.0, 1.0, 4.0])
    series = toeplitz(_autocovariance(noise, 13))
    mean = np.zeros((4, 13))
    for k, (a, b) in enumerate([(0, 3), (3, 8), (8, 9), (9, 13)]):
        mean[k, a:b] = 1.0 / (b - a)
    expected = mean @ series @ mean.T
    banded = _block_covariance(noise, count, band=4)
    for lag in range(4):
        assert np.allclose(banded[lag, : 4 - lag], (1 - lag / 4) * np.diag(expected, -lag), rtol=1e-9)


def _drive(size: int = 1200) -> np.ndarray:
    steps = np.repeat(np.random.default_rng(3).uniform(4e-3, 8.4e-3, size // 40), 40)
    return np.ascontiguousarray(steps)


@pytest.mark.parametrize(("name", "parameter"), [("clock_offset", "delay"), ("sensor_lag", "time_constant")])
def test_a_late_sensor_sees_what_happens_between_samples(name, parameter) -> None:
    nominal, current, dt, late = _model(), _drive(), 1e-3, 0.4e-3
    found = nominal.respond(
        current, dt, effects={f"{name}:film_resistance": {"signal": RESISTANCE, parameter: late}}
    )
    parts = 200
    fine = 10.0 ** nominal.respond(np.repeat(current, parts), dt / parts).channels[RESISTANCE]
    if name == "clock_offset":
        exact = np.r_[np.full(80, fine[0]), fine][: fine.size]  # 0.4 ms are 80 fine samples
    else:
        keep = np.exp(-dt / parts / late)
        exact = lfilter([1 - keep], [1, -keep], fine, zi=[keep * fine[0]])[0]
    exact = np.log10(exact[parts - 1 :: parts])
    between_samples_only = nominal.respond(current, dt).channels[RESISTANCE]
    rough = np.interp(np.arange(current.size) - 0.4, np.arange(current.size), between_samples_only)
    error = np.abs(found.channels[RESISTANCE] - exact)[100:].max()
    assert error < 0.1 * np.abs(between_samples_only - exact)[100:].max()
    assert error < 0.5 * np.abs(rough - exact)[100:].max()


@pytest.mark.parametrize("name", [e.id for e in effects().values() if e.occurs_on("integrated")])
def test_what_acts_behind_the_film_may_share_its_simulation(name) -> None:
    effect = effects()[name]
    basis, current, dt = basis_of(DeviceModel("integrated")), _drive(), 1e-3
    rng = np.random.default_rng(2)
    fold = {
        c: basis.fold(rng.normal(size=basis.columns), span=s)
        for c, s in ((RESISTANCE, 1), (TIP_DEFLECTION, 5e-5))
    }
    model = _with_deflection()
    nominal = replace(_model(), model=model, corrections=fold)
    nominal.respond(current, dt, fine=False)
    drawn = effect.draw("integrated", rng)
    changes = {effect.id: drawn}
    shared = nominal.respond(current, dt, effects=changes, fine=False)
    chain = model.simulation.with_effects(changes)
    for channel in (RESISTANCE, TIP_DEFLECTION):  # a coarse converter is told by its mean
        chain.coefficients[blocks()[f"adc_quantization:{channel}"].active] = 0.0
    alone = propagate_correction(chain, corrected_film(chain, chain.run(current, dt=dt), dt, fold), dt)
    if effect.id != "adc_quantization":
        assert np.array_equal(shared.channels[RESISTANCE], np.log10(alone[:, 1]))
        assert np.array_equal(shared.channels[TIP_DEFLECTION], alone[:, 2])
    behind = effect.stage in BEHIND and drawn.get("signal") != HEATER_CURRENT
    assert nominal._films.cache_info().hits == behind


@pytest.mark.parametrize(
    ("channel", "changes"),
    [
        (RESISTANCE, {"averaging:film_resistance": {"signal": RESISTANCE, "window": 5e-3, "sampled": 1.0}}),
        (
            RESISTANCE,
            {"sensor_lag:film_resistance": {"signal": RESISTANCE, "time_constant": 4e-3, "sampled": 1.0}},
        ),
        (TIP_DEFLECTION, {"clock_offset:tip_deflection": {"signal": TIP_DEFLECTION, "delay": 7e-3}}),
        (
            TIP_DEFLECTION,
            {
                "creep": {"share": 0.2, "time_constant": 0.05},
                "sensor_gain_drift:tip_deflection": {"signal": TIP_DEFLECTION, "rate": 0.3},
            },
        ),
        (
            TIP_DEFLECTION,
            {"sensor_ripple:tip_deflection": {"signal": TIP_DEFLECTION, "amplitude": 1e-6, "pitch": 5e-6}},
        ),
        (TIP_DEFLECTION, {"transition_kinetics": {"time_constant": 8e-3}}),
        (
            RESISTANCE,
            {
                "transition_kinetics": {"time_constant": 8e-3},
                "sensor_lag:film_resistance": {
                    "signal": RESISTANCE,
                    "time_constant": 4e-3,
                    "sampled": 1.0,
                },
            },
        ),
    ],
)
def test_a_sensor_shows_a_change_of_the_loop_as_it_shows_the_loop(channel, changes) -> None:
    """A small change of the loop's shape, propagated, is the difference of two simulations, behind a steep ripple too."""
    current, dt, basis = _drive(), 1e-3, basis_of(DeviceModel("integrated"))
    nominal = replace(_model(), model=_with_deflection())
    weights = np.random.default_rng(2).normal(size=basis.columns)
    span = 1e-4 if channel == RESISTANCE else 1e-9
    fold = basis.fold(weights, span=span)
    before = nominal.respond(current, dt, effects=changes, fine=False)
    after = replace(nominal, corrections={channel: fold}).respond(current, dt, effects=changes, fine=False)
    column = fold(before.temperature)[:, None]
    given = channel == RESISTANCE or "ripple" in next(iter(changes))
    before_it = {key: values for key, values in changes.items() if not key.endswith(f":{channel}")}
    film = nominal.respond(current, dt, effects=before_it).channels[channel] if given else None
    found = as_sensed(nominal.model.simulation.with_effects(changes), channel, column, dt, film)[:, 0]
    expected = after.channels[channel] - before.channels[channel]
    late = slice(200, None)
    assert np.abs(found - expected)[late].max() < 0.02 * np.abs(expected).max()
    assert np.abs(column[:, 0] - expected)[late].max() > 0.1 * np.abs(expected).max()


def test_only_the_last_of_several_steps_is_returned_where_no_more_is_asked_for() -> None:
    chain, current, dt = _model().model.simulation, _drive(), 1e-3
    slow = {
        "sensor_lag": {"signal": RESISTANCE, "time_constant": 3e-3},
        "creep": {"share": 0.2, "time_constant": 0.05},
    }
    chain = chain.with_effects(slow)
    film = corrected_film(chain, chain.run(current, dt=dt), dt, {})
    assert np.array_equal(
        propagate_correction(chain, film, dt, every=4), propagate_correction(chain, film, dt)[3::4]
    )
    assert propagate_correction(chain, film, dt, every=7).shape == (current.size // 7, 9)


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"cantilever_resonance": {"share": 1.0, "frequency": 60.0, "damping": 0.01}},
        {"creep": {"share": 0.3, "time_constant": 0.1}},
        {"transition_kinetics": {"time_constant": 8e-3}},
    ],
)
def test_the_tangent_of_the_loop_is_what_a_changed_loop_changes(effects) -> None:
    model = replace(
        _model().model, deflection=PlayBank([2e-5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [1e-5, -2e-7])
    )
    noise = {RESISTANCE: NoiseModel(1e-3), TIP_DEFLECTION: NoiseModel(1e-8)}
    nominal, current, dt = replace(_model(), model=model, noise=noise), _drive(), 1e-3
    shown = nominal.respond(current, dt).channels
    time = dt * np.arange(current.size)
    channels = {
        HEATER_CURRENT: current,
        RESISTANCE: 10.0 ** shown[RESISTANCE],
        TIP_DEFLECTION: shown[TIP_DEFLECTION],
    }
    parts = [prepare(Recording(time, channels, "integrated"), nominal)]
    problem = linearise_problem(nominal, parts, effects=effects)
    for place, channel in enumerate((RESISTANCE, TIP_DEFLECTION)):
        shape, loop = problem.shapes[channel], problem.loops[channel]
        moved = replace(shape, mean=shape.mean + 0.1 * loop.directions[:, -1])
        changed = linearise_problem(
            nominal, parts, effects=effects, shapes={**problem.shapes, channel: moved}, loops=problem.loops
        )
        rows, block = problem.nuisance.blocks[place]
        change = problem.residual[rows] - changed.residual[rows]
        assert np.linalg.norm(change - 0.1 * block[:, -1]) < 0.01 * np.linalg.norm(change)


def test_switching_times_are_found_by_search() -> None:
    nominal, current, dt = _model(), _drive(3000), 1e-3
    nominal = replace(nominal, noise={RESISTANCE: NoiseModel(1e-3)})
    laser = {"rise": 0.8, "start": 0.731, "stop": 1.862}
    shown = nominal.respond(current, dt, effects={"laser_heating": laser}).channels[RESISTANCE]
    shown = shown + 1e-3 * np.random.default_rng(1).normal(size=shown.size)
    recording = Recording(
        dt * np.arange(current.size), {HEATER_CURRENT: current, RESISTANCE: 10.0**shown}, "integrated"
    )
    problem = linearise_problem(nominal, [prepare(recording, nominal)])
    hypothesis = Hypothesis(effects()["laser_heating"], "", (), {"rise": 0.1, "start": 0.01, "stop": 0.01})
    start = {"rise": 2.0, "start": 0.5, "stop": 2.2}
    found = switched(problem, hypothesis, start, problem.residual)
    assert abs(found["start"] - 0.731) < 0.02  # from 0.23 and 0.34 s off
    assert abs(found["stop"] - 1.862) < 0.02  # from 0.23 and 0.34 s off
    assert 0.4 < found["rise"] < 1.2


def test_no_residual_makes_the_device_much_quicker_than_it_was() -> None:
    problem = _changed({})
    moved = problem.moved(np.full(len(problem.constants), -1e3))
    before = {c.name: c.value for c in constants_of(problem.nominal)}
    assert moved["thermal.time_constant"] == QUICKEST * before["thermal.time_constant"]


def test_no_residual_asks_for_a_delay_that_the_simulation_cannot_hold() -> None:
    problem, lag = _changed({}), "driver.dead_time"
    problem = replace(problem, constants=(*problem.constants, Constant(lag, "s", 0.0, 1e-5)))
    shift = np.where([c.name == lag for c in problem.constants], 1e9, 0.0)
    longest = LATEST * problem.parts[0].dt
    assert problem.moved(shift)[lag] == longest
    found = hypotheses(_changed({}), "integrated", _changed({}).residual)
    hypothesis = next(h for h in found if h.record.id == "dead_time")
    assert hypothesis.moved("delay", longest, 1e9) == longest
    # both at their ends, and simulated between the samples for a slow driver
    slow = {"driver_slew": {"rate": 1.0}}
    (response,) = problem.responses(hypothesis.effects({"delay": longest}) | slow, shift)
    assert np.all(np.isfinite(response.temperature))


def test_what_scores_cannot_tell_is_tried_both_ways() -> None:
    """Scores take one step a sample: whether a sensor is late by itself or on its samples alone they do not see."""
    late = {"signal": RESISTANCE, "delay": 0.3e-3, "sampled": 0.0}
    problem = _changed({"clock_offset:film_resistance": late})
    hypothesis = next(
        h
        for h in hypotheses(problem, "integrated", problem.residual)
        if h.key == f"clock_offset:{RESISTANCE}"
    )
    starts = [
        Score(hypothesis, {"delay": 0.2e-3, "sampled": sampled}, problem.residual_chi_square)
        for sampled in (0.0, 1.0)
    ]
    fits = _refitted(problem, starts, Limits(), 2, Clock(lambda share, text: None, 1))
    stuck = fit_jointly(problem, [hypothesis], [starts[1].start], Limits())
    assert stuck.gain < 0.5 * fits[0].gain  # and would not be followed to the end
    for fit in fits:
        assert fit.values[0]["sampled"] == 0.0
        assert fit.values[0]["delay"] == pytest.approx(0.3e-3, rel=0.05)


def test_a_pair_with_fewer_parameters_is_named_where_the_others_cost_more_than_they_bring() -> None:
    problem = _changed({})
    dear, cheap, poor = (
        Explanation(
            hypotheses=(), values=(), chi_square=problem.count + chi, gain=0.0, covariance=np.zeros((0, 0)),
            coordinates=tuple((0, str(k)) for k in range(count)), deviation=np.zeros(0), tangent=np.zeros((0, 0)),
        )
        for chi, count in ((0.0, 4), (40.0, 2), (400.0, 1))
    )  # fmt: skip
    assert Limits().rival < 40.0  # told apart by chi-square, but not by what two parameters more cost
    assert _simplest([(problem, e) for e in (dear, cheap, poor)], Limits())[1] is cheap
    assert _simplest([(problem, e) for e in (dear, poor)], Limits())[1] is dear


def test_what_stays_on_is_never_switched_off() -> None:
    problem = _changed({"laser_heating": {"rise": 0.8, "start": 0.731}})
    hypothesis = Hypothesis(
        effects()["laser_heating"], "", ({"rise": 0.2},), {"rise": 0.1, "start": 0.01, "stop": 0.01}
    )
    found = switched(problem, hypothesis, {"rise": 2.0, "start": 0.5, "stop": HUGE}, problem.residual)
    assert abs(found["start"] - 0.731) < 0.02
    assert 0.4 < found["rise"] < 1.2  # the size is found, the time is not multiplied with it
    assert found["stop"] == HUGE


def test_when_it_was_on_is_asked_of_the_residual_at_hand() -> None:
    """What one effect leaves over may tell other times than the whole residual did."""
    early = _changed({"laser_heating": {"rise": 0.8, "start": 0.4, "stop": 1.1}})
    late = _changed({"laser_heating": {"rise": 0.8, "start": 1.9, "stop": 2.6}})
    left = [e.apply_inverse_covariance(e.residual) for e in (early, late)]
    before = next(h for h in hypotheses(early, "integrated", left[0]) if h.record.id == "laser_heating")
    after = windowed(late, before, left[1])
    for hypothesis, start, stop in ((before, 0.4, 1.1), (after, 1.9, 2.6)):
        windows = {(s["start"], s["stop"]) for s in hypothesis.starts if "start" in s}
        assert any(abs(on - start) < 0.3 and abs(off - stop) < 0.3 for on, off in windows)
    assert not any(s.get("stop", HUGE) < 1.5 for s in after.starts)
    other = next(h for h in hypotheses(early, "integrated", left[0]) if h.record.id == "transition_kinetics")
    assert windowed(late, other, left[1]) is other


def test_when_it_was_on_is_asked_of_several_recordings_together() -> None:
    """At first use the calibration is one of them; each is timed from its own start."""
    nominal, parts = replace(_model(), noise={RESISTANCE: NoiseModel(1e-3)}), []
    laser = {"laser_heating": {"rise": 0.8, "start": 0.4, "stop": 1.1}}
    for size, begin in ((3000, 0.0), (2200, 50.0)):
        shown = nominal.respond(_drive(size), 1e-3, effects=laser).channels[RESISTANCE]
        channels = {HEATER_CURRENT: _drive(size), RESISTANCE: 10.0**shown}
        parts.append(prepare(Recording(begin + 1e-3 * np.arange(size), channels, "integrated"), nominal))
    problem = linearise_problem(nominal, parts)
    left = problem.apply_inverse_covariance(problem.residual)
    hypothesis = next(h for h in hypotheses(problem, "integrated", left) if h.record.id == "laser_heating")
    windows = {(s["start"], s["stop"]) for s in hypothesis.starts if "start" in s}
    assert any(abs(on - 0.4) < 0.15 and abs(off - 1.1) < 0.15 for on, off in windows)


def _changed(
    changes: dict[str, dict[str, float | str]],
    size: int = 3000,
    ar: tuple[float, ...] = (),
    drive: np.ndarray | None = None,
):
    """The problem of a device on which effects act, taken to have noise of one colour in the resistance."""
    nominal, dt = replace(_model(), noise={RESISTANCE: NoiseModel(1e-3, ar)}), 1e-3
    current = _drive(size) if drive is None else drive
    shown = nominal.respond(current, dt, effects=changes).channels[RESISTANCE]
    shown = shown + 1e-3 * np.random.default_rng(1).normal(size=current.size)
    time = dt * np.arange(current.size)
    recording = Recording(time, {HEATER_CURRENT: current, RESISTANCE: 10.0**shown}, "integrated")
    return linearise_problem(nominal, [prepare(recording, nominal)])


def test_a_limit_just_below_the_largest_current_is_found_where_that_is_held() -> None:
    """All but a few of the largest currents are the same one, so that they have no place between them for the limit."""
    rise, limit = np.linspace(3e-3, 6.5e-3, 600), 6.47e-3
    held = np.concatenate([rise, np.full(900, 6.5e-3), rise[::-1], rise, np.full(300, 6.5e-3)])
    problem = _changed({"driver_saturation": {"limit": limit}}, drive=held)
    limits = [h for h in hypotheses(problem, "integrated", problem.residual) if h.key == "driver_saturation"]
    (best,) = score(problem, limits, problem.residual)
    assert best.gain > 0.5 * (problem.residual_chi_square - problem.count)
    assert fit_jointly(problem, limits, [best.start], Limits()).values[0]["limit"] == pytest.approx(
        limit, rel=1e-3
    )


@pytest.mark.parametrize(("swings", "absorbed"), [(2.5, True), (40.0, False)])
def test_a_gain_may_take_any_slow_course(swings, absorbed) -> None:
    problem = _changed({})
    hypothesis = next(
        h
        for h in hypotheses(problem, "integrated", problem.residual)
        if h.key == f"sensor_gain_drift:{RESISTANCE}"
    )
    past = np.arange(problem.weight.size) / problem.weight.size
    gain = np.log10(1.0 + 0.02 * np.sin(2.0 * np.pi * swings * past)) / 1e-3  # in noise levels
    bent = with_courses(problem, [hypothesis])
    assert tuple(bent.courses) == (hypothesis.key,)
    left = [p.chi_square(gain) for p in (problem, bent)]
    assert (left[1] < 0.02 * left[0]) is absorbed
    line, walks, _ = course_columns(problem, hypothesis)
    told = gain_of_course(problem, np.column_stack([line, walks]), problem.apply_inverse_covariance(gain))
    assert told == pytest.approx(left[0] - left[1], rel=0.05, abs=0.02 * left[0])


@pytest.mark.parametrize("key", ["ambient_drift", "drive_gain_drift"])
def test_a_course_that_is_simulated_is_a_straight_line_where_it_is_one(key) -> None:
    chain, current = _model().model.simulation, _drive(2000)
    rate = {"ambient_drift": 2.0, "drive_gain_drift": 0.02}[key]
    line = chain.with_effects({key: {"rate": rate}}).run(current, dt=1e-3)
    course = chain.with_course(key, rate * 1e-3 * np.arange(2000)).run(current, dt=1e-3)
    # an effect's own time runs on within a sample, a course is held
    assert np.allclose(course, line, rtol=0.0, atol=2e-3 * np.ptp(line, axis=0))
    assert not np.allclose(course, chain.run(current, dt=1e-3), rtol=0.0, atol=1e-2 * np.ptp(line, axis=0))


@pytest.mark.parametrize("key", ["creep", "no_such_effect"])
def test_a_course_of_what_takes_none_is_refused(key) -> None:
    with pytest.raises(ValueError, match=f"{key}: need an effect with a hook that takes `course`"):
        _model().model.simulation.with_course(key, np.zeros(10))


def test_a_bend_raised_by_a_weight_is_a_constant_more() -> None:
    bend = Bend(0.25, np.zeros((2, 12)), 20.0, np.linspace(0.0, 1.0, 24).reshape(2, 12))
    for place in range(2):
        before, after = (b.amplitude(place, 300, 2.0) for b in (bend, bend.raised(0.1)))
        assert np.allclose(after - before, 0.25 * 2.0 * 20.0 * 0.1, atol=1e-9)
    assert np.all(Bend(0.25, np.zeros((2, 12))).amplitude(1, 300, 2.0) == 0.0)


@pytest.mark.parametrize("swings", [pytest.param((2.0,), marks=pytest.mark.slow), (1.0, -2.0)])
def test_a_room_that_swings_by_more_than_a_loop_is_linear_over_is_followed(swings) -> None:
    size, dt = 4000, 1e-3
    nominal, current = replace(_model(), noise={RESISTANCE: NoiseModel(1e-3)}), _drive(size)
    time, rng, rooms, parts = dt * np.arange(size), np.random.default_rng(3), [], []
    for count in swings:
        rooms.append(3.0 * np.sin(2.0 * np.pi * count * np.arange(size) / size))
        shown = nominal.respond(current, dt, course=("ambient_drift", rooms[-1])).channels[RESISTANCE]
        channels = {HEATER_CURRENT: current, RESISTANCE: 10.0 ** (shown + 1e-3 * rng.normal(size=size))}
        parts.append(prepare(Recording(time, channels, "integrated"), nominal))
    problem = linearise_problem(nominal, parts)
    hypothesis = next(
        h for h in hypotheses(problem, "integrated", problem.residual) if h.key == "ambient_drift"
    )
    line = fit_jointly(
        with_courses(problem, [hypothesis]), [hypothesis], [{"rate": 0.0}], Limits(), iterations=3
    )
    there, fit = refit_about(nominal, problem, line, Limits())
    assert fit.chi_square < 1.1 * there.count
    assert line.chi_square > 4.0 * there.count
    rate, bend = fit.values[0]["rate"], fit.courses["ambient_drift"]
    for place, room in enumerate(rooms):
        found = rate * time + bend.amplitude(place, size, size * dt)
        # its level and the drive's gain do nearly the same
        assert np.std(found - room) < 0.1


def test_rooms_that_drift_each_at_its_own_rate_need_few_splines() -> None:
    size, dt = 4000, 1e-3
    nominal, current = replace(_model(), noise={RESISTANCE: NoiseModel(1e-3)}), _drive(size)
    parts = []
    for k, total in enumerate((0.3, -0.4)):
        room = total * np.arange(size) / size
        shown = nominal.respond(current, dt, course=("ambient_drift", room)).channels[RESISTANCE]
        shown = shown + 1e-3 * np.random.default_rng(k).normal(size=size)
        channels = {HEATER_CURRENT: current, RESISTANCE: 10.0**shown}
        parts.append(prepare(Recording(dt * np.arange(size), channels, "integrated"), nominal))
    problem = linearise_problem(nominal, parts)
    hypothesis = next(
        h for h in hypotheses(problem, "integrated", problem.residual) if h.key == "ambient_drift"
    )
    left = problem.apply_inverse_covariance(problem.residual)
    knots, gain = worth_their_price(problem, hypothesis, left, 2.0 * price(problem, Limits()))
    assert knots == 4
    most, all_of_it = worth_their_price(problem, hypothesis, left, 0.0)
    assert most == 24
    assert gain > 0.9 * all_of_it


@pytest.mark.parametrize(("noises", "told"), [(26.0, True), (2.0, False)])
def test_an_agreement_tells_a_misfit_far_above_the_noise(noises, told) -> None:
    sensors = {RESISTANCE: SensorModel(noise=2e-3, colour=(), residual=1e-2, residual_colour=())}
    nominal = replace(_model(), model=replace(_model().model, sensors=sensors))
    shape = SimpleNamespace(misfit=SimpleNamespace(level=noises * 2e-3 / np.log(10.0)))
    study = SimpleNamespace(
        located=SimpleNamespace(nominal=nominal, problem=SimpleNamespace(shapes={RESISTANCE: shape})),
        limits=Limits(),
    )
    assert ("26 times the noise" in _missed_by_the_law(study)) is told  # type: ignore[arg-type]


def test_a_rival_is_as_probable_as_misfit_that_is_left_makes_it() -> None:
    problem = _changed({})
    none = np.zeros(problem.weight.size)
    rng = np.random.default_rng(2)
    change = 0.5 * rng.choice([-1.0, 1.0], none.size)
    assert odds_of_rival(problem, none, none) == 1.0
    assert odds_of_rival(problem, none, change) < 1e-6
    assert odds_of_rival(problem, change, none) == 1.0  # no better than the other
    assert (
        odds_of_rival(problem, change, none, dearer=1e4) < 1e-6
    )  # but for that it has parameters which cost more
    # fitted elsewhere, where it leaves more than the other
    assert odds_of_rival(problem, change, none, worse=1e4) < 1e-6
    assert odds_of_rival(problem, none, change, worse=-10.0) == 1.0
    # what is left for long stretches speaks for the rival in one and against it in the next: it may be either
    either_way = np.where(np.arange(none.size) // 500 % 2 == 0, 2.0, -2.0) * change
    assert odds_of_rival(replace(problem, residual=problem.residual + either_way), none, change) > 1e-2


def test_an_effect_is_as_sure_as_the_stretches_of_the_recording_agree() -> None:
    problem = _changed({"transition_kinetics": {"time_constant": 5e-5}})
    record = effects()["transition_kinetics"]
    hypothesis = Hypothesis(record, "", ({"time_constant": 3e-5},), {"time_constant": 2e-6})
    plain = option_of(
        problem.nominal,
        problem,
        fit_jointly(problem, [hypothesis], hypothesis.starts, Limits()),
        [],
        Limits(),
    )
    assert sureness(plain) == pytest.approx(np.sqrt(plain.chosen.gain), rel=0.3)  # as sure as in noise
    # a misfit with the effect's own pattern, for it in one stretch and against it in the next
    pattern = trace(plain.final)
    either_way = np.where(np.arange(pattern.size) // 500 % 2 == 0, 1.0, -1.0) * pattern
    torn = replace(plain, final=replace(plain.final, residual=plain.final.residual + either_way))
    assert sureness(torn) < 0.2 * sureness(plain)


@pytest.mark.parametrize("phase", [1.0, 2.5, 4.0, 5.5])
@pytest.mark.parametrize("pitch", [4.1e-6, 8.3e-6])
def test_a_ripple_begins_with_the_pitch_of_the_residual_and_any_phase(pitch, phase) -> None:
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    lever = PlayBank([20e-6], [0.0], [0.2], [-12.4], [0.2], [-11.0], [30e-6, 1e-7])
    model = DeviceModel("integrated", resistance=bank, deflection=lever)
    nominal = replace(
        Nominal.from_parameters(model.to_parameters()), noise={TIP_DEFLECTION: NoiseModel(5e-8)}
    )
    current, dt, key = _drive(3000), 1e-3, f"sensor_ripple:{TIP_DEFLECTION}"
    ripple = {key: {"amplitude": 4e-7, "pitch": pitch, "phase_angle": phase, "signal": TIP_DEFLECTION}}
    shown = nominal.respond(current, dt, effects=ripple).channels[TIP_DEFLECTION]
    channels = {HEATER_CURRENT: current, TIP_DEFLECTION: shown}
    recording = Recording(dt * np.arange(current.size), channels, "integrated")
    problem = linearise_problem(nominal, [prepare(recording, nominal)])
    left = problem.apply_inverse_covariance(problem.residual)
    found = next(h for h in hypotheses(problem, "integrated", left) if h.key == key)
    assert found.magnitudes == ("amplitude",)
    best = score(problem, [found], problem.residual)[0]
    assert best.start["pitch"] == pytest.approx(pitch, rel=0.1)
    assert best.gain > 0.4 * problem.chi_square(problem.residual)
    assert all(found.bounds("pitch")[0] < s["pitch"] < found.bounds("pitch")[1] for s in found.starts)


def test_a_coarse_converter_has_no_limits_but_those_that_its_values_show() -> None:
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    lever = PlayBank([20e-6], [0.0], [0.2], [-12.4], [0.2], [-11.0], [30e-6, 1e-7])
    model = DeviceModel("integrated", resistance=bank, deflection=lever)
    noise = {TIP_DEFLECTION: NoiseModel(5e-8), RESISTANCE: NoiseModel(1e-3)}
    nominal = replace(Nominal.from_parameters(model.to_parameters()), noise=noise)
    current, dt = _drive(3000), 1e-3
    shown = dict(nominal.respond(current, dt).channels)
    fine, coarse = shown[TIP_DEFLECTION], 2e-6 * np.round(shown[TIP_DEFLECTION] / 2e-6)
    for tip, searched in ((fine, True), (coarse, False)):
        channels = {HEATER_CURRENT: current, RESISTANCE: 10.0 ** shown[RESISTANCE], TIP_DEFLECTION: tip}
        recording = Recording(dt * np.arange(current.size), channels, "integrated")
        problem = linearise_problem(nominal, [prepare(recording, nominal)])
        keys = {h.key for h in hypotheses(problem, "integrated", problem.residual)}
        assert (f"adc_saturation:{TIP_DEFLECTION}" in keys) == searched
        assert f"adc_saturation:{RESISTANCE}" in keys and f"sensor_lag:{TIP_DEFLECTION}" in keys


@pytest.mark.parametrize("apart", [2, 3, 5])
def test_noise_of_a_slow_channel_is_whitened_by_the_samples_that_are_there(apart):
    noise = NoiseModel(0.3, (0.8,))
    x = noise.color(np.random.default_rng(2).standard_normal(60_000))
    slow = noise.every(apart)
    assert slow.level == pytest.approx(noise.level, rel=1e-6)
    assert slow.every(apart).ar == pytest.approx(slow.ar, abs=1e-9)
    there = np.arange(x.size) % apart == 1
    left = slow.whiten(np.where(there, x, 0.0))[there][10:]
    assert np.std(left) == pytest.approx(1.0, rel=0.02)
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 4.0 / np.sqrt(left.size)


def test_a_channel_that_is_slower_than_the_drive_is_judged():
    nominal, current, dt = replace(_model(), noise={RESISTANCE: NoiseModel(1e-3, (0.6,))}), _drive(), 1e-3
    there = np.arange(current.size) % 3 == 1
    shown = 10.0 ** nominal.respond(current, dt).channels[RESISTANCE]
    channels = {HEATER_CURRENT: current, RESISTANCE: np.where(there, shown, np.nan)}
    recording = Recording(dt * np.arange(current.size), channels, "integrated")
    problem = linearise_problem(nominal, [prepare(recording, nominal)])
    assert np.count_nonzero(problem.weight) > 0.95 * np.count_nonzero(there)
    assert not np.any(problem.weight[~there])


def test_what_acts_in_few_stretches_or_leaves_much_is_improbable() -> None:
    limits = Limits()
    wrong = limits.probability_of_something_else
    assert wrong(10.0, 0.0) > limits.doubt > wrong(100.0, 0.0)
    assert wrong(100.0, 0.0) < wrong(100.0, 1.0) < wrong(100.0, 10.0)
    assert wrong(np.inf, 0.0) == wrong(limits.surest, 0.0)  # what the values show by themselves


def test_a_refit_ends_where_no_small_change_fits_better() -> None:
    kinetics = {"transition_kinetics": {"time_constant": 4e-3}, "nonlinear_heat_loss": {"share": 0.1}}
    problem = _changed(kinetics)
    both = [
        Hypothesis(effects()["transition_kinetics"], "", ({"time_constant": 1e-3},), {"time_constant": 2e-4}),
        Hypothesis(effects()["nonlinear_heat_loss"], "", ({"share": 0.02},), {"share": 0.005}),
    ]
    found = fit_jointly(problem, both, [h.starts[0] for h in both], Limits())
    assert found.values[0]["time_constant"] == pytest.approx(4e-3, rel=0.05)

    def q(values) -> float:
        merged = {h.key: h.effects(v)[h.key] for h, v in zip(both, values, strict=True)}
        change = problem.deviation(merged, found.shift)
        return problem.chi_square(problem.residual - change)

    assert q(found.values) == pytest.approx(found.chi_square, rel=1e-9)
    for index, name, step in ((0, "time_constant", 2e-4), (1, "share", 0.005)):
        for sign in (-1.0, 1.0):
            moved = [dict(v) for v in found.values]
            moved[index][name] += sign * step
            assert q(moved) > found.chi_square - 0.3


def test_a_bound_stops_one_effect_and_not_the_other() -> None:
    """A heater that gains with temperature looks like a loss of negative size, which there is not."""
    problem = _changed({"transition_kinetics": {"time_constant": 4e-3}, "heater_tcr": {"alpha": 1e-3}})
    both = [
        Hypothesis(effects()["nonlinear_heat_loss"], "", ({"share": 0.02},), {"share": 0.005}),
        Hypothesis(effects()["transition_kinetics"], "", ({"time_constant": 1e-3},), {"time_constant": 2e-4}),
    ]
    found = fit_jointly(problem, both, [h.starts[0] for h in both], Limits())
    alone = fit_jointly(problem, both[1:], [both[1].starts[0]], Limits())
    assert found.values[0]["share"] == 0.0
    assert found.values[1]["time_constant"] == pytest.approx(alone.values[0]["time_constant"], rel=0.02)


def test_on_a_short_recording_nothing_is_tried_that_is_not_physical() -> None:
    """In a fifth of a second a drift that bends visibly would bend faster than the catalogue allows."""
    problem = _changed({"ambient_drift": {"rate": 0.5}}, size=200)
    left = problem.apply_inverse_covariance(problem.residual)
    drifts = [h for h in hypotheses(problem, "integrated", left) if h.record.id == "ambient_drift"]
    assert drifts[0].scales["curvature"] / MAGNITUDE_STEP > drifts[0].bounds("curvature")[1]
    found = score(problem, drifts, problem.residual)
    assert 0 < abs(found[0].start["curvature"]) <= drifts[0].bounds("curvature")[1]


def test_beside_an_effect_between_samples_starts_are_told_from_the_same_steps() -> None:
    """Starts are simulated by whole samples: what they change must be told from such a simulation, not from a finer one."""
    lag = {"sensor_lag:" + RESISTANCE: {"signal": RESISTANCE, "time_constant": 4e-4}}
    nominal, current, dt = replace(_model(), noise={RESISTANCE: NoiseModel(1e-4)}), _drive(3000), 1e-3
    shown = nominal.respond(current, dt, effects=lag).channels[RESISTANCE]
    recording = Recording(
        dt * np.arange(current.size), {HEATER_CURRENT: current, RESISTANCE: 10.0**shown}, "integrated"
    )
    problem = linearise_problem(nominal, [prepare(recording, nominal)], effects=lag)
    coarse = problem.stack(problem.responses({}, fine=False))
    nothing = Hypothesis(effects()["nonlinear_heat_loss"], "", ({"share": 1e-9},), {"share": 0.005})
    found = score(problem, [nothing], problem.residual)
    assert problem.chi_square(coarse) > 100.0  # the steps are seen
    assert found[0].visible < 1e-3


def test_a_place_is_told_by_the_change_over_the_noise_power() -> None:
    """Slow noise must not hide that a slow change is in a channel: its innovations would tell less of it."""
    problem = _changed({}, ar=(0.9,))
    warmer = {"laser_heating": {"rise": 0.5}}
    found = breakdown(problem, problem.deviation(warmer), floor=0.0)
    plain = (
        problem.responses(warmer)[0].channels[RESISTANCE] - problem.nominal_responses[0].channels[RESISTANCE]
    )
    level = 1e-3 / np.sqrt(1 - 0.9**2)
    counts = problem.weight > 0
    assert found[0].excess == pytest.approx(np.sum((plain[counts] / level) ** 2), rel=1e-6)


def test_a_branch_is_told_by_its_energy_per_sample() -> None:
    """Three times as long on one branch, or settling at its end, makes it no place."""
    nominal, dt = replace(_model(), noise={RESISTANCE: NoiseModel(1e-3)}), 1e-3
    up, down = np.linspace(4e-3, 8.4e-3, 1500), np.linspace(8.4e-3, 4e-3, 500)
    current = np.concatenate([np.full(100, 4e-3), up, down, np.full(900, 4e-3)])
    shown = nominal.respond(current, dt)
    recording = Recording(
        dt * np.arange(current.size),
        {HEATER_CURRENT: current, RESISTANCE: 10.0 ** shown.channels[RESISTANCE]},
        "integrated",
    )
    problem = linearise_problem(nominal, [prepare(recording, nominal)])
    rate = np.gradient(shown.temperature)
    counts = problem.weight > 0
    for change, place in (
        (np.ones(rate.size), "both"),
        (np.where(rate > 0, 1.0, 0.3), "heating"),
        (np.where(rate > 0, 0.3, 1.0), "cooling"),  # less energy while cooling than while heating, all in all
    ):
        found = locate(problem, breakdown(problem, change * counts, floor=0.0), Limits())
        assert found[0].branch == place


def test_branches_of_a_device_without_a_heated_body_are_those_of_its_drive() -> None:
    assert list(branch_words(preset("integrated")).values()) == ["heating", "cooling", "held"]
    assert list(branch_words(STACK).values()) == ["rising", "falling", "held"]


@pytest.mark.parametrize("ar", [(), (0.9,)])
def test_noise_alone_has_no_excess_anywhere(ar) -> None:
    problem = _changed({}, ar=ar)
    found = breakdown(problem, np.random.default_rng(7).normal(size=problem.weight.size))
    assert abs(found[0].excess) < 0.3 * found[0].floor
    twice = breakdown(problem, 2 * np.random.default_rng(7).normal(size=problem.weight.size))
    assert twice[0].excess == pytest.approx(3 * found[0].floor, rel=0.4)


def test_side_by_side_keeps_the_order_and_raises() -> None:
    assert parallel_map(lambda x: x**2, range(20)) == [x**2 for x in range(20)]
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda x: 1 / x, [2, 1, 0])


@pytest.mark.parametrize("share", [0.05, 0.3, 1.0])
def test_rounding_under_noise_is_its_mean(share) -> None:
    rng = np.random.default_rng(3)
    values, step = rng.uniform(-3.0, 3.0, 200), 0.7
    drawn = values + share * step * rng.standard_normal((40_000, 200))
    mean = np.mean(step * np.rint(drawn / step), axis=0)
    assert rounded_with_noise(values, step, np.full(200, share * step)) == pytest.approx(
        mean, abs=0.025 * step
    )


def test_rounding_without_noise_is_a_staircase() -> None:
    values = np.linspace(-2.0, 2.0, 401)
    away = np.abs(np.abs(values / 0.5 - np.floor(values / 0.5)) - 0.5) > 0.1
    found = rounded_with_noise(values, 0.5, np.zeros(401))
    assert found[away] == pytest.approx(0.5 * np.rint(values / 0.5)[away], abs=0.005)


def test_a_rest_is_covered_and_the_way_from_it_is_not() -> None:
    temperature = np.array([22.0, 22.0, 40.0, 60.5, 60.5])
    count = np.array([600.0, 3.0, 2000.0, 500.0])
    digest = CalibrationDigest(temperature, count, np.zeros(4), np.zeros(4))
    found = coverage(replace(_model(), digest=digest))
    assert found.holds(np.array([10.0, 22.0, 22.9, 30.0, 41.0, 60.9, 61.1])).tolist() == [
        *(False, True, True, False, True, True, False)
    ]
    assert str(found) == "22 to 23, 40 to 61 degC"
    few = replace(digest, count=np.array([20.0, 1.0, 60.0, 20.0]))  # no kelvin has eight: bins of 12 K
    found = coverage(replace(_model(), digest=few))
    assert found.holds(np.array([22.0, 30.0, 40.0, 60.0])).tolist() == [True, True, True, True]
    assert not coverage(replace(_model(), digest=replace(few, count=few.count / 16))).enough.all()
    everywhere = coverage(_model())
    assert isinstance(everywhere, Coverage) and everywhere.holds(np.array([-300.0, 1e4])).all()


def test_what_takes_longer_than_the_recording_is_no_creep() -> None:
    problem = _changed({})
    found = {
        h.record.id: h
        for h in hypotheses(problem, "integrated", problem.apply_inverse_covariance(problem.residual))
    }
    mode = found["second_thermal_mode"]
    assert mode.bounds("time_constant")[1] == pytest.approx(3 * 3000 * 1e-3)
    assert mode.ends("time_constant", 9.0) and not mode.ends("time_constant", 8.0)
    assert found["transition_kinetics"].bounds("time_constant")[1] > 9.0  # its size, not its shape
    assert found["series_resistance"].bounds("resistance")[0] == 0.0


def test_partners_that_nearly_reach_the_best_pair_are_tried_too() -> None:
    def pair(names: tuple[str, str], q: float) -> Explanation:
        made = tuple(Hypothesis(effects()[name], "", ({},), {}) for name in names)
        none = np.zeros(0)
        return Explanation(made, ({}, {}), q, 0.0, none, (), none, np.zeros((0, 0)), (), none)

    # the best leaves 1000: a quarter of it, and 5 sigma, is near
    qs = {"latent_heat": 2000.0, "dead_time": 2200.0, "heater_tcr": 2400.0}
    found = [pair(("creep", other), q) for other, q in qs.items()]
    assert list(_untried(found, 1000, Limits())) == ["creep", "latent_heat", "dead_time"]
    assert _untried([], 1000, Limits()) == {}


def test_what_is_faster_than_the_samples_is_no_resonance() -> None:
    record = effects()["cantilever_resonance"]
    start = {"share": 1.0, "frequency": 400.0, "damping": 0.02}
    mode = Hypothesis(record, "", (start,), dict.fromkeys(start, 0.02), fastest=500.0)
    assert mode.bounds("frequency") == (1e-9, 500.0)
    assert mode.bounds("damping") == (1e-4, 1.0)


def test_the_digest_keeps_how_the_model_changes_with_its_lags() -> None:
    rng = np.random.default_rng(8)
    lags = {"thermal.time_constant": rng.normal(size=(3, 2)), "driver.dead_time": rng.normal(size=(3, 2))}
    digest = CalibrationDigest(
        np.arange(4.0), np.full(3, 5.0), np.zeros(3), np.zeros(3), by_lag=lags,
        noise_current=(2e-6, 0.3), current_reading=(3e-5, 1.04),
    )  # fmt: skip
    again = CalibrationDigest.from_parameters(digest.to_parameters())
    assert again is not None and again.by_lag.keys() == lags.keys()
    assert (again.noise_current, again.current_reading) == (digest.noise_current, digest.current_reading)
    for name, values in lags.items():
        np.testing.assert_allclose(again.by_lag[name], values, rtol=1e-3)
    for wrong in ((1.0,), (0.0, 0.0)):
        with pytest.raises(ValueError, match=r"current_reading: found .* an offset and a gain"):
            replace(digest, current_reading=wrong)
    with pytest.raises(ValueError, match=r"thermal\.time_constant: found shape"):
        replace(digest, by_lag={"thermal.time_constant": np.zeros((2, 2))})


def _read_back(line: tuple[float, float], noise: float) -> Recording:
    """A command of a thousand steps, and a reading of its own with offset, gain and noise."""
    rng = np.random.default_rng(12)
    command = np.repeat(rng.uniform(4e-3, 8.4e-3, 250), 4)
    reading = line[0] + line[1] * command + noise * rng.normal(size=command.size)
    channels = {HEATER_CURRENT: reading, COMMANDED_CURRENT: command}
    return Recording(1e-3 * np.arange(command.size), channels, "integrated")


def test_a_current_reading_has_an_offset_a_gain_and_noise() -> None:
    recording = _read_back((3e-5, 1.04), 2e-6)
    line, noise = current_reading(recording)
    assert line == pytest.approx((3e-5, 1.04), rel=0.02)
    assert noise[0] == pytest.approx(2e-6 / 1.04, rel=0.1)
    found = as_commanded(recording[HEATER_CURRENT], line) - recording[COMMANDED_CURRENT]
    assert np.std(found) == pytest.approx(2e-6 / 1.04, rel=0.1)
    assert abs(np.mean(found)) < 2e-7


def test_a_log_that_repeats_the_command_is_no_reading() -> None:
    assert current_reading(_read_back((0.0, 1.0), 0.0)) == ((), ())
    plain = _read_back((0.0, 1.0), 2e-6)
    alone = {HEATER_CURRENT: plain[HEATER_CURRENT]}
    assert current_reading(Recording(plain.time_s, alone, "integrated")) == ((), ())
    values = plain[HEATER_CURRENT]
    assert as_commanded(values, ()) is values


def test_a_loose_wire_is_no_reading() -> None:
    assert current_reading(_read_back((0.0, 0.0), 2e-6)) == ((), ())


def test_a_reading_is_not_trusted_within_a_step() -> None:
    found = between_samples(np.array([1.0, 1.002, 1.0, 1.5, 1.5]), 1e-3)
    assert found == pytest.approx([0.0, 0.0, 0.0, 0.5 * (0.5 - 3e-3), 0.0])


def test_what_another_channel_shows_does_not_speak_against_an_effect_of_one_sensor() -> None:
    """A resistance that is five noise powers off, beside a slow sensor of the deflection."""
    noise = {RESISTANCE: NoiseModel(1e-3, ()), TIP_DEFLECTION: NoiseModel(2e-8, ())}
    nominal = replace(_model(), model=_with_deflection(), noise=noise)
    key, lag = f"sensor_lag:{TIP_DEFLECTION}", {"time_constant": 4e-3, "sampled": 0.0}
    current, rng = _drive(3000), np.random.default_rng(1)
    shown = nominal.respond(current, 1e-3, effects={key: {**lag, "signal": TIP_DEFLECTION}}).channels
    channels = {
        HEATER_CURRENT: current,
        RESISTANCE: 10.0 ** (shown[RESISTANCE] + 2.5e-3 * rng.normal(size=3000)),
        TIP_DEFLECTION: shown[TIP_DEFLECTION] + 2e-8 * rng.normal(size=3000),
    }
    problem = linearise_problem(
        nominal, [prepare(Recording(1e-3 * np.arange(3000), channels, "integrated"), nominal)]
    )
    hypothesis = Hypothesis(
        effects()["sensor_lag"], TIP_DEFLECTION, (lag,), {"time_constant": 1e-4, "sampled": 1.0}
    )
    option = option_of(
        nominal, problem, fit_jointly(problem, [hypothesis], hypothesis.starts, Limits()), [], Limits()
    )
    assert option.remaining > 1.5 and reached(option) == {TIP_DEFLECTION}
    assert adequacy_of(option, Limits()).left < 0.1


def test_a_misfit_to_which_a_mode_rings_does_not_speak_against_the_mode() -> None:
    """A law that misses the deflection by a third of its noise, enlarged by a mode of quality 50; and a swing, which is not."""
    noise = {RESISTANCE: NoiseModel(1e-3, ()), TIP_DEFLECTION: NoiseModel(2e-8, ())}
    nominal = replace(_model(), model=_with_deflection(), noise=noise)
    mode = {"share": 0.9, "frequency": 40.0, "damping": 0.01}
    current, rng = _drive(3000), np.random.default_rng(2)
    time = 1e-3 * np.arange(3000)
    shown = nominal.respond(current, 1e-3, effects={"cantilever_resonance": mode}).channels
    simulation = nominal.model.simulation.with_effects({"cantilever_resonance": mode})
    law = 7e-9 * np.repeat(rng.normal(size=(300, 1)), 10, axis=0)
    missed = as_sensed(simulation, TIP_DEFLECTION, law, 1e-3)[:, 0]

    def judged(more):
        deflection = shown[TIP_DEFLECTION] + more + 2e-8 * rng.normal(size=3000)
        film = 10.0 ** (shown[RESISTANCE] + 1e-3 * rng.normal(size=3000))
        channels = {HEATER_CURRENT: current, RESISTANCE: film, TIP_DEFLECTION: deflection}
        part = prepare(Recording(time, channels, "integrated"), nominal)
        problem = linearise_problem(nominal, [part], shapes={})  # loops as they are
        hypothesis = Hypothesis(
            effects()["cantilever_resonance"],
            "",
            (mode,),
            {"share": 0.01, "frequency": 0.02, "damping": 0.05},
        )
        option = option_of(
            nominal, problem, fit_jointly(problem, [hypothesis], hypothesis.starts, Limits()), [], Limits()
        )
        assert option.chosen.values[0]["frequency"] == pytest.approx(40.0, rel=0.01)
        count = problem.count_by_channel[TIP_DEFLECTION]
        return option.remaining * problem.count / count, adequacy_of(
            option, replace(Limits(), equation=0.0)
        ).left

    left, beyond = judged(missed)
    assert left > 1.0 > 0.5 > beyond
    left, beyond = judged(6e-8 * np.sin(2.0 * np.pi * 97.0 * time))
    assert beyond > 0.8 * left > 1.0


def test_a_drive_that_begins_at_zero_has_a_zero_that_may_move() -> None:
    nominal = _model()
    model = replace(nominal.model, scalars={**nominal.model.scalars, "thermal.ambient": 0.0})
    drifting = {c.name: c.spread for c in constants_of(replace(nominal, model=model)) if c.drifts}
    assert drifting["thermal.ambient"] == 1.0


def test_a_gain_in_the_logged_drive_is_not_behind_the_loop() -> None:
    energy = {HEATER_CURRENT: 900.0, RESISTANCE: 80.0, TIP_DEFLECTION: 20.0}
    problem = SimpleNamespace(
        residual=np.zeros(3),
        apply_inverse_covariance=lambda vector: vector,
        energy_by_channel=lambda vector, left: energy,
    )
    assert behind_the_loop(problem, 990.0) == pytest.approx(90.0)
    energy.pop(HEATER_CURRENT)
    assert behind_the_loop(problem, 90.0) == pytest.approx(90.0)


@pytest.mark.parametrize(("left", "told"), [(5.0, True), (3.5, False)])
def test_an_agreement_tells_what_is_far_beyond_noise_and_misfit_of_the_calibration(left, told) -> None:
    level = 2e-3
    nominal = replace(_model(), noise={RESISTANCE: NoiseModel(level)})
    shape = SimpleNamespace(misfit=SimpleNamespace(level=level), rough=0.0)
    study = SimpleNamespace(
        located=SimpleNamespace(nominal=nominal, problem=SimpleNamespace(shapes={RESISTANCE: shape})),
        decision=SimpleNamespace(judged=SimpleNamespace(after={RESISTANCE: left * np.sqrt(2.0) * level})),
        limits=Limits(),
    )
    said = _further_than_the_calibration(study)  # type: ignore[arg-type]
    assert (said.startswith(" But in film_resistance what is left is 5 times noise and misfit")) is told
    assert bool(said) is told
