"""Every effect: off it changes nothing at all, on it reaches the channels it names and no other."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vo2_models.device
from scipy.integrate import solve_ivp
from scipy.special import erfcx
from vo2_models.device import preset, truth
from vo2_models.device.coefficients import apply_effects, neutral
from vo2_models.effects import effect, effect_ids, effects
from vo2_models.effects.trial import try_functions
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

CONTRACT = [
    "cantilever_resonance",
    "second_thermal_mode",
    "dead_time",
    "cooling_asymmetry",
    "ambient_drift",
    "nonlinear_heat_loss",
    "latent_heat",
    "heater_tcr",
    "laser_heating",
    "sense_self_heating",
    "transition_kinetics",
    "phase_dependent_expansion",
    "transition_offset",
    "minor_loop_incongruency",
    "training_drift",
    "creep",
    "series_resistance",
    "leakage_resistance",
    "current_crosstalk",
    "sensor_lag",
    "sensor_gain_drift",
    "clock_offset",
    "adc_saturation",
    "adc_quantization",
    "driver_saturation",
    "driver_slew",
    "driver_deadzone",
    "phase_dependent_heat_loss",
    "peltier_joule_heating",
    "slow_relaxation",
    "non_hysteretic_branches",
    "loop_width_difference",
    "substrate_diffusion",
    "log_creep",
    "averaging",
    "drive_gain_drift",
    "thermovoltage",
    "contact_drift",
    "source_compression",
    "backlash",
    "stiffening",
    "sensor_ripple",
]
PRESETS = ("integrated", "peltier")

CASES = [
    (device, name, signal)
    for name, record in effects().items()
    for device in PRESETS
    if record.occurs_on(device)
    for signal in record.signals(device)
]


def _held(device: str) -> np.ndarray:
    """Long holds inside the loop: relaxation needs a film at rest."""
    levels = {"integrated": [4.5e-3, 6.4e-3, 8.2e-3, 6.1e-3], "peltier": [0.0, -0.74, -1.1, -0.7]}[device]
    return np.repeat(levels, 1500)


def _current(device: str) -> np.ndarray:
    rng = np.random.default_rng(7)
    if device == "integrated":
        up = np.linspace(3.68e-3, 8.49e-3, 40)
        return np.repeat(np.concatenate([up, up[::-1], rng.uniform(3.68e-3, 8.49e-3, 60)]), 12)
    ramp = [np.linspace(0.05, -1.15, 30), np.linspace(-1.15, 0.4, 30), rng.uniform(-1.15, 0.05, 20)]
    return np.repeat(np.concatenate(ramp), 40)


@pytest.fixture(scope="module")
def clean():
    return {d: truth(d, seed=1).simulate(_current(d), noise=False) for d in ("integrated", "peltier")}


def _drawn(device: str, name: str, signal: str) -> dict:
    rng = np.random.default_rng(3)
    values = effect(name).draw(device, rng)
    while signal and values["signal"] != signal:
        values = effect(name).draw(device, rng)
    return values


def test_catalogue_has_all_of_the_contract():
    assert set(effect_ids()) >= set(CONTRACT)
    assert len(CONTRACT) == 42
    assert "latent_heat" not in effect_ids("peltier")
    assert "peltier_joule_heating" not in effect_ids("integrated")


@pytest.mark.parametrize(("device", "name", "signal"), CASES)
def test_neutral_is_bitwise_nothing_and_typical_reaches_what_it_names(device, name, signal, clean):
    base, current, record = clean[device], _current(device), effect(name)
    if "holds" in record.excitation:
        current = _held(device)
        base = truth(device, seed=1).simulate(current, noise=False)
    off = {**record.neutral(), **({"signal": signal} if signal else {})}
    neutral_run = truth(device, seed=1, effects={name: off}).simulate(current, noise=False)
    for channel, values in base.channels.items():
        assert np.array_equal(neutral_run[channel], values), channel
    changing = truth(device, seed=1, effects={name: _drawn(device, name, signal)})
    on = changing.simulate(current, noise=False)
    measured = preset(device).channels
    # in finer steps the rest is the same but for rounding
    rounding = 0.0 if changing.steps_per_sample(preset(device).sample_period) == 1 else 1e-9
    changed = {c for c in measured if np.max(np.abs(on[c] - base[c])) > rounding * np.ptp(base[c])}
    assert changed == set(record.reaches(device, signal))
    # visible: where it reaches, the change is more than the channel's noise
    noise = preset(device).noise
    visible = [
        np.sqrt(np.mean(np.square(on[c] / base[c] - 1.0 if c == RESISTANCE else on[c] - base[c])))
        > noise.get(c, 0.0)
        for c in changed
    ]
    assert any(visible)


@pytest.mark.parametrize("name", effect_ids())
def test_record_is_complete(name):
    try_functions(effect(name))
    record = effect(name)
    assert record.parameters and any(record.occurs_on(device) for device in PRESETS)
    for text in (record.equation, record.excitation, record.source):
        assert len(text) > 5
    assert len(record.statement) > 100
    for parameter in record.parameters:
        assert parameter.unit and parameter.description
        default: Any = parameter.default
        assert parameter.lower is not None and parameter.upper is not None
        assert parameter.lower <= default <= parameter.upper
    assert set(record.fixed) <= {p.name for p in record.parameters}
    c = neutral()
    for device in filter(record.occurs_on, PRESETS):
        for signal in record.signals(device):
            values = record.neutral() | ({"signal": signal} if signal else {})
            apply_effects(c, {name: values}, device=device)
    assert np.array_equal(c, neutral())


def _pair(name: str, device: str, current: np.ndarray, **values: float):
    return (
        truth(device).simulate(current, noise=False),
        truth(device, effects={name: values}).simulate(current, noise=False),
    )


def test_latent_heat_delays_the_crossing_and_changes_no_steady_state():
    current = np.r_[np.full(40, 5.0e-3), np.full(40, 8.0e-3), np.full(40, 5.0e-3)]
    base, run = _pair("latent_heat", "integrated", current, latent=15.0)
    t0, t1 = base["true_temperature"], run["true_temperature"]
    crossing = np.argmax(t0[40:] > 62.0), np.argmax(t1[40:] > 62.0)
    assert crossing[1] > crossing[0]
    assert np.all(t1[40:60] <= t0[40:60] + 1e-9)
    assert np.all(t1[80:100] >= t0[80:100] - 1e-9)
    assert t1[79] == pytest.approx(t0[79], abs=0.02)


def test_directions():
    """The sign of each effect's first consequence, from its equation."""
    hot = np.full(60, 8.2e-3)
    base, run = _pair("nonlinear_heat_loss", "integrated", hot, share=0.06)
    theta = run["true_temperature"][-1] - 22.0
    assert theta + 1e-3 * theta**2 == pytest.approx(base["true_temperature"][-1] - 22.0, rel=1e-6)
    base, run = _pair("heater_tcr", "integrated", hot, alpha=1e-3)
    joule = base["true_temperature"][-1] - 22.0
    assert run["true_temperature"][-1] - 22.0 == pytest.approx(joule / (1.0 - 1e-3 * joule), rel=1e-6)
    base, run = _pair("phase_dependent_heat_loss", "integrated", hot, gamma=0.1)
    assert run["true_temperature"][-1] - 22.0 == pytest.approx(joule / 1.1, rel=1e-3)
    base, run = _pair("laser_heating", "integrated", hot, rise=2.0)
    assert run["true_temperature"] - base["true_temperature"] == pytest.approx(2.0, abs=1e-9)
    base, run = _pair("sense_self_heating", "integrated", np.zeros(60), coefficient=1e-5)
    rise = run["true_temperature"][-1] - 22.0
    assert rise == pytest.approx(1e-5 * run["true_film_resistance"][-1], rel=1e-3)
    base, run = _pair("series_resistance", "integrated", hot, resistance=500.0)
    assert run[RESISTANCE] - base[RESISTANCE] == pytest.approx(500.0, abs=1e-6)
    base, run = _pair("leakage_resistance", "integrated", hot, conductance=1e-6)
    assert 1.0 / run[RESISTANCE] - 1.0 / base[RESISTANCE] == pytest.approx(1e-6, rel=1e-6)
    base, run = _pair("current_crosstalk", "integrated", hot, coupling=1e5)
    assert run[RESISTANCE] - base[RESISTANCE] == pytest.approx(820.0, abs=1e-6)
    base, run = _pair("phase_dependent_expansion", "integrated", hot, slope=1e-7)
    lost = base[TIP_DEFLECTION][-1] - run[TIP_DEFLECTION][-1]
    assert lost == pytest.approx(1e-7 * (base["true_temperature"][-1] - 22.0), rel=1e-3)


def test_steady_peltier_terms():
    for i in (-0.8, 0.4):
        _, run = _pair("peltier_joule_heating", "peltier", np.full(8000, i), rho=5.0, pumping=0.05)
        expected = (-50.0 * i + 5.0 * i * i) / (1.0 - 0.05 * i)
        assert run[STAGE_TEMPERATURE][-1] - 25.0 == pytest.approx(expected, rel=1e-6)


def test_kinetics_widens_inside_the_transition_only():
    outside = np.repeat([4.2e-3, 4.6e-3, 4.2e-3, 4.6e-3], 20)
    base, run = _pair("transition_kinetics", "integrated", outside, time_constant=2e-3)
    assert np.allclose(run[RESISTANCE], base[RESISTANCE], rtol=1e-3)
    inside = np.repeat([4.6e-3, 8.0e-3], 20)
    base, run = _pair("transition_kinetics", "integrated", inside, time_constant=2e-3)
    assert np.all(run[RESISTANCE][20:30] >= base[RESISTANCE][20:30] * (1 - 1e-9))
    assert run[RESISTANCE][23] > 1.3 * base[RESISTANCE][23]
    assert run[RESISTANCE][-1] == pytest.approx(base[RESISTANCE][-1], rel=1e-3)


def test_slow_relaxation_drifts_at_a_hold_inside_the_loop_only():
    values = {"amplitude": 0.01, "onset": 5e-3}
    inside = np.r_[np.full(40, 4.5e-3), np.full(2000, 6.3e-3)]
    base, run = _pair("slow_relaxation", "integrated", inside, **values)
    fraction = (run[TIP_DEFLECTION] - base[TIP_DEFLECTION])[60:] / 57e-6
    held = np.arange(1, fraction.size + 1) * 1e-3
    curve = np.log1p(held / 5e-3)
    slope = np.polyfit(curve[200:], fraction[200:], 1)[0]
    assert 0.3 * 0.01 < slope < 1.1 * 0.01  # A * 4 s (1 - s), with s near the middle
    assert np.corrcoef(curve[200:], fraction[200:])[0, 1] > 0.999
    outside = np.full(2000, 4.5e-3)
    base, run = _pair("slow_relaxation", "integrated", outside, **values)
    assert np.abs(run[TIP_DEFLECTION] - base[TIP_DEFLECTION]).max() < 1e-10


def test_incongruency_spares_the_plateaus_and_tilts_the_loop():
    ramp = np.repeat(np.r_[np.linspace(4e-3, 8.4e-3, 300), np.linspace(8.4e-3, 4e-3, 300)], 6)
    base, run = _pair("minor_loop_incongruency", "integrated", ramp, kappa=2.5)
    t = base["true_temperature"]
    up = slice(0, int(np.argmax(t)))
    d0, d1 = base["true_tip_deflection"][up], run["true_tip_deflection"][up]
    span = np.ptp(d0)
    low, high = d0.min() + 0.2 * span, d0.min() + 0.8 * span
    steep0 = np.diff(
        np.interp([low, high], d0[np.argmin(d0) : np.argmax(d0)], t[up][np.argmin(d0) : np.argmax(d0)])
    )
    steep1 = np.diff(
        np.interp([low, high], d1[np.argmin(d1) : np.argmax(d1)], t[up][np.argmin(d1) : np.argmax(d1)])
    )
    assert steep0 - steep1 == pytest.approx(2.5 * 0.6, rel=0.15)


def test_slow_relaxation_follows_the_last_motion_and_is_forgotten():
    hold = np.full(400, 6.35e-3)
    back = np.full(400, 6.345e-3)  # a little colder: the film hardly moves, but the other way
    current = np.r_[np.full(60, 4.2e-3), hold, back, np.full(60, 8.4e-3)]
    base, run = _pair("slow_relaxation", "integrated", current, amplitude=0.02, onset=5e-3)
    drift = np.log(run[RESISTANCE] / base[RESISTANCE])
    assert drift[459] < drift[100] < 0.0  # heated: on towards the metal
    assert drift[859] > drift[459] + 0.5 * abs(drift[459])  # cooled a little: back
    assert np.max(np.abs(drift[-10:])) < 0.02 * np.max(np.abs(drift))  # heated through: nothing is left


def test_training_counts_reversals():
    cycle = np.r_[np.full(15, 4.2e-3), np.full(15, 8.3e-3)]
    base, run = _pair("training_drift", "integrated", np.tile(cycle, 10), shift=0.1)
    shifted = truth("integrated", effects={"laser_heating": {"rise": 0.0}}).simulate(cycle, noise=False)
    assert np.array_equal(base[RESISTANCE][:30], shifted[RESISTANCE])
    # first cycle: nothing has turned yet when it first crosses; the tenth: 18 turns, 1.8 K
    assert np.array_equal(run[RESISTANCE][:29], base[RESISTANCE][:29])
    late = slice(285, 300)
    early = np.log(run[RESISTANCE][late] / base[RESISTANCE][late])
    assert early.min() < -0.02


def test_non_hysteretic_branch_has_a_slope_and_no_area():
    middle = np.r_[np.full(40, 4.2e-3), np.full(40, 6.35e-3)]
    dither = 6.3e-3 + 0.01e-3 * np.sin(2 * np.pi * np.arange(600) / 60)
    base, run = _pair("non_hysteretic_branches", "integrated", np.r_[middle, dither], slope=0.02, band=2.0)
    late = slice(-300, None)
    t = base["true_temperature"][late]
    d0, d1 = base[TIP_DEFLECTION][late], run[TIP_DEFLECTION][late]
    extra = np.polyfit(t, d1 - d0, 1)
    assert extra[0] > 0.2 * 0.02 * 57e-6
    assert np.std(d1 - d0 - np.polyval(extra, t)) < 0.05 * np.std(d1 - d0)


def test_a_reversible_share_narrows_the_loop_by_that_share():
    ramp = np.repeat(np.r_[np.linspace(4e-3, 8.4e-3, 400), np.linspace(8.4e-3, 4e-3, 400)], 4)
    base, run = _pair("non_hysteretic_branches", "integrated", ramp, share=0.2)
    t, turn = base["true_temperature"], int(np.argmax(base["true_temperature"]))
    grid = np.linspace(50.0, 75.0, 40)

    def branches(found):
        d = found["true_tip_deflection"]
        heating = np.interp(grid, t[:turn], d[:turn])
        cooling = np.interp(grid, t[:turn:-1], d[:turn:-1])
        return heating, cooling

    (h0, c0), (h1, c1) = branches(base), branches(run)
    open_ = np.abs(c0 - h0) > 0.2 * np.max(np.abs(c0 - h0))
    assert np.median(((c1 - h1) / (c0 - h0))[open_]) == pytest.approx(0.8, abs=0.02)
    np.testing.assert_allclose(h1 + c1, h0 + c0, atol=0.03 * np.ptp(h0))


def test_driver_effects_show_in_the_logged_current():
    command = np.repeat([4e-3, 8e-3, 5e-3, 0.05e-3], 10)
    for name, values, expected in (
        ("driver_saturation", {"limit": 7e-3}, np.minimum(command, 7e-3)),
        ("driver_deadzone", {"width": 0.2e-3}, np.maximum(command - 0.2e-3, 0.0)),
    ):
        run = truth("integrated", effects={name: values}).simulate(command, noise=False)
        assert np.allclose(run[HEATER_CURRENT], expected, rtol=0, atol=1e-15)
    run = truth("integrated", effects={"driver_slew": {"rate": 1.0}}).simulate(command, noise=False)
    assert np.max(np.abs(np.diff(run[HEATER_CURRENT]))) == pytest.approx(1e-3)
    assert run[HEATER_CURRENT][9] == 4e-3 and run[HEATER_CURRENT][19] == 8e-3


def test_a_second_thermal_mode_may_raise_the_steady_gain():
    held = np.full(4000, 4.5e-3)
    base, kept = _pair("second_thermal_mode", "integrated", held, share=0.05, time_constant=0.1)
    _, raised = _pair("second_thermal_mode", "integrated", held, share=0.05, time_constant=0.1, gain=0.05)
    rise = base["true_temperature"] - 22.0
    assert abs(kept["true_temperature"][-1] - base["true_temperature"][-1]) < 1e-6 * rise[-1]
    assert np.isclose(raised["true_temperature"][-1] - 22.0, 1.05 * rise[-1], rtol=1e-6)
    # right after the step, when the slow path has not moved, only the fast one is there
    assert np.isclose(kept["true_temperature"][12] - 22.0, 0.95 * rise[12], rtol=0.01)
    assert np.isclose(raised["true_temperature"][12] - 22.0, rise[12], rtol=0.01)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sensor_lag", {"time_constant": 0.7e-3, "signal": TIP_DEFLECTION}),
        ("clock_offset", {"delay": 2.3e-3, "signal": TIP_DEFLECTION}),
        ("cantilever_resonance", {"share": 1.0, "frequency": 230.0, "damping": 0.02}),
    ],
)
def test_samples_tell_what_fine_ones_tell(name, values):
    """Between samples 1 ms apart a film with a time constant of 1.8 ms goes no straight way."""
    # below the transition: no loop
    current = np.repeat(np.random.default_rng(6).uniform(4.2e-3, 4.8e-3, 80), 4)
    device = truth("integrated", effects={name: values})
    coarse = device.simulate(current, noise=False)[TIP_DEFLECTION]
    fine = device.simulate(np.repeat(current, 20), dt=5e-5, noise=False)[TIP_DEFLECTION][19::20]
    plain = truth("integrated").simulate(current, noise=False)[TIP_DEFLECTION]
    assert np.std(coarse - plain) > 0.03 * np.std(plain)
    assert np.max(np.abs(coarse - fine)[20:]) < 2e-3 * np.std(coarse - plain)


def test_the_after_effect_solves_its_equation_at_any_pace():
    """Growth and forgetting at once, as on slow ramps: against the differential equation, integrated by scipy."""
    onset, travel, amplitude, dt = 3.0, 0.4, 0.02, 0.125
    # heating only
    current = np.r_[np.linspace(0.0, -0.78, 600), np.full(900, -0.78), np.linspace(-0.78, -0.82, 60)]
    values = {"amplitude": amplitude, "onset": onset, "travel": travel}
    base = truth("peltier").run(current, dt=dt)
    run = truth("peltier", effects={"slow_relaxation": values}).run(current, dt=dt)
    time, film, fraction = np.arange(current.size) * dt, base[:, 5], base[:, 8]

    def rate(t, y):
        pace = np.interp(t, time[1:] - 0.5 * dt, np.diff(film) / dt)
        return np.exp(-y) / onset - y / travel * pace

    y = solve_ivp(rate, (0.0, time[-1]), [0.0], t_eval=time, rtol=1e-8, max_step=dt).y[0]
    inside = (fraction > 0.1) & (fraction < 0.9)
    found = (run[:, 8] - fraction)[inside] / (4 * amplitude * fraction * (1 - fraction))[inside]
    assert np.count_nonzero(inside) > 400
    assert np.max(y[inside]) > 2 * np.min(y[inside]) > 0.0  # holds, and motion that forgets them
    assert np.max(np.abs(found - y[inside])) < 0.05 * np.max(y)


def test_a_motion_back_that_is_slower_than_the_drift_is_a_hold():
    cooled = np.r_[np.linspace(0.0, -1.1, 900), np.linspace(-1.1, -0.62, 400)]
    creeping = np.linspace(-0.62, -0.63, 1600)  # heating again, by 2.5 mK a second
    current = np.r_[cooled, np.full(1600, -0.62), creeping]
    values = {"amplitude": 0.02, "onset": 2.0, "travel": 0.4}
    base = truth("peltier").run(current, dt=0.125)
    run = truth("peltier", effects={"slow_relaxation": values}).run(current, dt=0.125)
    late = slice(-300, None)
    assert np.all(np.diff(base[late, 5]) > 0.0) and np.all(base[late, 8] > 0.02)
    drift = run[late, 8] - base[late, 8]
    assert np.all(drift < 0.0)  # on towards the insulator, as cooling left it


def _settled_after(name: str, device: str, values: dict, current: float, dt: float, seconds: float):
    """(settled start, the same current held from the cold rest) : last row of each of all columns."""
    simulation = truth(device, seed=2, domains=200, effects={name: values})
    settled = simulation.run(np.full(3, current), dt=dt, state=simulation.settled_state(current, dt))[-1]
    return settled, simulation.run(np.full(int(seconds / dt), current), dt=dt)[-1]


@pytest.mark.parametrize(
    ("name", "values", "seconds"),
    [
        ("second_thermal_mode", {"share": 0.06, "time_constant": 0.3}, 6.0),
        ("creep", {"share": 0.1, "time_constant": 0.4, "gain": 0.02}, 8.0),
        ("transition_kinetics", {"time_constant": 0.2}, 4.0),
        ("substrate_diffusion", {"share": 0.06, "time_constant": 1e-4}, 20.0),
        ("backlash", {"width": 1e-6, "start": 1.0}, 1.0),
        ("averaging", {"window": 5e-3, "signal": RESISTANCE}, 1.0),
    ],
)
def test_a_settled_start_is_where_a_long_hold_ends(name, values, seconds):
    settled, held = _settled_after(name, "integrated", values, 6.4e-3, 1e-3, seconds)
    np.testing.assert_allclose(settled, held, rtol=2e-4)


def test_a_structure_that_creeps_for_ever_is_at_its_end_in_a_settled_start():
    plain = truth("integrated", domains=200)
    creeping = truth("integrated", domains=200, effects={"log_creep": {"rate": 0.02}})
    rows = [
        d.run(np.full(2, 6.4e-3), dt=1e-3, state=d.settled_state(6.4e-3, 1e-3)) for d in (plain, creeping)
    ]
    np.testing.assert_allclose(rows[1], rows[0], rtol=1e-6)  # the body itself is at exp(-15) of rest


def test_a_drift_in_time_begins_with_the_recording_and_not_before():
    for name, values in (("ambient_drift", {"rate": 0.4}), ("contact_drift", {"rate": 200.0})):
        simulation = truth("integrated", domains=200, effects={name: values})
        plain = truth("integrated", domains=200)
        started = simulation.run(np.full(1, 6e-3), dt=1e-3, state=simulation.settled_state(6e-3, 1e-3))
        expected = plain.run(np.full(1, 6e-3), dt=1e-3, state=plain.settled_state(6e-3, 1e-3))
        np.testing.assert_allclose(started, expected, rtol=1e-5)


def test_heat_that_diffuses_arrives_behind_the_body_with_the_root_of_the_time():
    """Behind 1 / (1 + s tau_1), the body, 1 / (1 + sqrt(s tau)): 1 - exp(t / tau) erfc(sqrt(t / tau)) after a step."""
    tau, dt, share = 0.05, 1e-3, 0.1
    base, run = _pair(
        "substrate_diffusion", "integrated", np.full(4000, 4.5e-3), share=share, time_constant=tau
    )
    body = base["true_temperature"] - 22.0
    late = run["true_temperature"] - base["true_temperature"] + share * body
    time = dt * (np.arange(4000) + 0.5)  # each growth of the body's rise, in the middle of its sample
    grown = np.diff(body, prepend=0.0)
    expected = share * np.convolve(grown, 1.0 - erfcx(np.sqrt(time / tau)))[:4000]
    assert np.max(np.abs(late - expected)[5:]) < 0.01 * share * body[-1]


def test_the_tutorial_shows_the_file_of_heat_in_the_substrate_as_it_is():
    text = Path(effect("substrate_diffusion").file).read_text(encoding="utf-8")
    page = Path(__file__).resolve().parents[3] / "docs" / "tutorials" / "add_an_effect.md"
    assert f"```text\n{text}```\n" in page.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 80


def test_logarithmic_creep_gives_the_same_in_every_decade():
    base, run = _pair(
        "log_creep", "integrated", np.r_[np.zeros(10), np.full(20000, 4.5e-3)], rate=0.01, onset=2e-3
    )
    gone = (run[TIP_DEFLECTION] - base[TIP_DEFLECTION])[10:]
    step = base[TIP_DEFLECTION][-1] - base[TIP_DEFLECTION][0]
    decades = np.diff(gone[[30, 300, 3000]])
    assert decades == pytest.approx(0.01 * np.log(10.0) * step, rel=0.1)


def test_averaging_is_the_mean_over_the_window():
    current = np.repeat(np.random.default_rng(3).uniform(4.2e-3, 4.8e-3, 40), 9)
    for window in (3e-3, 4.6e-3):
        base, run = _pair("averaging", "integrated", current, window=window, signal=TIP_DEFLECTION)
        fine = np.interp(np.arange(current.size * 10) / 10, np.arange(current.size), base[TIP_DEFLECTION])
        width = round(window * 1e4)
        mean = np.array([fine[max(10 * k - width, 0) : 10 * k + 1].mean() for k in range(current.size)])
        assert np.max(np.abs(run[TIP_DEFLECTION] - mean)[20:]) < 0.03 * np.ptp(fine)


@pytest.mark.parametrize("difference", [1.2, -1.2])
def test_a_loop_width_difference_moves_the_branches_apart_by_half_of_it_each(difference):
    ramp = np.repeat(np.r_[np.linspace(3e-3, 8.6e-3, 500), np.linspace(8.6e-3, 3e-3, 500)], 8)
    base, run = _pair("loop_width_difference", "integrated", ramp, difference=difference)
    assert np.array_equal(base[RESISTANCE], run[RESISTANCE])
    turn = int(np.argmax(base["true_temperature"]))

    def crossing(found, part):
        d, t = found["true_tip_deflection"][part], base["true_temperature"][part]
        return np.interp(30e-6, d, t) if d[0] < d[-1] else np.interp(30e-6, d[::-1], t[::-1])

    inner = (base["true_temperature"] > 55.0) & (base["true_temperature"] < 68.0)
    up = np.flatnonzero(inner[:turn])
    down = turn + np.flatnonzero(
        (base["true_temperature"] > 48.0)[turn:] & (base["true_temperature"] < 62.0)[turn:]
    )
    assert crossing(run, up) - crossing(base, up) == pytest.approx(difference / 2, abs=0.12)
    assert crossing(run, down) - crossing(base, down) == pytest.approx(-difference / 2, abs=0.12)


@pytest.mark.parametrize("exponent", [0.2, 0.6, 1.0])
def test_a_rate_dependent_width_follows_its_equation(exponent):
    advance, excess, body = effect("rate_dependent_width").hooks["advance"], 0.8, 0.01
    times = np.arange(1, 4001) * 2e-4

    def film(t):
        return 60.0 + 5.0 * np.sin(2 * np.pi * t / 0.4)

    def equation(t, x):
        behind = film(t) - x
        return np.sign(behind) * (np.abs(behind) / excess) ** (1 / exponent) / body

    expected = solve_ivp(equation, (0, times[-1]), [60.0], "Radau", times, rtol=1e-8, atol=1e-10).y[0]
    seen, found = 60.0, []
    for warm in film(times):
        seen = advance(warm, 2e-4, seen, excess, exponent, body)
        found.append(seen)
    assert np.max(np.abs(np.array(found) - expected)) < 0.03 * excess
    for rate in (0.1, 1e4):  # K/s; a steady lag is exact for any step
        seen = 0.0
        for k in range(1, 3001):
            seen = advance(rate * k, 1.0, seen, excess, exponent, body)
        assert rate * 3000 - seen == pytest.approx(excess * (rate * body) ** exponent, rel=1e-6)


def test_a_rate_dependent_width_opens_the_loop_by_as_much_on_both_branches():
    def width(samples, **values):
        ramp = np.linspace(3.4e-3, 8.6e-3, samples)
        found = _pair("rate_dependent_width", "integrated", np.r_[ramp, ramp[::-1]], **values)
        crossings = []
        for run in found:
            d, t = run["true_tip_deflection"], run["true_temperature"]
            crossings.append(
                [
                    np.interp(30e-6, d[:samples], t[:samples]),
                    np.interp(30e-6, d[: samples - 1 : -1], t[: samples - 1 : -1]),
                ]
            )
        return np.diff(crossings, axis=0)[0]

    slow, fast = (width(samples, excess=0.8, exponent=0.25) for samples in (4000, 400))
    assert slow[0] == pytest.approx(-slow[1], rel=0.1)
    assert fast[0] / slow[0] == pytest.approx(10**0.25, rel=0.05)


def test_new_terms_follow_their_equations():
    hot = np.full(60, 8.2e-3)
    base, run = _pair("thermovoltage", "integrated", hot, coefficient=20.0)
    assert run[RESISTANCE] - base[RESISTANCE] == pytest.approx(
        20.0 * (base["true_temperature"] - 22.0), rel=1e-9
    )
    base, run = _pair("contact_drift", "integrated", hot, rate=100.0)
    assert run[RESISTANCE] - base[RESISTANCE] == pytest.approx(100.0 * 1e-3 * np.arange(60), abs=1e-6)
    _, run = _pair("source_compression", "integrated", hot, compression=2000.0)
    assert run[HEATER_CURRENT] == pytest.approx(8.2e-3 / (1 + 2000.0 * 8.2e-3**2))
    _, run = _pair("source_compression", "integrated", hot, compression=2000.0, exponent=5.0)
    assert run[HEATER_CURRENT] == pytest.approx(8.2e-3 / (1 + (2000.0 * 8.2e-3**2) ** 2.5))
    _, run = _pair("drive_gain_drift", "integrated", hot, rate=1.0)
    assert run[HEATER_CURRENT] == pytest.approx(8.2e-3 * (1 + 1e-3 * np.arange(60)))
    base, run = _pair("drive_gain_drift", "integrated", np.full(3000, 4e-3), rate=0.1, logged=0.0)
    assert np.array_equal(run[HEATER_CURRENT], base[HEATER_CURRENT])
    grown = (run["true_temperature"] - 22.0)[-1] / (base["true_temperature"] - 22.0)[-1]
    assert grown == pytest.approx((1 + 0.1 * 2.997) ** 2, rel=2e-3)
    base, run = _pair("stiffening", "integrated", hot, stiffness=2e7)
    d = base[TIP_DEFLECTION]
    assert run[TIP_DEFLECTION] == pytest.approx(d / (1 + 2e7 * d**2), rel=1e-9)
    base, run = _pair("stiffening", "integrated", hot, stiffness=2e7, rest_bend=-1e3)
    d = base[TIP_DEFLECTION]
    assert run[TIP_DEFLECTION] == pytest.approx(d / (1 - 1e3 * d + 2e7 * d**2), rel=1e-9)
    values = {"amplitude": 1e-6, "pitch": 9e-6, "phase_angle": 0.4, "signal": TIP_DEFLECTION}
    base, run = _pair("sensor_ripple", "integrated", hot, **values)
    d = base[TIP_DEFLECTION]
    assert run[TIP_DEFLECTION] - d == pytest.approx(1e-6 * np.sin(2 * np.pi * d / 9e-6 + 0.4), abs=1e-12)
    dither = np.tile([2.0e-3, 4.6e-3], 200).repeat(10)
    base, run = _pair("backlash", "integrated", dither, width=0.4e-6)
    assert np.ptp(base[TIP_DEFLECTION][-40:]) - np.ptp(run[TIP_DEFLECTION][-40:]) == pytest.approx(
        0.8e-6, rel=0.02
    )
    base, run = _pair("backlash", "integrated", np.zeros(5), width=0.4e-6, start=-0.5)
    assert run[TIP_DEFLECTION] - base[TIP_DEFLECTION] == pytest.approx(0.2e-6)


def test_magnitudes_of_another_device_follow_its_own_sizes(tmp_path):
    file = tmp_path / "large.yaml"
    text = (Path(vo2_models.device.__file__).parent / "files" / "integrated.yaml").read_text()
    file.write_text(text.replace("id: integrated", "id: large").replace("1.8e-3", "18.0e-3"))
    small, large = (effect("second_thermal_mode").magnitudes(device) for device in ("integrated", str(file)))
    assert large["share"] == small["share"]
    assert large["time_constant"] == pytest.approx([10 * v for v in small["time_constant"]])
    assert effect("latent_heat").occurs_on(str(file)) and not effect("peltier_joule_heating").occurs_on(
        str(file)
    )
