"""The compiled core against exact solutions, the plain-Python reference, and the play library."""

from typing import Any

import numpy as np
import pytest
from device_reference import simulate as reference
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_models.device.chain import COLUMNS
from vo2_models.device.coefficients import Coefficient
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank, move_plays, tanh

PLAYS = [(0.30, 60.0, 2.0), (0.22, 59.0, 3.5), (0.35, 58.0, 5.0)]


def _bank(low: float, span: float) -> PlayBank:
    a, m, h = np.array(PLAYS).T
    weights = np.full(a.size, 0.5 * span / a.size)
    return PlayBank(weights, np.zeros(a.size), a, -a * (m + h), a, -a * (m - h), [low])


def _model(device: str, **effects: dict) -> DeviceModel:
    return DeviceModel(device, resistance=_bank(-5.0, 1.0), deflection=_bank(0.0, 50e-6), effects=effects)


def _currents(device: str) -> np.ndarray:
    rng = np.random.default_rng(3)
    if device == "integrated":
        return np.repeat(rng.uniform(5.0e-3, 7.5e-3, 40), 4)
    return np.repeat(rng.uniform(-1.1, 0.2, 20), 40)


CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "latent_heat": ("integrated", {"latent": 15.0}, {"latent": 15.0}),
    "cooling_asymmetry": ("integrated", {"ratio": 0.4}, {"cooling": 0.4}),
    "nonlinear_heat_loss": (
        "integrated",
        {"share": 4e-4 * 60**1.5, "exponent": 2.5},
        {"beta": 4e-4, "exponent": 2.5},
    ),
    "phase_dependent_heat_loss": ("integrated", {"gamma": 0.2}, {"phase_loss": 0.2}),
    "heater_tcr": ("integrated", {"alpha": 2e-3}, {"tcr": 2e-3}),
    "second_thermal_mode": ("integrated", {"share": 0.1, "time_constant": 0.02}, {"slow": (0.1, 0.02)}),
    "ambient_drift": ("integrated", {"rate": 9.0, "curvature": -1.0}, {"drift": (9.0, -1.0)}),
    "transition_kinetics": ("integrated", {"time_constant": 1.5e-3}, {"kinetics": 1.5e-3}),
    "minor_loop_incongruency": ("integrated", {"kappa": 3.0}, {"kappa": 3.0}),
    "laser_heating": ("integrated", {"rise": 3.0}, {"laser": 3.0}),
    "dead_time": ("integrated", {"delay": 2.3e-3}, {"delay": 2.3e-3}),
    "peltier_joule_heating": ("peltier", {"rho": 8.0, "pumping": 0.06}, {"k2": 8.0, "pumping": 0.06}),
}


def _reference(device: str, current: np.ndarray, **terms: Any) -> tuple[np.ndarray, np.ndarray]:
    nominal = preset(device)
    arguments: dict[str, Any] = {
        "k1": nominal.linear_gain,
        "k2": nominal.square_gain,
        "delay": nominal.dead_time,
    } | terms
    found = reference(
        current.tolist(),
        dt=nominal.sample_period,
        plays=PLAYS,
        tau=nominal.time_constant,
        ambient=nominal.ambient,
        substeps=150 if device == "integrated" else 20,
        **arguments,
    )
    return np.array(found[0]), np.array(found[1])


def _core(model: DeviceModel, current: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Film temperature and fraction; the deflection of this bank is 25 um below its middle at fraction 0."""
    run = model.simulate(current, noise=False)
    return run["true_temperature"], run["true_tip_deflection"] / 50e-6 + 0.5


@pytest.mark.parametrize("name", CASES)
def test_effect_matches_an_independent_integration(name):
    device, values, terms = CASES[name]
    current = _currents(device)
    t_core, s_core = _core(_model(device, **{name: values}), current)
    t_plain, s_plain = _core(_model(device), current)
    t_reference, s_reference = _reference(device, current, **terms)
    t_plain_reference, s_plain_reference = _reference(device, current)
    # what the effect does, by either way: 4 % of its largest change, the fitted simulation's own step length included
    for core, plain, other, other_plain in (
        (t_core, t_plain, t_reference, t_plain_reference),
        (s_core, s_plain, s_reference, s_plain_reference),
    ):
        change, expected = core - plain, other - other_plain
        size = np.abs(expected).max()
        if size < 1e-9:
            assert np.abs(change).max() < 1e-9
        else:
            assert np.abs(change - expected).max() < 0.04 * size
    assert np.abs(s_reference - s_plain_reference).max() > 0.01


@pytest.mark.parametrize(
    "effects", [{}, {"heater_tcr": {"alpha": 2e-3}}, {"training_drift": {"shift": 0.01}}]
)
def test_a_film_is_asked_only_where_it_turns(effects):
    """The transitions are moved once a sample and at turns; moved at every step, they come out the same."""
    model = _model("integrated", dead_time={"delay": 2.3e-3}, **effects)
    simulation, dt, current = model.simulation, 1e-3, _currents("integrated")
    c = simulation.prepared(dt)
    c[Coefficient.SUBSTEPS] = 5.0
    found, expected = (np.empty((current.size, COLUMNS)) for _ in range(2))
    normals = np.zeros((current.size, 4))
    simulation.call(c, simulation.initial_state(), current, normals, found)
    assert c[Coefficient.FOLLOWS] == 1.0
    c[Coefficient.FOLLOWS] = 0.0
    simulation.call(c, simulation.initial_state(), current, normals, expected)
    assert np.count_nonzero(np.diff(np.sign(np.diff(found[:, 5])))) > 20  # turns between samples, too
    assert np.allclose(found, expected, rtol=1e-13, atol=1e-20)


def test_finer_steps_come_closer_to_the_reference():
    from dataclasses import replace

    current = _currents("integrated")
    expected, _ = _reference("integrated", current, latent=15.0)
    simulation = _model("integrated", latent_heat={"latent": 15.0}).simulation
    errors = []
    for steps in (1.0, 4.0, 32.0):
        finer = replace(simulation, steps_per_constant=steps)
        errors.append(np.abs(finer.run(current, dt=1e-3)[:, 5] - expected).max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.06  # what is left is the reference's own step


@settings(max_examples=40, deadline=None)
@given(
    levels=st.lists(st.floats(0.0, 12.7e-3), min_size=1, max_size=30),
    tau=st.floats(2e-4, 0.05),
)
def test_linear_heating_is_exact(levels, tau):
    current = np.array(levels)
    model = DeviceModel("integrated", scalars={"thermal.time_constant": tau}, deflection=_bank(0.0, 1e-6))
    found = model.simulate(current, noise=False)["true_temperature"]
    decay = np.exp(-1e-3 / tau)
    theta, expected = 0.0, []
    for i in levels:
        target = 1.01e6 * i * i
        theta = target + (theta - target) * decay
        expected.append(22.0 + theta)
    assert np.allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1e-3, 2.7e-3, 40e-3])
def test_dead_time_of_any_length_is_exact(delay):
    """A single step of current: T is the exponential, `delay` later, even between samples."""
    current = np.r_[np.zeros(5), np.full(80, 6e-3)]
    model = DeviceModel("integrated", scalars={"driver.dead_time": delay}, deflection=_bank(0.0, 1e-6))
    time = np.arange(current.size) * 1e-3
    since = np.maximum(time - 4e-3 - delay, 0.0)  # the first 6 mA flows in the interval that ends at sample 5
    expected = 22.0 + 1.01e6 * 36e-6 * -np.expm1(-since / 1.8e-3)
    assert np.allclose(model.simulate(current, noise=False)["true_temperature"], expected, rtol=0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    inputs=st.lists(st.floats(20.0, 100.0), min_size=1, max_size=40),
    radii=st.lists(st.floats(0.0, 0.6), min_size=3, max_size=3),
)
def test_play_bank_equals_the_play_library(inputs, radii):
    from vo2_models.hysteresis.kernels import egpi_step

    a, m, h = np.array(PLAYS).T
    bank = PlayBank([1.0, 2.0, 0.5], radii, a, -a * (m + h), 1.2 * a, -1.2 * a * (m - h), [0.0])
    ours, theirs = np.r_[-1e6, -1.0 + np.array(radii)], np.r_[-1e6, -1.0 + np.array(radii)]
    for v in inputs:
        tried = move_plays(v, bank.packed, ours, False)
        before = ours.copy()
        assert move_plays(v, bank.packed, ours, True) == tried
        expected = egpi_step(v, bank.packed, theirs)
        assert tried == pytest.approx(expected, abs=1e-12)
        assert np.allclose(ours, theirs, rtol=0, atol=1e-14)
        assert before[0] != v or np.array_equal(before, ours)


def test_tanh_of_the_bank_is_tanh_to_rounding():
    argument = np.r_[np.linspace(-30.0, 30.0, 20001), np.geomspace(1e-300, 1.0, 2000), 1e9, -1e9, 0.0]
    ours = np.array([tanh.py_func(a) for a in argument])
    np.testing.assert_allclose(ours, np.tanh(argument), rtol=2e-15, atol=1e-315)


def test_latent_heat_conserves_enthalpy():
    """After a closed cycle back to rest nothing is left over: heat stored equals heat given back."""
    current = np.r_[np.full(60, 8.4e-3), np.zeros(400)]
    run = _model("integrated", latent_heat={"latent": 25.0}).simulate(current, noise=False)
    assert run["true_temperature"][-1] == pytest.approx(22.0, abs=1e-3)
    plain = _model("integrated").simulate(current, noise=False)
    # on the way up the film is colder while it takes up heat, on the way down warmer while it gives it back
    assert np.all(run["true_temperature"][:20] <= plain["true_temperature"][:20] + 1e-9)
    assert np.all(run["true_temperature"][60:90] >= plain["true_temperature"][60:90] - 1e-9)
    assert np.max(plain["true_temperature"] - run["true_temperature"]) > 2.0
