"""Drawing cases: repeatable, balanced, the same for a longer run; excess and answers as the rig has them."""

from collections import Counter

import numpy as np
import pytest
from vo2_models.recording import (
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
)
from vo2_studies.challenge.catalogue import IDS
from vo2_studies.challenge.conditions import CONDITIONS
from vo2_studies.challenge.constants import CONSTANTS, names_constant
from vo2_studies.challenge.device_files import FACTOR, draw_preset
from vo2_studies.challenge.devices import PRESETS, draw_device
from vo2_studies.challenge.draw import draw_case, follow_up_recording
from vo2_studies.challenge.excitation import (
    EXCITATIONS,
    TEST_SAMPLES,
    calibration_current,
    excitation,
    informative_current,
    loop_current,
    played_current,
    triangle_current,
)
from vo2_studies.challenge.families import FAMILIES
from vo2_studies.challenge.plan import KINDS, Choice, plan_case
from vo2_studies.challenge.rig import Plan, simulate


def one_effect(name, **more):
    return Choice("plays", only_effects=(name,), **more)


def test_shares_and_balance():
    each = len(IDS)
    plans = [plan_case(7, index) for index in range(32 * each)]
    counts = Counter(plan.kind for plan in plans)
    assert set(counts) == set(KINDS)
    # the contract's: a quarter without effect, half with one, an eighth with two, an eighth outside
    assert counts["none"] + counts["day"] + counts["moved"] == 8 * each
    assert counts["one"] + counts["always"] + counts["beside"] == 16 * each
    assert counts["two"] == counts["outside"] == 4 * each
    singles = Counter(plan.effects[0] for plan in plans if plan.kind == "one")
    assert set(singles) == set(IDS)
    assert set(singles.values()) == {10}
    by_device = Counter((plan.effects[0], plan.device) for plan in plans if plan.kind == "one")
    assert min(by_device.values()) >= 5
    for plan in plans:
        expected = {"none": 0, "day": 0, "moved": 0, "two": 2}.get(plan.kind, 1)
        assert len(set(plan.effects)) == expected
        assert bool(plan.constant) == (plan.kind in ("moved", "beside"))


def test_plan_depends_on_seed_and_index_only():
    assert [plan_case(7, k) for k in range(40)] == [plan_case(7, k) for k in reversed(range(40))][::-1]
    assert [plan_case(7, k) for k in range(40)] != [plan_case(8, k) for k in range(40)]


def test_families_conditions_and_excitations_in_turn():
    choice = Choice(condition="all", excitation="all", leave_out="proximity", samples=(2000, 100_000))
    plans = [plan_case(3, k, choice) for k in range(210)]
    families = Counter(plan.family for plan in plans)
    assert set(families) == set(FAMILIES) - {"proximity"}
    assert max(families.values()) - min(families.values()) <= 1
    assert Counter(plan.condition for plan in plans) == dict.fromkeys(CONDITIONS, 30)
    assert Counter(plan.excitation for plan in plans) == dict.fromkeys(EXCITATIONS, 42)
    lengths = [plan.samples for plan in plans]
    assert 2000 <= min(lengths) < 3000
    assert 70_000 < max(lengths) <= 100_000


def test_restrictions_and_their_errors():
    only = [
        plan_case(1, k, Choice(only_effects=("creep", "latent_heat"), device="integrated")) for k in range(6)
    ]
    assert {plan.effects[0] for plan in only} == {"creep", "latent_heat"}
    assert {plan.device for plan in only} == {"integrated"}
    assert {plan_case(1, k, Choice(kinds=("none",))).kind for k in range(5)} == {"none"}
    assert plan_case(1, 0, Choice(only_effects=("creep",), kinds=("always",))).kind == "always"
    for wrong in (
        {"device": "x"},
        {"kinds": ("x",)},
        {"only_effects": ("x",)},
        {"condition": "x"},
        {"excitation": "x"},
        {"samples": (9, 3)},
        {"family": "x"},
        {"rigs": "x"},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[-1].rstrip("s")):
            plan_case(1, 0, Choice(**wrong))
    with pytest.raises(ValueError, match="none that applies"):
        plan_case(1, 0, Choice(only_effects=("latent_heat",), device="peltier"))


@pytest.mark.parametrize("index", [0, 1, 2, 8])
def test_case_is_repeatable_bit_for_bit(index):
    plan = plan_case(3, index, Choice("plays", condition="all", rigs="range"))
    first, second = draw_case(3, plan), draw_case(3, plan)
    assert first.answer == second.answer
    for a, b in ((first.calibration, second.calibration), (first.test, second.test)):
        assert np.array_equal(a.measurement.time_s, b.measurement.time_s)
        assert np.array_equal(a.commands, b.commands)
        for name in a.measurement.channels:
            assert np.array_equal(a.measurement[name], b.measurement[name], equal_nan=True)
    other = draw_case(4, plan)
    assert not np.array_equal(
        first.test.measurement[RESISTANCE][:99], other.test.measurement[RESISTANCE][:99]
    )


@pytest.mark.parametrize("index", range(16))
def test_recordings_and_answers(index):
    plan = plan_case(21, index)
    case = draw_case(21, plan)
    preset = PRESETS[plan.device]
    assert len(case.test.measurement) == TEST_SAMPLES
    for recorded in (case.calibration, case.test):
        recording = recorded.measurement
        assert recording.device == plan.device
        assert (STAGE_TEMPERATURE in recording) == preset.has_temperature
        assert np.allclose(np.diff(recording.time_s), preset.sample_period)
        for name in (RESISTANCE, TIP_DEFLECTION, HEATER_CURRENT):
            assert np.all(np.isfinite(recording[name]))
        stamps, command = recorded.commands
        assert np.allclose(stamps, recording.time_s[:-1])
        assert command.min() >= preset.current_limits[0]
        assert command.max() <= preset.current_limits[1]
    answer = case.answer
    assert [effect["id"] for effect in answer["effects"]] == list(plan.effects)
    assert (answer["excess"] == 0) == (plan.kind == "none")
    assert [entry["constant"] for entry in answer["moved"]] == ([plan.constant] if plan.constant else [])
    for effect in answer["effects"]:
        assert effect["excess"] > 0
        assert effect["channels"]
        assert effect["families"]
        assert effect["branch"] in ("heating", "cooling", "both")


def test_an_effect_of_old_is_in_the_calibration_too():
    old, new = (
        draw_case(5, plan_case(5, 0, one_effect("series_resistance", device="integrated", kinds=(kind,))))
        for kind in ("always", "one")
    )
    added = old.answer["effects"][0]["parameters"]["resistance"]["value"]
    with_, without = (case.calibration.measurement[RESISTANCE].min() for case in (old, new))
    assert with_ - without == pytest.approx(added, rel=0.35)


@pytest.mark.parametrize("constant", [c.name for c in CONSTANTS])
def test_a_moved_constant_moves_the_recording(constant):
    for index in range(20):
        plan = plan_case(4, index, Choice("plays", kinds=("moved",), device="peltier"))
        if plan.constant == constant:
            break
    case = draw_case(4, plan)
    assert case.answer["excess"] > 1.0
    assert case.answer["effects"] == []
    assert case.answer["moved"][0]["by"] != 0


def test_names_of_constants():
    assert names_constant("ambient", {"constant": "thermal.ambient"})
    assert names_constant("time_constant", {"constant": "thermal.time_constant"})
    assert names_constant("heat_gain", {"constant": "thermal.square_gain"})
    assert names_constant("deflection_zero", {"constant": "deflection.zero"})
    assert names_constant("film_scale", {"constant": "resistance.gain"})
    assert names_constant("deflection_scale", {"constant": "deflection.gain"})
    assert not names_constant("film_scale", {"constant": "deflection.gain"})
    assert not names_constant("ambient", {"constant": "thermal.time_constant"})
    assert not names_constant("deflection_zero", {"constant": "film_resistance.offset"})


def test_another_day_is_small_and_told():
    case = draw_case(4, plan_case(4, 0, Choice("plays", kinds=("day",))))
    day = case.answer["day"]
    assert 0.3 <= abs(day["ambient"]) <= 0.7
    assert abs(day["deflection_zero"]) == pytest.approx(1e-7)
    assert abs(day["time_constant"]) == pytest.approx(0.04)
    assert case.answer["excess"] > 0


def test_two_effects_differ_in_size():
    sizes = []
    for k in range(8):
        effects = draw_case(6, plan_case(6, k, Choice("plays", kinds=("two",)))).answer["effects"]
        sizes.append(sorted(effect["excess"] for effect in effects))
    assert np.median([high / low for low, high in sizes]) > 2.5


@pytest.mark.parametrize("name", list(PRESETS))
def test_rigs_span_factors_and_work(name):
    rigs = [draw_preset(np.random.default_rng(seed), PRESETS[name]) for seed in range(40)]
    currents = [rig.current_limits[1] / PRESETS[name].current_limits[1] for rig in rigs]
    assert 1 / FACTOR <= min(currents) < 0.5 and 2.0 < max(currents) <= FACTOR
    times = [rig.time_constant / PRESETS[name].time_constant for rig in rigs]
    assert min(times) < 0.5 and max(times) > 2.0
    for rig in rigs:
        temperature = rig.steady_temperature(np.array(rig.operating))
        assert temperature.min() < rig.heating[0] - rig.width[0] - 2 * rig.heating[1]
        assert temperature.max() > rig.heating[0] + 1.5 * rig.heating[1]
    plan = plan_case(9, 0, one_effect("creep", device=name, rigs="range"))
    case = draw_case(9, plan)
    low, high = case.preset.resistance
    assert case.test.measurement[RESISTANCE].min() == pytest.approx(low, rel=0.2)
    assert case.test.measurement[RESISTANCE].max() == pytest.approx(high, rel=0.4)
    assert case.test.measurement.device == case.preset.name != name


def recorded_under(condition, device="peltier"):
    return draw_case(5, plan_case(5, 0, Choice("plays", kinds=("none",), device=device, condition=condition)))


def test_conditions():
    clean = recorded_under("clean")
    period = clean.preset.sample_period
    measured, stamps = clean.test.measurement, clean.test.commands[0]
    end = recorded_under("end")
    assert np.allclose(end.test.commands[0] - stamps, period)
    assert np.array_equal(end.test.measurement[RESISTANCE], measured[RESISTANCE])
    late = recorded_under("late")
    assert 0.2 * period < np.ptp([late.test.commands[0][0], stamps[0]]) < 2.6 * period
    assert late.answer["command_delay_s"] == pytest.approx(stamps[0] - late.test.commands[0][0])
    jitter = recorded_under("jitter").test.measurement
    assert 0.05 * period < np.std(np.diff(jitter.time_s)) < 0.3 * period
    missing = recorded_under("missing").test.measurement
    assert 1 - len(missing) / len(measured) == pytest.approx(0.05, abs=0.02)
    outliers = recorded_under("outliers")
    noise = outliers.answer["noise"][TIP_DEFLECTION]["sd"]
    off = outliers.test.measurement[TIP_DEFLECTION] - measured[TIP_DEFLECTION]
    assert 0.002 < np.mean(np.abs(off) > 7 * noise) < 0.008
    rates = recorded_under("rates").test.measurement
    share = [np.mean(np.isnan(rates[name])) for name in (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)]
    assert share[0] == 0 and max(share) >= 0.5 and sorted(share)[1] == 0


def test_jittered_sensors_are_read_at_their_stamps():
    """Readings at shifted instants lie on the curve of the unshifted run."""
    device = draw_device(np.random.default_rng(1), "integrated")
    current = excitation(np.random.default_rng(2), device.preset, "sines", 8000)
    shift = np.random.default_rng(3).uniform(-2.5e-4, 2.5e-4, current.size)
    plain, jittered = simulate(device, current, Plan()), simulate(device, current, Plan(), shift)
    there = np.interp(jittered.time, plain.time, plain.channels[TIP_DEFLECTION])
    moved, expected = (x - plain.channels[TIP_DEFLECTION] for x in (jittered.channels[TIP_DEFLECTION], there))
    assert np.corrcoef(moved, expected)[0, 1] > 0.9


def test_excess_is_what_the_recordings_show():
    """The mean square of (with - without) over the noise power, recomputed from another noise realisation."""
    case = draw_case(5, plan_case(5, 0, one_effect("series_resistance")))
    effect = case.answer["effects"][0]
    assert effect["channels"] == [RESISTANCE]
    added = effect["parameters"]["resistance"]["value"]
    measured = case.test.measurement[RESISTANCE]
    shift = np.log10(measured) - np.log10(measured - added)
    expected = np.mean(shift**2) / case.answer["noise"][RESISTANCE]["sd"] ** 2
    assert effect["excess"] == pytest.approx(expected, rel=0.03)


def test_excess_spans_weak_and_strong():
    choice = Choice("plays", kinds=("one",), device="peltier")
    excess = [draw_case(9, plan_case(9, k, choice)).answer["excess"] for k in range(16)]
    inside = [value for value in excess if 3 <= value <= 1000]
    assert len(inside) >= 14
    assert min(excess) < 20
    assert max(excess) > 200


@pytest.mark.parametrize("name", list(EXCITATIONS))
@pytest.mark.parametrize("device", list(PRESETS))
def test_excitations_have_any_length_and_cross_the_transition(device, name):
    preset = PRESETS[device]
    for samples in (2000, 10_000, 25_000):
        current = excitation(np.random.default_rng(1), preset, name, samples)
        assert samples - 30 <= current.size <= samples
        assert preset.current_limits[0] <= current.min() and current.max() <= preset.current_limits[1]
        temperature = preset.steady_temperature(current)
        assert temperature.min() < preset.heating[0] - preset.width[0] < preset.heating[0] < temperature.max()


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
    case, other = (
        draw_case(5, plan_case(5, 0, one_effect("creep", device=name, excitation=kind)))
        for kind in ("triangle", "informative")
    )
    assert np.array_equal(case.calibration.commands[1], other.calibration.commands[1])
    assert not np.array_equal(case.test.commands[1], other.test.commands[1])


@pytest.mark.parametrize("name", list(PRESETS))
def test_one_loop_goes_up_and_down_once(name):
    preset = PRESETS[name]
    current = loop_current(np.random.default_rng(0), preset)
    temperature = preset.steady_temperature(current[300:-60])
    top = int(np.argmax(temperature))
    assert 1000 < top < 1400 and 1000 < temperature.size - top < 1400
    inside = slice(20, -20)  # the current leads a slow stage at the turns
    assert np.all(np.diff(temperature[:top][inside]) > 0) and np.all(np.diff(temperature[top:][inside]) < 0)
    case = draw_case(5, plan_case(5, 0, one_effect("creep", device=name, excitation="loop")))
    assert case.answer["duration_s"] == pytest.approx(current.size * preset.sample_period, rel=0.2)


def test_a_drift_keeps_its_pace_in_the_follow_up():
    for index in range(9):  # one whose form is the straight line
        plan = plan_case(5, index, one_effect("sensor_gain_drift", device="integrated", excitation="loop"))
        case = draw_case(5, plan)
        if case.answer["effects"][0]["form"] == "catalogue":
            break
    rate = case.answer["effects"][0]["parameters"]["rate"]["value"]
    signal = case.answer["effects"][0]["signal"]
    current = np.full(4000, 8e-3)
    drifting = follow_up_recording(5, plan, case.answer, current).measurement[signal]
    clean = case.answer | {"effects": []}
    still = follow_up_recording(5, plan, clean, current).measurement[signal]
    grown = np.median(drifting[-200:]) / np.median(still[-200:]) - 1.0
    assert grown == pytest.approx(rate * 4.0, rel=0.1)


def test_follow_up_repeats_device_and_effect():
    plan = plan_case(5, 0, one_effect("series_resistance", device="integrated"))
    case = draw_case(5, plan)
    current = played_current(
        {"kind": "levels", "levels_a": [4e-3, 8e-3], "hold_s": 0.05}, PRESETS["integrated"]
    )
    recording = follow_up_recording(5, plan, case.answer, current).measurement
    assert len(recording) == current.size
    hot = np.median(recording[RESISTANCE][90:100])
    test_hot = case.test.measurement[RESISTANCE].min()
    assert hot == pytest.approx(test_hot, rel=0.05)
    with pytest.raises(ValueError, match="excitation"):
        played_current({"kind": "dance"}, PRESETS["integrated"])
