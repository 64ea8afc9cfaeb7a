"""Any law of the registry can be the law of a device: file, stream, settled start, effects, and the law itself."""

import numpy as np
import pytest
from vo2_models.device import PARAMETERS, DeviceModel
from vo2_models.hysteresis.bouc_wen import BoucWen
from vo2_models.hysteresis.domains import DomainEnsemble
from vo2_models.hysteresis.laws import ADDED, FILED, scaled_law
from vo2_models.hysteresis.limiting_loop import LimitingLoop
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.preisach import NonMonotonicPreisach, PreisachOperator
from vo2_models.self_sensing import self_sensing

BANK = PlayBank(
    [0.3, 0.3], [0.0, 0.0], [0.3, 0.25], [-18.6, -15.5], [0.3, 0.25], [-17.4, -13.5], [-4.7, 1e-3]
)
LAWS = {
    "plays": BANK,
    "preisach": PreisachOperator(np.linspace(40.0, 85.0, 11), np.full(55, 6e-4), -4.6),
    "nonmonotonic": NonMonotonicPreisach(
        PreisachOperator(np.linspace(40.0, 85.0, 11), np.full(55, 6e-4), -4.6), 1e-3, 2e-3, 22.0
    ),
    "bouc_wen": BoucWen(0.2, 0.8, 1.5, 0.6, [-4.7, 1e-3]),
    "limiting_loop": LimitingLoop(0.3, 66.0, 0.25, 58.0, 0.9, -5.3, -4.1, [0.0, 1e-3]),
    "domains": DomainEnsemble(
        np.linspace(55.0, 70.0, 60), np.linspace(50.0, 60.0, 60), None, 1.0, -5.3, -4.1, [0.0, 1e-3]
    ),
    **ADDED,
}
NAMES = pytest.mark.parametrize("name", sorted(LAWS))
CURRENT = np.repeat(np.random.default_rng(2).uniform(4e-3, 8e-3, 40), 6)
SLOW = {"transition_kinetics": {"time_constant": 3e-3}}


def _model(name: str, **changes) -> DeviceModel:
    return DeviceModel("integrated", resistance=LAWS[name], deflection=PlayBank(), **changes)


def test_there_is_an_example_of_every_law_of_a_model_file():
    assert set(LAWS) == set(FILED)


@NAMES
def test_the_device_runs_the_law_along_its_temperature(name):
    run = _model(name).simulate(CURRENT, noise=False)
    path = np.concatenate([[22.0], run["true_temperature"]])
    expected = LAWS[name].run(path, LAWS[name].initial_memory())[1:]
    assert -np.log10(run["true_film_resistance"]) == pytest.approx(expected, rel=1e-9)
    assert np.ptp(expected) > 0.3


@NAMES
def test_stream_equals_batch_and_file_and_back(name, tmp_path):
    model = _model(name, effects=SLOW)
    batch = model.simulate(CURRENT, seed=5)
    stream = model.stepper(seed=5)
    samples = np.array([stream.step(i) for i in CURRENT])
    model.save(tmp_path / "model.yaml")
    again = DeviceModel.load(tmp_path / "model.yaml").simulate(CURRENT, seed=5)
    for k, channel in enumerate(stream.channels):
        assert np.array_equal(samples[:, k], batch[channel])
        assert again[channel] == pytest.approx(batch[channel], rel=1e-12)
    assert set(model.to_parameters()) <= {p.name for p in PARAMETERS}


@NAMES
def test_a_settled_start_is_where_a_long_hold_leads(name):
    model = _model(name, effects=SLOW)
    held = np.full(400, 6.2e-3)
    settled = model.simulate(held, settled=True, noise=False)["film_resistance"]
    assert np.ptp(settled) < 1e-5 * settled[0]
    assert model.simulate(held, noise=False)["film_resistance"][-1] == pytest.approx(settled[0], rel=1e-5)


@NAMES
def test_effects_that_ask_the_law_act_on_it(name):
    """Latent heat tries moves without making them, a moving Preisach feeds its output back, a share follows the middle."""
    plain = _model(name).simulate(CURRENT, noise=False)["film_resistance"]
    for effects in (
        {"latent_heat": {"latent": 8.0}},
        {"minor_loop_incongruency": {"kappa": 2.0}},
        {"non_hysteretic_branches": {"share": 0.2}},
    ):
        changed = _model(name, effects=effects).simulate(CURRENT, noise=False)["film_resistance"]
        assert np.isfinite(changed).all()
        assert np.max(np.abs(np.log10(changed / plain))) > 1e-3


def test_the_two_channels_may_have_different_laws():
    law = BoucWen(0.2, 0.8, 1.5, 2e-5, [3e-5])
    one = DeviceModel("integrated", resistance=BANK, deflection=law).simulate(CURRENT, noise=False)
    plays = DeviceModel("integrated", resistance=BANK).simulate(CURRENT, noise=False)
    assert one["film_resistance"] == pytest.approx(plays["film_resistance"], rel=1e-12)
    path = np.concatenate([[22.0], one["true_temperature"]])
    assert one["true_tip_deflection"] == pytest.approx(law.run(path)[1:], rel=1e-9)


def test_plays_asked_for_by_a_scheme_that_knows_no_other_law_are_missed_in_one_line():
    with pytest.raises(ValueError, match=r"model.resistance.law: found 'bouc_wen', need 'plays'"):
        PlayBank.from_parameters("model.resistance", _model("bouc_wen").to_parameters())


@pytest.mark.parametrize("name", ["preisach", "bouc_wen", "limiting_loop"])
def test_self_sensing_inverts_any_law_that_rises(name):
    tip = BoucWen(0.2, 0.8, 1.5, 2e-5, [3e-5])
    model = DeviceModel("integrated", resistance=LAWS[name], deflection=tip)
    run = model.simulate(CURRENT, noise=False)
    estimate, _ = self_sensing("composite", model.to_parameters()).estimate(run["true_film_resistance"])
    assert np.asarray(estimate.deflection) == pytest.approx(run["true_tip_deflection"], abs=2e-8)


def test_a_resistance_law_without_an_inverse_is_told_in_one_line():
    law = NonMonotonicPreisach(LAWS["preisach"], 0.05, 0.06, 22.0)
    parameters = DeviceModel("integrated", resistance=law, deflection=LAWS["bouc_wen"]).to_parameters()
    with pytest.raises(
        ValueError,
        match=r"found 'nonmonotonic' whose -log10 R falls while .* need a law with an inverse: `fit --law plays`",
    ):
        self_sensing("composite", parameters)


@NAMES
def test_a_law_is_scaled(name):
    path = np.concatenate([np.linspace(22.0, 90.0, 60), np.linspace(90.0, 50.0, 40)])
    law = LAWS[name]
    scaled = scaled_law(law, 1.1, 0.2)
    assert type(scaled) is type(law)
    assert scaled.run(path) == pytest.approx(1.1 * law.run(path) + 0.2, rel=1e-9)


def test_a_law_that_cannot_be_moved_is_told(monkeypatch):
    free = {name: text for name, text in BoucWen.described.items() if name != "polynomial"}
    monkeypatch.setattr(BoucWen, "described", free)
    assert scaled_law(LAWS["bouc_wen"], 2.0, 0.0).amplitude == 2.0 * LAWS["bouc_wen"].amplitude
    with pytest.raises(ValueError, match="found 'bouc_wen' without polynomial or bias, need one of them"):
        scaled_law(LAWS["bouc_wen"], 1.0, 0.2)
