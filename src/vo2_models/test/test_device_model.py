"""The fitted simulation as parameters: what is written is what is read, and every node can declare it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from vo2_models.device import PARAMETERS, DeviceModel
from vo2_models.device.model import SensorModel
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.model_file import save_model_parameters
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

SLOPE, CENTRE, HALF = np.array([0.3, 0.25]), np.array([60.0, 58.0]), np.array([2.0, 4.0])


def _bank(weight: float, polynomial: list[float]) -> PlayBank:
    return PlayBank(
        np.full(2, weight),
        np.zeros(2),
        SLOPE,
        -SLOPE * (CENTRE + HALF),
        SLOPE,
        -SLOPE * (CENTRE - HALF),
        polynomial,
    )


@pytest.fixture
def model() -> DeviceModel:
    return DeviceModel(
        "integrated",
        scalars={"thermal.time_constant": 2e-3},
        resistance=_bank(0.25, [-5.3, 5e-3]),
        deflection=_bank(12e-6, [30e-6, -1e-7, 1e-10]),
        sensors={
            RESISTANCE: SensorModel(noise=2e-3, residual=1e-3),
            TIP_DEFLECTION: SensorModel(noise=5e-8, colour=(0.3,), residual=6e-8, residual_colour=(0.2, 0.1)),
        },
        effects={
            "latent_heat": {"latent": 8.0},
            "sensor_lag:tip_deflection": {"signal": TIP_DEFLECTION, "time_constant": 1e-3},
            "sensor_lag:film_resistance": {"signal": RESISTANCE, "time_constant": 2e-3},
        },
        uncertainty={"thermal.time_constant": (1e-5,), "deflection.weights": (1e-7, 2e-7)},
    )


CURRENT = np.repeat(np.random.default_rng(0).uniform(4e-3, 8e-3, 50), 8)


def test_file_and_back(model, tmp_path):
    model.save(tmp_path / "model.yaml", comment="for a test")
    again = DeviceModel.load(tmp_path / "model.yaml")
    assert again.to_parameters() == model.to_parameters()
    for noise in (False, True):
        one, other = (m.simulate(CURRENT, seed=3, noise=noise) for m in (model, again))
        for channel in one.channels:
            assert np.array_equal(one[channel], other[channel])


def test_foreign_sections_are_ignored(model, tmp_path):
    parameters = model.to_parameters() | {"model.self_sensing.scheme": "composite"}
    save_model_parameters(tmp_path / "m.yaml", parameters)
    assert DeviceModel.load(tmp_path / "m.yaml").to_parameters() == model.to_parameters()


def test_every_parameter_is_declared_once_with_a_range(model):
    names = [p.name for p in PARAMETERS]
    assert len(names) == len(set(names))
    assert set(model.to_parameters()) <= set(names)
    for p in PARAMETERS:
        assert p.name.startswith("model.") and p.description
        p.check(p.default)


def test_declared_defaults_mean_no_effect():
    """A node declares everything; what it hands back untouched must not switch an effect on."""
    plain = DeviceModel("integrated", resistance=_bank(0.25, [-5.3]), deflection=_bank(12e-6, [30e-6]))
    declared = {p.name: p.default for p in PARAMETERS} | plain.to_parameters()
    again = DeviceModel.from_parameters(declared)
    assert again.effects == {}
    assert np.array_equal(
        again.simulate(CURRENT, noise=False)[RESISTANCE], plain.simulate(CURRENT, noise=False)[RESISTANCE]
    )


def test_stream_equals_batch(model):
    batch = model.simulate(CURRENT, seed=5)
    stream = model.stepper(seed=5)
    samples = np.array([stream.step(i) for i in CURRENT])
    for k, name in enumerate(stream.channels):
        assert np.array_equal(samples[:, k], batch[name])


def test_bank_is_the_same_law_as_the_play_library(model):
    """Resistance and deflection are (7.3) and (7.5) over the film temperature."""
    plain = DeviceModel("integrated", resistance=model.resistance, deflection=model.deflection)
    run = plain.simulate(CURRENT, noise=False)
    t = run["true_temperature"]
    for bank, values in (
        (model.resistance, -np.log10(run["true_film_resistance"])),
        (model.deflection, run["true_tip_deflection"]),
    ):
        law = bank.egpi()
        # from a long cold rest: every play at its lower end, then up to ambient
        state = law.initial_state(v=-200.0)
        expected, _ = law.simulate(np.r_[22.0, t], state)
        assert np.allclose(np.asarray(expected)[1:], values, rtol=1e-10, atol=1e-16)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"model.device": "nowhere"}, "model.device"),
        ({"model.thermal.time_constant": -1.0}, "model.thermal.time_constant"),
        ({"model.resistance.weights": [1.0, 2.0, 3.0]}, "model.resistance"),
        ({"model.effects.latent_heat.latent": 1e9}, "model.effects.latent_heat.latent"),
        ({"model.sensors.film_resistance.noise": float("nan")}, "model.sensors.film_resistance.noise"),
    ],
)
def test_bad_parameters_are_named(model, change, word):
    with pytest.raises(ValueError, match=word):
        DeviceModel.from_parameters(model.to_parameters() | change)


def test_no_model_at_all():
    with pytest.raises(ValueError, match="run `fit`"):
        DeviceModel.from_parameters({p.name: p.default for p in PARAMETERS})


def test_missing_deflection_is_a_flat_line(model):
    half = DeviceModel("integrated", resistance=model.resistance)
    run = half.simulate(CURRENT, noise=False)
    assert np.all(run[TIP_DEFLECTION] == 0.0)
    assert np.ptp(run[RESISTANCE]) > 1e4


REVERSIBLE = PlayBank([30e-6], [0.0], [0.06], [-0.06 * 60.05], [0.06], [-0.06 * 59.95], [0.0])
"""A play of 0.1 K beside loops of 4 and 8 K: what the tip does without hysteresis, in micrometres per kelvin."""

LOOP = 30e-6 * 0.06 * 0.1
"""Height [m] of its own loop: the most that its memory can add."""


def _with_reversible(model: DeviceModel) -> DeviceModel:
    law = model.deflection
    parts = {
        name: np.append(getattr(law, name), getattr(REVERSIBLE, name))
        for name in vars(REVERSIBLE)
        if name in law.described and name not in ("polynomial", "radii")
    }
    return replace(
        model, deflection=PlayBank(**parts, radii=np.zeros(3), polynomial=law.polynomial), effects={}
    )


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("transition_offset", {"offset": 3.0}),
        ("transition_kinetics", {"time_constant": 5e-3}),
        ("rate_dependent_width", {"excess": 0.5, "exponent": 0.3}),
        ("phase_dependent_expansion", {"slope": 5e-8}),
    ],
)
def test_what_has_no_loop_follows_the_temperature_and_not_the_phase(model, effect, values):
    """The change by an effect on the phase is the same with and without a play that has no loop."""
    plain = replace(model, effects={})
    changes = [
        replace(one, effects={effect: values}).simulate(CURRENT, noise=False)[TIP_DEFLECTION]
        - one.simulate(CURRENT, noise=False)[TIP_DEFLECTION]
        for one in (plain, _with_reversible(model))
    ]
    assert np.ptp(changes[0]) > 10 * LOOP
    assert np.abs(changes[1] - changes[0]).max() < LOOP


def test_phase_fraction_leaves_out_what_has_no_loop(model):
    """Latent heat is of the transition: the film is as warm with a play that has no loop as without."""
    heat = {"latent_heat": {"latent": 8.0}}
    films = [
        replace(one, effects=heat).simulation.run(CURRENT, dt=1e-3, state=None)[:, 5]
        for one in (replace(model, effects={}), _with_reversible(model))
    ]
    assert np.abs(films[1] - films[0]).max() < 8.0 * LOOP / np.ptp(model.deflection.span)
    cold = replace(model, effects={}).simulation.run(CURRENT, dt=1e-3, state=None)[:, 5]
    assert np.abs(films[0] - cold).max() > 1.0


def test_an_effect_of_nearly_nothing_changes_nearly_nothing(model):
    """What is computed apart once an effect on the phase is on adds up to what it was before."""
    whole = _with_reversible(model)
    touched = replace(whole, effects={"transition_offset": {"offset": 1e-12}})
    one, other = (m.simulate(CURRENT, noise=False)[TIP_DEFLECTION] for m in (whole, touched))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.ptp(one) + 1e-16)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("model.effects.backlahs.gap", "is no parameter of an effect that is known here; correct it, or give the folder"),
        ("model.effects.creep.shar", "is no parameter of an effect that is known here"),
        ("model.thermal.time_constants", "is no parameter of a model; correct it or take it out"),
        ("model.resistance.weight", "is no parameter of a model"),
    ],
)  # fmt: skip
def test_a_name_that_is_not_known_is_refused_and_not_left_out(name, said):
    """A corrected model whose effect is in a file that is not given would run without it."""
    with pytest.raises(ValueError, match=rf"{re.escape(name)}: {said}"):
        DeviceModel.from_parameters({"model.device": "integrated", name: 0.1})
