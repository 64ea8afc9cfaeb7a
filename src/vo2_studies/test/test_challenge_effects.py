"""Every concealed effect: in the contract, on the channels it should reach and no other, gone at its neutral value."""

import numpy as np
import pytest
from vo2_models.effects import effect_ids
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION
from vo2_studies.challenge.catalogue import (
    CATALOGUE,
    IDS,
    OUTSIDE,
    draw_effect,
    families,
    forms,
    presets_of,
    redrawn,
)
from vo2_studies.challenge.devices import draw_device
from vo2_studies.challenge.effect import Context, Drawn
from vo2_studies.challenge.excess import excess_by_channel
from vo2_studies.challenge.excitation import TEST_SAMPLES, informative_current
from vo2_studies.challenge.outside import COMPOSED, DEPENDENCES, MEMORIES, PLACES, describe
from vo2_studies.challenge.rig import Plan, channels_of, draw_rig_noise, log_channels, simulate

D_ONLY = {"phase_dependent_expansion", "transition_offset", "creep", "cantilever_resonance"}
D_ONLY |= {
    "log_creep",
    "backlash",
    "stiffening",
    "sensor_ripple",
    "sensor_zero_drift",
    "loop_width_difference",
}
R_ONLY = {"series_resistance", "leakage_resistance", "current_crosstalk"}
R_ONLY |= {"thermovoltage", "contact_drift"}
NOT_STAGE = {"transition_kinetics", "minor_loop_incongruency", "training_drift", "slow_relaxation"}
NOT_STAGE |= {"non_hysteretic_branches", "laser_heating", "rate_dependent_width"}
EVERY = [(effect, preset) for effect in CATALOGUE for preset in effect.presets]


def setup(preset, seed=2):
    rng = np.random.default_rng(seed)
    device = draw_device(rng, preset)
    command = informative_current(rng, device.preset)
    return rng, device, command


_clean: dict = {}


def clean_run(preset):
    if preset not in _clean:
        rng, device, command = setup(preset)
        _clean[preset] = device, command, simulate(device, command, Plan()), draw_rig_noise(rng, device)
    return _clean[preset]


def expected_channels(effect, signal, preset):
    name = effect.id
    if signal is not None:
        return {signal}
    if name in D_ONLY:
        return {TIP_DEFLECTION}
    if name in R_ONLY:
        return {RESISTANCE}
    both = {RESISTANCE, TIP_DEFLECTION}
    return both if preset == "integrated" or name in NOT_STAGE else both | {STAGE_TEMPERATURE}


def test_catalogue_is_the_contracts():
    assert set(IDS) <= set(effect_ids())
    assert len(set(IDS) - {"rate_dependent_width", "sensor_zero_drift"}) == 42  # those beyond the contract
    assert OUTSIDE not in effect_ids()
    assert presets_of("peltier_joule_heating") == ("peltier",)
    with pytest.raises(ValueError, match="effect"):
        forms("perpetual_motion")


def test_forms_of_one_id_differ_in_form_only():
    for name in IDS:
        several = forms(name)
        assert len({one.form for one in several}) == len(several)
        assert {(one.presets, one.per_signal, one.driver) for one in several} == {
            (several[0].presets, several[0].per_signal, several[0].driver)
        }
    assert {one.form for one in forms("ambient_drift")} >= {"catalogue", "sinusoidal room"}


@pytest.mark.parametrize(("effect", "preset"), EVERY, ids=[f"{e.id}-{e.form}-{p}" for e, p in EVERY])
def test_reaches_exactly_its_channels_and_vanishes(effect, preset):
    device, command, clean, noise = clean_run(preset)
    for seed in range(12):
        context = Context(np.random.default_rng(seed), device, TEST_SAMPLES * device.preset.sample_period)
        drawn = draw_effect(effect, context)
        assert all(np.isfinite(value) for value, _ in drawn.parameters.values())
        plan = Plan()
        drawn.into(plan, context)
        truth = simulate(device, command, plan)
        excess = excess_by_channel(clean, truth, plan, noise)
        reached = {name for name, value in excess.items() if value > 0}
        assert reached <= expected_channels(effect, drawn.signal, preset)
        if reached:
            break
    assert reached == expected_channels(effect, drawn.signal, preset)
    neutral = Plan()
    drawn.into(neutral, context, **effect.neutral)
    gone = simulate(device, command, neutral)
    for name in channels_of(device):
        assert np.allclose(gone.channels[name], clean.channels[name], rtol=1e-9, atol=0)
    assert max(excess_by_channel(clean, gone, neutral, noise).values()) < 1e-12


FAMILY_CHANNELS = {
    "film": {RESISTANCE},
    "structure": {TIP_DEFLECTION},
    "transition": {RESISTANCE, TIP_DEFLECTION},
} | {f"sensor:{name}": {name} for name in (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)}


@pytest.mark.parametrize(
    ("place", "dependence", "memory"),
    [(p, k, m) for p in PLACES for k in range(len(DEPENDENCES[p])) for m in range(len(MEMORIES))],
)
def test_composed_kinds_reach_what_their_place_reaches(place, dependence, memory):
    device, command, clean, noise = clean_run("peltier")
    context = Context(np.random.default_rng(4), device, TEST_SAMPLES * device.preset.sample_period)
    parameters = COMPOSED.draw(context)
    parameters |= {
        "place": (float(PLACES.index(place)), "1"),
        "dependence": (float(dependence), "1"),
        "memory": (float(memory), "1"),
        "amplitude": (0.02, "1"),
    }
    drawn = Drawn(COMPOSED, parameters)
    assert describe(drawn.values)["place"] == place
    plan = Plan()
    drawn.into(plan, context)
    truth = simulate(device, command, plan)
    excess = excess_by_channel(clean, truth, plan, noise)
    assert all(np.isfinite(value) for value in excess.values())
    reached = {name for name, value in excess.items() if value > 0}
    assert reached == FAMILY_CHANNELS.get(families(drawn)[0], {RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE})


def test_composed_kinds_are_many_and_gone_without_amplitude():
    device, command, clean, _ = clean_run("integrated")
    context = Context(np.random.default_rng(4), device, 10.0)
    several = [draw_effect(COMPOSED, context) for _ in range(200)]
    kinds = {tuple(describe(one.values).values()) for one in several}
    assert len(kinds) > 30
    assert not any(STAGE_TEMPERATURE in kind for kind in kinds), "there is no such sensor"
    for drawn in several[:12]:
        neutral = Plan()
        drawn.into(neutral, context, amplitude=0.0)
        gone = simulate(device, command, neutral)
        for name in channels_of(device):
            assert np.allclose(gone.channels[name], clean.channels[name], rtol=1e-9, atol=0)


def test_families_are_the_contracts():
    device, *_ = clean_run("peltier")
    context = Context(np.random.default_rng(4), device, 10.0)
    plain = {"drive", "heat", "transition", "film", "structure"}
    for effect in CATALOGUE:
        for family in families(draw_effect(effect, context)):
            kind, _, channel = family.partition(":")
            assert family in plain or (kind in ("sensor", "clock") and channel in channels_of(device))


def test_an_answer_is_enough_to_repeat_an_effect():
    device, *_ = clean_run("integrated")
    drawn = draw_effect(forms("ambient_drift")[1], Context(np.random.default_rng(4), device, 10.0))
    said = {name: {"value": value, "unit": unit} for name, (value, unit) in drawn.parameters.items()}
    assert redrawn("ambient_drift", drawn.effect.form, said, None) == drawn


def test_driver_effects_show_in_the_shunt_reading_only():
    device, command, _, noise = clean_run("integrated")
    plan = Plan()
    context = Context(np.random.default_rng(3), device, 10.0)
    draw_effect(forms("driver_deadzone")[0], context).into(plan, context)
    truth = simulate(device, command, plan)
    shunt = log_channels(truth, plan, noise, np.random.default_rng(1), shunt=True)[HEATER_CURRENT]
    set_value = log_channels(truth, plan, noise, np.random.default_rng(1), shunt=False)[HEATER_CURRENT]
    assert np.array_equal(set_value[1:], command[:-1])
    moved = np.abs(shunt - set_value)[command.argmax() - 50 : command.argmax()]
    assert moved.min() > 3 * noise[HEATER_CURRENT].sd


def test_commands_act_from_their_stamp_on():
    """A step commanded at sample k shows in the current that sample k + 1 logs, and warms the film by then."""
    device = draw_device(np.random.default_rng(1), "integrated")
    command = np.zeros(100)
    command[50:] = 5e-3
    truth = simulate(device, command, Plan())
    assert truth.current[50] == 0
    assert truth.current[51] == pytest.approx(5e-3)
    assert truth.temperature[50] == pytest.approx(device.ambient)
    assert truth.temperature[51] > device.ambient + 5


def test_noise_level_and_colour():
    from vo2_studies.challenge.noise import ChannelNoise, sample_noise

    values = sample_noise(np.random.default_rng(0), ChannelNoise(0.3, 0.5, 0.9), 200_000)
    assert values.std() == pytest.approx(0.3, rel=0.02)
    lag_one = np.mean(values[1:] * values[:-1]) / values.var()
    assert lag_one == pytest.approx(0.45, abs=0.02)
