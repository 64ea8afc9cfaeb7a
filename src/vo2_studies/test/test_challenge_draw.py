"""Drawing cases: repeatable, balanced, the same for a longer run; excess and answers as the rig has them."""

from collections import Counter

import numpy as np
import pytest
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
)
from vo2_studies.challenge.devices import PRESETS
from vo2_studies.challenge.draw import draw_case, follow_up_recording, plan_case
from vo2_studies.challenge.excitation import (
    TEST_SAMPLES,
    calibration_current,
    informative_current,
    loop_current,
    played_current,
    triangle_current,
)


def test_shares_and_balance():
    plans = [plan_case(7, index) for index in range(640)]
    assert Counter(plan.kind for plan in plans) == {"none": 160, "one": 320, "two": 80, "outside": 80}
    singles = Counter(plan.effects[0] for plan in plans if plan.kind == "one")
    assert set(singles.values()) <= {10, 11}
    by_device = Counter((plan.effects[0], plan.device) for plan in plans if plan.kind == "one")
    assert min(by_device.values()) >= 5
    for plan in plans:
        assert len(set(plan.effects)) == {"none": 0, "two": 2}.get(plan.kind, 1)


def test_plan_depends_on_seed_and_index_only():
    assert [plan_case(7, k) for k in range(40)] == [plan_case(7, k) for k in reversed(range(40))][::-1]
    assert [plan_case(7, k) for k in range(40)] != [plan_case(8, k) for k in range(40)]


def test_restrictions_and_their_errors():
    only = [plan_case(1, k, only_effects=["creep", "latent_heat"], device="integrated") for k in range(6)]
    assert {plan.effects[0] for plan in only} == {"creep", "latent_heat"}
    assert {plan.device for plan in only} == {"integrated"}
    assert {plan_case(1, k, kinds=["none"]).kind for k in range(5)} == {"none"}
    for wrong in ({"device": "x"}, {"kinds": ["x"]}, {"only_effects": ["x"]}):
        with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[-1].rstrip("s")):
            plan_case(1, 0, **wrong)
    with pytest.raises(ValueError, match="none that applies"):
        plan_case(1, 0, only_effects=["latent_heat"], device="peltier")


@pytest.mark.parametrize("index", [0, 1, 2, 6])
def test_case_is_repeatable_bit_for_bit(index):
    plan = plan_case(3, index)
    first, second = draw_case(3, plan), draw_case(3, plan)
    assert first.answer == second.answer
    for a, b in ((first.calibration, second.calibration), (first.test, second.test)):
        assert np.array_equal(a.time_s, b.time_s)
        for name in a.channels:
            assert np.array_equal(a[name], b[name], equal_nan=True)
    other = draw_case(4, plan)
    assert not np.array_equal(first.test[RESISTANCE], other.test[RESISTANCE])


@pytest.mark.parametrize("index", range(12))
def test_recordings_and_answers(index):
    plan = plan_case(21, index)
    case = draw_case(21, plan)
    preset = PRESETS[plan.device]
    assert len(case.test) == TEST_SAMPLES
    for recording in (case.calibration, case.test):
        assert recording.device == plan.device
        assert (STAGE_TEMPERATURE in recording) == preset.has_temperature
        assert np.allclose(np.diff(recording.time_s), preset.sample_period)
        for name in (RESISTANCE, TIP_DEFLECTION, HEATER_CURRENT):
            assert np.all(np.isfinite(recording[name]))
        command = recording[COMMANDED_CURRENT][1:]
        assert command.min() >= preset.current_limits[0]
        assert command.max() <= preset.current_limits[1]
    answer = case.answer
    assert [effect["id"] for effect in answer["effects"]] == list(plan.effects)
    if plan.kind == "none":
        assert answer["excess"] == 0
    for effect in answer["effects"]:
        assert effect["excess"] > 0
        assert effect["channels"]
        assert effect["branch"] in ("heating", "cooling", "both")


def test_excess_is_what_the_recordings_show():
    """The mean square of (with - without) over the noise power, recomputed from another noise realisation."""
    plan = plan_case(5, 0, only_effects=["series_resistance"])
    case = draw_case(5, plan)
    effect = case.answer["effects"][0]
    assert effect["channels"] == [RESISTANCE]
    added = effect["parameters"]["resistance"]["value"]
    without = case.test[RESISTANCE] - added
    shift = np.log10(case.test[RESISTANCE]) - np.log10(without)
    expected = np.mean(shift**2) / case.answer["noise"][RESISTANCE]["sd"] ** 2
    assert effect["excess"] == pytest.approx(expected, rel=0.03)


def test_excess_spans_weak_and_strong():
    excess = [
        draw_case(9, plan_case(9, k, kinds=["one"], device="peltier")).answer["excess"] for k in range(16)
    ]
    inside = [value for value in excess if 3 <= value <= 1000]
    assert len(inside) >= 14
    assert min(excess) < 20
    assert max(excess) > 200


@pytest.mark.parametrize("name", list(PRESETS))
def test_excitation_visits_what_it_should(name):
    preset = PRESETS[name]
    current = informative_current(np.random.default_rng(0), preset)
    assert current.size == TEST_SAMPLES
    temperature = preset.steady_temperature(current)
    cold, hot = (
        preset.heating[0] - preset.width[0] - 2 * preset.heating[1],
        preset.heating[0] + 2 * preset.heating[1],
    )
    assert temperature.min() < cold
    assert temperature.max() > hot
    # the loop at the end repeats the one at the start
    size = 1240 if name == "integrated" else 1320
    tail = current[-size:]
    start = [k for k in range(60, 600) if np.allclose(current[k + 20 : k + size], tail[20:], atol=1e-9)]
    assert start
    calibration = calibration_current(np.random.default_rng(0), preset)
    assert 5000 < calibration.size < 20000


@pytest.mark.parametrize("name", list(PRESETS))
def test_triangle_is_equal_slow_major_loops(name):
    preset = PRESETS[name]
    current = triangle_current(np.random.default_rng(0), preset)
    assert current.size == TEST_SAMPLES
    cold, hot = sorted(float(preset.steady_temperature(i)) for i in preset.operating)
    temperature = preset.steady_temperature(current[300:])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(temperature))) != 0)
    assert turns.size >= 6
    # every turn of the loops at an end of the range, none within; the rest after them needs no lead of the current
    span = temperature.max() - temperature.min()
    assert span > 0.5 * (hot - cold)
    at_turns = temperature[turns[:6] + 1]
    assert np.all(np.minimum(at_turns - temperature.min(), temperature.max() - at_turns) < 0.05 * span)
    plan = plan_case(5, 0, only_effects=["creep"], device=name)
    case, other = draw_case(5, plan, excitation="triangle"), draw_case(5, plan)
    assert np.array_equal(case.calibration[RESISTANCE], other.calibration[RESISTANCE])
    assert not np.array_equal(case.test[COMMANDED_CURRENT][1:], other.test[COMMANDED_CURRENT][1:])


@pytest.mark.parametrize("name", list(PRESETS))
def test_one_loop_goes_up_and_down_once(name):
    preset = PRESETS[name]
    current = loop_current(np.random.default_rng(0), preset)
    temperature = preset.steady_temperature(current[300:-60])
    top = int(np.argmax(temperature))
    assert 1000 < top < 1400 and 1000 < temperature.size - top < 1400
    inside = slice(20, -20)  # the current leads a slow stage at the turns
    assert np.all(np.diff(temperature[:top][inside]) > 0) and np.all(np.diff(temperature[top:][inside]) < 0)
    case = draw_case(5, plan_case(5, 0, only_effects=["creep"], device=name), excitation="loop")
    assert case.answer["duration_s"] == pytest.approx(current.size * preset.sample_period, rel=0.2)


def test_a_drift_keeps_its_pace_in_the_follow_up():
    plan = plan_case(5, 0, only_effects=["sensor_gain_drift"], device="integrated")
    case = draw_case(5, plan, excitation="loop")
    rate = case.answer["effects"][0]["parameters"]["rate"]["value"]
    signal = case.answer["effects"][0]["signal"]
    current = np.full(4000, 8e-3)
    drifting = follow_up_recording(5, plan, case.answer, current)[signal]
    clean = case.answer | {"effects": []}
    still = follow_up_recording(5, plan, clean, current)[signal]
    grown = np.median(drifting[-200:]) / np.median(still[-200:]) - 1.0
    assert grown == pytest.approx(rate * 4.0, rel=0.1)


def test_follow_up_repeats_device_and_effect():
    plan = plan_case(5, 0, only_effects=["series_resistance"], device="integrated")
    case = draw_case(5, plan)
    current = played_current(
        {"kind": "levels", "levels_a": [4e-3, 8e-3], "hold_s": 0.05}, PRESETS["integrated"]
    )
    recording = follow_up_recording(5, plan, case.answer, current)
    assert len(recording) == current.size
    hot = np.median(recording[RESISTANCE][90:100])
    test_hot = case.test[RESISTANCE].min()
    assert hot == pytest.approx(test_hot, rel=0.05)
    with pytest.raises(ValueError, match="excitation"):
        played_current({"kind": "dance"}, PRESETS["integrated"])
