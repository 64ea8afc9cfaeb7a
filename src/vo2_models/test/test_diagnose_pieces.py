"""Pieces of the diagnosis: file format, noise, data check, comb detection, excitations."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from vo2_models.device import DeviceModel, preset
from vo2_models.device.description import described
from vo2_models.diagnosis import decide, search
from vo2_models.diagnosis.adequacy import Adequacy
from vo2_models.diagnosis.breakdown import one_loop, turning_points
from vo2_models.diagnosis.check import Unusable, check_recording
from vo2_models.diagnosis.decide import _is_small
from vo2_models.diagnosis.families import BY_DEPENDENCE, OF_ONE_LOOP
from vo2_models.diagnosis.files import _farther_off
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.next_experiment import TO_SEE, library, without_explanation
from vo2_models.diagnosis.noise import NoiseModel, fit_noise, level_from_differences, outliers
from vo2_models.diagnosis.nominal import Nominal, basis_of, transition_of
from vo2_models.diagnosis.nonparametric_correction import Shape
from vo2_models.diagnosis.nuisance import Constant
from vo2_models.diagnosis.part import _after_torn_steps, _turns
from vo2_models.diagnosis.problem import _possible
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.read import read
from vo2_models.diagnosis.report import beside_the_first, probabilities
from vo2_models.diagnosis.result import SCHEMA, validate
from vo2_models.effects.adc_quantization import value_step
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.recording import TIP_DEFLECTION, Recording, regular, regular_instants

ANSWER = {
    "schema": SCHEMA,
    "verdict": "differs",
    "moved": [],
    "location": [
        {
            "signal": "film_resistance",
            "share": 1.0,
            "time_s": [[0.0, 1.0]],
            "branch": "both",
            "temperature_degC": None,
            "temperature_surrogate_a": [0.0, 0.01],
            "frequency_hz": [0.0, 10.0],
        }
    ],
    "effects": [
        {
            "id": "creep",
            "probability": 0.9,
            "family": "structure",
            "statement": "words",
            "equation": "y = x",
            "parameters": {"share": {"value": 0.1, "std": 0.01, "unit": "1"}},
        }
    ],
    "candidates": [{"id": "creep", "probability": 0.9, "held_out_nrmse": {"film_resistance": 0.1}}],
    "fit": {"film_resistance": {"nrmse_before": 0.2, "nrmse_after": 0.1, "noise_floor": 0.1}},
    "indistinguishable": [],
    "next_experiment": None,
}


def model() -> Nominal:
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    return Nominal.from_parameters(DeviceModel("integrated", resistance=bank).to_parameters())


def recording(**changes) -> Recording:
    time = np.arange(2000) * 1e-3
    current = 6e-3 + 2e-3 * np.sin(2 * np.pi * 2 * time)
    values = {
        "heater_current": current,
        "film_resistance": 1e5 * np.exp(-300 * (current - 4e-3)),
        "tip_deflection": 1e-5 + 5e-3 * current,
    }
    device = changes.pop("device", "integrated")
    time = changes.pop("time_s", time)
    return Recording(time, {**values, **changes}, device)


def test_a_valid_answer_passes() -> None:
    validate(ANSWER)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("verdict",), "perhaps", "verdict"),
        (("verdict",), "agrees", "effects"),
        (("location", 0, "share"), 1.4, "share"),
        (("effects", 0, "probability"), -0.1, "probability"),
        (("effects", 0, "parameters", "share", "std"), -1.0, "std"),
        (("candidates", 0, "probability"), 1.5, "probabilities"),
        (("fit", "film_resistance", "nrmse_after"), float("nan"), "nrmse_after"),
        (("effects", 0, "family"), "weather", "family"),
        (("moved",), [{"constant": "x", "was": 0.0, "is": 1.0, "std": -1.0}], "moved x"),
        (("schema",), "vo2-diagnosis/2", "schema"),
    ],
)
def test_a_broken_answer_is_refused_by_name(path, value, words) -> None:
    broken = copy.deepcopy(ANSWER)
    place = broken
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(ValueError, match=words):
        validate(broken)


@pytest.mark.parametrize("ar", [(), (0.6,), (0.9,), (0.5, 0.3)])
def test_whitening_gives_unit_innovations_and_is_undone(ar) -> None:
    rng = np.random.default_rng(5)
    noise = NoiseModel(0.3, ar)
    x = lfilter([0.3], [1.0, *(-a for a in ar)], rng.standard_normal(30_000))[10_000:]
    white = noise.whiten(x)
    assert np.std(white) == pytest.approx(1.0, abs=0.03)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03
    np.testing.assert_allclose(noise.color(white), x, atol=1e-10)
    assert noise.level == pytest.approx(np.std(x), rel=0.08)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_level_and_colour_are_found(rho) -> None:
    e = np.random.default_rng(1).standard_normal(20_000)
    found = fit_noise(lfilter([1.0], [1.0, -rho], e))
    assert found.innovation == pytest.approx(1.0, rel=0.03)
    assert sum(found.ar) == pytest.approx(rho, abs=0.04)


def test_lost_samples_are_no_white_noise_on_what_is_slow() -> None:
    random = np.random.default_rng(1)
    x = lfilter([1.0], [1.0, -0.999], random.normal(0.0, 1.0, 6000))
    found = fit_noise(x, random.uniform(size=x.size) > 0.05)
    assert found.innovation == pytest.approx(1.0, rel=0.05)


def test_level_is_seen_through_a_moving_signal() -> None:
    t = np.linspace(0, 10, 5000)
    x = 50 * np.sin(t) + 0.1 * np.random.default_rng(0).standard_normal(t.size)
    assert level_from_differences(x) == pytest.approx(0.1, rel=0.1)


def test_a_good_recording_passes_the_check() -> None:
    assert [f.kind for f in check_recording(recording(), model(), Limits())] == []


def test_a_rig_may_call_itself_what_it_likes() -> None:
    assert check_recording(recording(device="bench_3"), model(), Limits()) == []


def test_what_is_unusable_is_refused_with_the_reason() -> None:
    time = np.arange(2000) * 1e-3
    rng = np.random.default_rng(0)
    flat = np.full(2000, 5e-3)
    cases = {
        "was recorded on device 'peltier'": recording(device="peltier"),
        "need heater_current, the drive of device integrated: is it a recording of another device": Recording(
            time, {"tip_deflection": recording()["tip_deflection"]}
        ),
        "varies by": recording(heater_current=flat),
        "check the unit": recording(heater_current=recording()["heater_current"] * 1e3),
        "clock": recording(time_s=np.cumsum(rng.uniform(0.2e-3, 3e-3, 2000))),
        "sample period": recording(time_s=time * 1e4),
        "mostly noise": recording(
            film_resistance=6e4 * np.exp(0.3 * rng.standard_normal(2000)),
            tip_deflection=2e-5 + 2e-6 * rng.standard_normal(2000),
        ),
        "is it in kohm": recording(film_resistance=1e-3 * recording()["film_resistance"]),
        "off by a factor of 1 000 000": recording(tip_deflection=1e6 * recording()["tip_deflection"]),
        "is constant": recording(film_resistance=np.full(2000, 1e5), tip_deflection=np.full(2000, 1e-5)),
        "missing from": recording(
            film_resistance=np.full(2000, np.nan), tip_deflection=np.full(2000, np.nan)
        ),
        "end value": recording(
            film_resistance=np.where(np.arange(2000) % 50, 2e5, recording()["film_resistance"]),
            tip_deflection=np.full(2000, 1e-5),
        ),
        "need at least 50": recording().slice(0, 49),
        "film_resistance is a copy of heater_current": recording(
            film_resistance=1e6 * recording()["heater_current"]
        ),
        "tip_deflection is a copy of film_resistance": recording(
            tip_deflection=1e-9 * recording()["film_resistance"]
        ),
        "are swapped": recording(
            film_resistance=recording()["tip_deflection"], tip_deflection=recording()["film_resistance"]
        ),
    }
    for words, bad in cases.items():
        with pytest.raises(Unusable, match=words):
            check_recording(bad, model(), Limits())


def test_a_sensor_that_shows_nothing_is_no_copy_of_another():
    found = check_recording(recording(tip_deflection=np.zeros(2000)), model(), Limits())
    assert any("tip_deflection is constant" in finding.text for finding in found)


@pytest.mark.parametrize("noise", [0.0, 3e-8])
def test_a_channel_that_stands_still_is_not_compared(noise) -> None:
    still = 1e-5 + noise * np.random.default_rng(0).standard_normal(2000)
    (found,) = check_recording(recording(tip_deflection=still), model(), Limits())
    assert found.leaves_out == "tip_deflection" and "not compared" in found.text
    nominal = Nominal.from_parameters(model().model.to_parameters())
    clock = Clock(lambda share, text: None, 1)
    (part,) = read([recording(tip_deflection=still)], nominal, [], Limits(), clock).parts
    assert part.channels == ("film_resistance",)


def test_a_deflection_in_a_smaller_unit_does_not_stand_still() -> None:
    with pytest.raises(Unusable, match="check the unit"):
        check_recording(recording(tip_deflection=1e-6 * recording()["tip_deflection"]), model(), Limits())


def test_the_steps_of_a_coarse_converter_are_no_noise() -> None:
    fast = 2e-5 + 2e-5 * np.sin(np.arange(2000) * 0.6)
    coarse = 9e-6 * np.round(fast / 9e-6)
    assert level_from_differences(coarse) > 0.25 * np.std(coarse)
    found = check_recording(recording(tip_deflection=coarse), model(), Limits())
    assert not [finding for finding in found if finding.kind == "noise"]


def test_few_samples_and_jittered_stamps_are_limits() -> None:
    few = check_recording(recording().slice(700, 1000), model(), Limits())
    assert [f.kind for f in few] == ["few"] and "300 samples" in few[0].text and "1.3 times" in few[0].text
    rng = np.random.default_rng(4)
    whole = recording()
    jittered = replace(whole, time_s=whole.time_s + rng.uniform(-0.15e-3, 0.15e-3, 2000))
    (found,) = check_recording(jittered, model(), Limits())
    assert found.kind == "jitter" and "moved onto a regular grid" in found.text


def test_jittered_stamps_are_interpolated_and_gaps_stay_missing() -> None:
    rng = np.random.default_rng(4)
    stamps = np.cumsum(rng.uniform(0.6e-3, 1.4e-3, 3000))
    keep = np.ones(3000, dtype=bool)
    keep[1000:1100] = False
    wave = np.sin(2 * np.pi * stamps / 0.2)
    even = regular(Recording(stamps[keep], {"x": wave[keep]}, ""))
    assert np.ptp(np.diff(even.time_s)) < 1e-9
    good = np.isfinite(even["x"])
    assert np.max(np.abs(even["x"] - np.sin(2 * np.pi * even.time_s / 0.2))[good]) < 1e-3
    inside = (even.time_s > stamps[999] + 2e-3) & (even.time_s < stamps[1100] - 2e-3)
    assert not good[inside].any() and good[~inside].mean() > 0.99


@pytest.mark.parametrize("samples", [300, 20_000])
@pytest.mark.parametrize("scatter", ["uniform", "normal"])
def test_samples_that_come_early_or_late_are_moved_to_the_clock_behind_them(
    samples: int, scatter: str
) -> None:
    rng = np.random.default_rng(5)
    instants = 7.0 + 1e-3 * np.arange(samples)
    late = 1e-3 * (
        rng.uniform(-0.25, 0.25, samples) if scatter == "uniform" else rng.normal(0, 0.12, samples)
    )
    keep = rng.random(samples) > 0.05
    keep[[0, -1]] = True

    def course(at: np.ndarray) -> np.ndarray:
        return np.asarray(3e4 * 10 ** np.sin(2 * np.pi * at / 0.1))

    read, noise = course(instants + late), rng.normal(0.0, 1.0, samples)
    read[samples // 2] *= 3.0
    command = np.floor(instants / 0.05)
    stamps = (instants + late)[keep]
    channels = {
        "film_resistance": read[keep],
        "tip_deflection": noise[keep],
        "commanded_current": command[keep],
    }
    even = regular(Recording(stamps, channels, ""))
    clock = regular_instants(stamps)
    assert clock is not None and clock[1] == pytest.approx(1e-3, rel=2.0 / samples**1.5)
    assert np.max(np.abs(even.time_s - instants)) < 0.06e-3
    assert np.array_equal(even["commanded_current"][keep], command[keep])
    assert np.flatnonzero(np.isnan(even["film_resistance"])).tolist() == np.flatnonzero(~keep).tolist()
    off = np.abs(np.log10(even["film_resistance"] / course(instants)))
    unmoved = np.abs(np.log10(read / course(instants)))
    fine = keep & (np.abs(np.arange(samples) - samples // 2) > 0)
    assert np.max(off[fine]) < 5e-3 and np.std(off[fine]) < 0.1 * np.std(unmoved[fine])
    assert np.nanstd(even["tip_deflection"]) == pytest.approx(np.std(noise[keep]), rel=0.04)


def test_stamps_that_follow_no_clock_have_none() -> None:
    rng = np.random.default_rng(4)
    assert regular_instants(np.cumsum(rng.uniform(0.6e-3, 1.4e-3, 3000))) is None
    assert regular_instants(1e-3 * np.arange(3000.0)) is None
    assert regular_instants(np.round(3.0 + 1e-3 * np.arange(3000.0), 9)) is None
    waits = np.cumsum(rng.normal(1e-3, 2e-5, 3000))  # a loop that waits for a period after its work
    keep = rng.random(3000) > 0.05
    keep[[0, -1]] = True
    even = regular(
        Recording(
            waits[keep], {"tip_deflection": np.flatnonzero(keep) * 1.0, "commanded_current": waits[keep]}, ""
        )
    )
    assert len(even) == 3000 and np.array_equal(even["tip_deflection"][keep], np.flatnonzero(keep))


def test_a_drive_that_is_only_logged_was_read_with_what_it_drives() -> None:
    late = np.random.default_rng(4).uniform(-0.05, 0.05, 2000)
    time = 1e-3 * (np.arange(2000) + late)
    logged = Recording(time, {"heater_current": np.sin(time), "tip_deflection": np.sin(time)}, "")
    even = regular(logged)
    assert np.array_equal(even["tip_deflection"], even["heater_current"])


def test_gaps_are_limits_and_become_missing_samples() -> None:
    whole = recording()
    keep = np.ones(2000, dtype=bool)
    keep[700:760] = False
    gappy = Recording(whole.time_s[keep], {k: v[keep] for k, v in whole.channels.items()}, whole.device)
    assert "gap" in [f.kind for f in check_recording(gappy, model(), Limits())]
    filled = regular(gappy)
    assert len(filled) == 2000
    assert np.flatnonzero(np.isnan(filled["film_resistance"])).tolist() == list(range(700, 760))


def test_combs_are_told_from_plain_values() -> None:
    x = np.random.default_rng(2).uniform(0, 50, 5000)
    assert value_step(x) == 0.0
    assert value_step(0.7 * np.round(x / 0.7)) == pytest.approx(0.7)
    assert value_step(np.full(5000, 3.0)) == 0.0


def test_turning_points_are_wiped_out_by_larger_ones() -> None:
    path = np.array([0.0, 10.0, 4.0, 6.0, 5.0, 11.0, 3.0])
    last, before = turning_points(np.interp(np.linspace(0, 6, 601), np.arange(7), path))
    assert last[350] == pytest.approx(6.0) and before[350] == pytest.approx(4.0)
    assert last[-1] == pytest.approx(11.0) and before[-1] == pytest.approx(0.0)


def _up_and_down(size: int) -> np.ndarray:
    return np.concatenate([np.full(20, 25.0), np.linspace(25, 80, size), np.linspace(80, 25, size)])


def test_equal_loops_are_one_loop() -> None:
    slow = _up_and_down(500)
    assert one_loop([slow], [1e-3], Limits())
    assert one_loop([np.tile(slow, 4)], [1e-3], Limits())
    assert one_loop([slow, slow + 0.3], [1e-3, 1e-3], Limits())
    assert one_loop([np.full(600, 25.0)], [1e-3], Limits())


def test_another_rate_or_smaller_loops_are_more_than_one() -> None:
    slow, fast = _up_and_down(500), _up_and_down(100)
    assert not one_loop([slow, fast], [1e-3, 1e-3], Limits())
    assert not one_loop([slow, slow], [1e-3, 1e-4], Limits())
    assert not one_loop([np.concatenate([slow, fast])], [1e-3], Limits())
    fan = [np.linspace(a, b, 100) for turn in (45, 50, 55, 60) for a, b in ((80, turn), (turn, 80))]
    assert not one_loop([np.concatenate([slow, np.linspace(25, 80, 500), *fan])], [1e-3], Limits())


def test_probabilities_order_rivals_and_sum_to_one() -> None:
    p = probabilities(np.array([100.0, 110.0, 400.0]), temper=4.0)
    assert np.sum(p) == pytest.approx(1.0)
    assert p[0] > p[1] > p[2]
    assert p[1] / p[0] == pytest.approx(np.exp(-0.5 * 10.0 / 4.0))


@pytest.mark.parametrize(
    ("weights", "odds", "expected"),
    [
        ([0.5, 0.4, 0.1], [0.0, 0.2], [0.5, 0.4, 0.1]),
        ([0.2, 0.8, 0.0], [0.0, 0.5], [0.4, 0.4, 0.2]),
        ([0.0, 1.0, 0.0], [0.0, 0.5], [0.4, 0.4, 0.2]),
    ],
)
def test_a_rival_is_no_likelier_than_the_answer_and_has_its_odds(weights, odds, expected) -> None:
    np.testing.assert_allclose(beside_the_first(np.array(weights), odds), expected)


@pytest.mark.parametrize("device", ["integrated", "peltier"])
def test_proposed_excitations_stay_within_the_operating_range(device) -> None:
    nominal = preset(device)
    low, high = sorted(nominal.operating_range)
    for excitable in library(device, nominal.sample_period):
        current = excitable.current(nominal.sample_period, nominal.operating_range[0])
        assert low - 1e-9 <= current.min() and current.max() <= high + 1e-9, excitable.name
        assert 2000 < current.size < 12_000, (excitable.name, current.size)


def test_samples_that_stand_alone_are_found_in_noise_and_in_what_an_effect_leaves() -> None:
    rng = np.random.default_rng(8)
    count = 4000
    edges = 10.0 * np.repeat(rng.normal(size=count // 40), 40)  # an effect that goes off and on
    answer = lfilter(
        [1.0], [1.0, -0.55], 20.0 * (np.arange(count) % 50 == 0)
    )  # a lag of two samples, at every step
    ripple = 5.0 * np.sin(2 * np.pi * np.arange(count) / 2.7)
    for left, missing in ((np.zeros(count), 0.05), (edges, 0.05), (answer, 0.0), (ripple, 0.05)):
        residual = left + rng.normal(size=count)
        residual[rng.random(count) < missing] = np.nan
        assert not outliers(residual).any()
        there = np.flatnonzero(np.isfinite(residual))[20:-20:400]
        residual[there] += 200.0 * rng.choice([-1, 1], there.size)
        assert set(np.flatnonzero(outliers(residual))) == set(there)


def test_what_happens_often_or_is_a_converters_step_is_no_outlier() -> None:
    rng = np.random.default_rng(8)
    residual = rng.normal(size=4000)
    often = residual + 60.0 * (rng.random(4000) < 0.05)
    assert not outliers(often).any()
    flips = 7.0 * (np.arange(4000) % 211 == 0) + 0.01 * residual
    assert outliers(flips).any() and not outliers(flips, 7.0).any()
    assert not outliers(np.array([0.0, 100.0, 0.0])).any()
    late = residual + 60.0 * (np.arange(4000) % 211 == 0)
    before = 60.0 * np.isin(np.arange(4000) % 211, [1, 2, 3])
    assert outliers(late).any() and not outliers(late, 0.0, before).any()


def test_outliers_are_found_at_edges_and_beside_each_other_and_late_readings_are_none() -> None:
    rng = np.random.default_rng(9)
    course = np.repeat(rng.uniform(0.0, 400.0, 500), 12)
    residual = rng.normal(size=course.size)
    there = [
        *range(25, 6000, 300),
        1001,
        1002,
        2000,
        2003,
        5040,
    ]  # two together, two near each other, one at an edge
    off = residual.copy()
    off[there] += 150.0 * rng.choice([-1, 1], len(there))
    assert set(np.flatnonzero(outliers(off, 0.0, course))) == set(there)
    # a channel that is read a sample late differs at every edge by as much as the signal goes there
    seldom = np.repeat(rng.uniform(0.0, 400.0, 60), 100)
    late = np.concatenate([[0.0], seldom[:-1]]) - seldom + residual
    assert not outliers(late, 0.0, seldom).any() and outliers(late).any()


def test_outliers_beyond_what_the_signal_was_are_found_however_fast_it_moves() -> None:
    rng = np.random.default_rng(9)
    course = 100.0 * np.sin(np.arange(3000) / 3.0)
    residual = rng.normal(size=course.size)
    there = np.arange(30, 3000, 330)
    residual[there] += np.where(course[there] > 0.0, 120.0, -120.0)
    assert set(np.flatnonzero(outliers(residual, 0.0, course))) == set(there)


@pytest.mark.parametrize("hotter", [1.0, 3.0])
def test_the_basis_of_the_loop_shape_lies_where_the_fitted_loops_are(hotter) -> None:
    """A file that tells no transition: gain and ambient set the scale of the temperature, and the loops lie anywhere on it."""
    device = described(
        {
            "schema": "vo2-device/1",
            "id": "wire",
            "drive": {"channel": "heater_current", "unit": "A", "limits": [0.0, 1.0]},
            "body": {"kind": "first_order", "ambient": 20.0, "square_gain": 100.0 * hotter},
            "responses": {"ohms": {"unit": "ohm", "range": [3.0, 5.0]}, "strain": {"unit": "m"}},
        },
        "wire",
    )
    middle, width = 20.0 + 45.0 * hotter, 9.0 * hotter
    slope = 0.2 / hotter
    rising, falling = (-slope * (middle + side * width / 2) for side in (1, -1))
    law = PlayBank([0.1], [0.0], [slope], [rising], [slope], [falling], [0.0])
    model = DeviceModel(device.key, resistance=law)
    (heating, spread), (wide, _) = transition_of(model)
    assert heating == pytest.approx(middle + width / 2, abs=0.5 * hotter)
    assert wide == pytest.approx(width, rel=0.1)
    basis = basis_of(model)
    low, high = basis.centre_degc
    assert low < middle - 2 * spread and middle + 2 * spread < high
    assert basis.half_width_k > width / 2
    # as many functions as on a shipped device, whatever the scale
    assert basis.columns < 1.5 * basis_of(DeviceModel("integrated")).columns


def test_a_basis_stays_where_the_file_tells_the_transition() -> None:
    assert basis_of(DeviceModel("peltier")).centre_degc == (46.0, 76.0)


def test_a_gap_leaves_another_memory_only_where_the_drive_may_have_turned() -> None:
    levels = np.repeat(np.random.default_rng(1).uniform(0.0, 1.0, 60), 25)
    assert not _turns(levels, 4)
    assert _turns(levels, 80)
    assert _turns(0.5 + 0.5 * np.sin(np.arange(1500.0)), 4)


def test_samples_behind_a_step_at_an_unknown_instant_do_not_count() -> None:
    drive = np.repeat([0.0, 1.0, 0.4], 50)
    drive[[20, 21, 49, 50]] = np.nan  # one gap while it rests, one in which it steps
    torn = _after_torn_steps(drive, 2.0)
    assert np.array_equal(np.flatnonzero(torn), np.arange(49, 64))


@pytest.mark.parametrize(("excess", "own"), [(4.0, True), (6.0, False)])
def test_an_excess_far_beyond_the_calibrations_is_not_the_laws(excess, own) -> None:
    nominal = SimpleNamespace(span={"strain": 1.0})
    located = SimpleNamespace(nominal=nominal, excess={"strain": excess}, left_out=0.1)
    judged = SimpleNamespace(after={"strain": 0.02}, floor={"strain": 0.01})
    assert _is_small(located, judged, Limits()) == own


@pytest.mark.parametrize(("elsewhere", "named"), [(29.0, True), (31.0, False)])
def test_a_name_that_leaves_another_channel_far_off_is_not_given(monkeypatch, elsewhere, named):
    monkeypatch.setattr(decide, "reached", lambda option: set())
    chosen = SimpleNamespace(hypotheses=(), values=(), at_bound=(), gain=1e4)
    option = SimpleNamespace(chosen=chosen, final=None)
    adequacy = Adequacy(("sensor_zero_drift:stage_temperature",), 0.6, 0.0, 1e3, elsewhere=elsewhere)
    assert decide._is_admissible(option, SimpleNamespace(stable=True), adequacy, Limits()) == named


@pytest.mark.parametrize(
    ("deflection", "expected"),
    [(0.5, "film_resistance"), (3.0, "tip_deflection")],  # in which most of the excess is
)
def test_an_excess_is_the_laws_where_its_channel_is_no_further_off_than_in_the_calibration(
    deflection, expected
):
    sensors = {
        "film_resistance": SimpleNamespace(misfit=0.04),
        "tip_deflection": SimpleNamespace(misfit=1.2e-7),
    }
    body = SimpleNamespace(description=SimpleNamespace(has_body=True), sensors=sensors)
    located = SimpleNamespace(
        excess={"film_resistance": 1.5, "tip_deflection": deflection},
        problem=SimpleNamespace(count_by_channel={"film_resistance": 1e3, "tip_deflection": 1e3}),
        nominal=SimpleNamespace(model=body),
    )
    judged = SimpleNamespace(after={"film_resistance": 0.039, "tip_deflection": 1.1e-7})
    assert decide._as_calibrated(located, judged) == expected
    judged.after[expected] *= 1.2
    assert decide._as_calibrated(located, judged) == ""
    body.description.has_body = False
    assert decide._as_calibrated(located, SimpleNamespace(after={"film_resistance": 0.0})) == ""


def test_where_held_out_blocks_refute_the_best_effect_the_next_are_asked(monkeypatch):
    def single(key, gain, *at_bound):
        return SimpleNamespace(keys=(key,), gain=gain, at_bound=at_bound)

    singles = (single("a", 10.0), single("b", 9.0, "b.share"), single("c", 8.0), single("d", 2.0))
    monkeypatch.setattr(decide, "option_of", lambda nominal, problem, one, *rest, tick: one)
    located = SimpleNamespace(nominal=None, problem=None)
    found = SimpleNamespace(options=("best",), singles=singles)
    clock = Clock(lambda share, text: None, 1)
    # nothing refuted: the options alone
    assert list(decide._asked(located, found, set(), Limits(), clock)) == ["best"]
    # the best refuted: not itself, none at a bound, none that explains far less
    assert list(decide._asked(located, found, {"a"}, Limits(), clock)) == ["best", singles[2]]


def test_two_that_are_late_for_one_reason_are_one(monkeypatch):
    """Two effects of one sensor's time, and the same lag of every response; not lags that differ, nor a gain beside a lag."""

    def one(key, chi_square):
        name, _, signal = key.partition(":")
        record = SimpleNamespace(
            id=name, between_samples=name in {"sensor_lag", "averaging"}, parameters=(time,)
        )
        return SimpleNamespace(
            keys=(key,), hypotheses=(SimpleNamespace(signal=signal, record=record),), chi_square=chi_square, gain=9.0, at_bound=()
        )  # fmt: skip

    def reason(first, second, *values):
        pair = SimpleNamespace(
            hypotheses=(first.hypotheses[0], second.hypotheses[0]),
            values=[{time.name: value} for value in values],
        )
        clock = Clock(lambda share, text: None, 1)
        return search._late_for_one_reason(located, SimpleNamespace(chosen=pair), singles, Limits(), clock)

    monkeypatch.setattr(
        search, "option_of", lambda nominal, problem, single, *rest, tick: SimpleNamespace(chosen=single)
    )
    monkeypatch.setattr(search, "cost", lambda explanation, *rest: explanation.chi_square)
    time = SimpleNamespace(name="time")
    roles = [SimpleNamespace(role=r) for r in ("film_resistance", "tip_deflection")]
    nominal = SimpleNamespace(model=SimpleNamespace(description=SimpleNamespace(responses=roles)))
    located = SimpleNamespace(nominal=nominal, problem=None)
    lag, mean, tip, gain, kinetics = singles = [
        one("sensor_lag:film_resistance", 5.0), one("averaging:film_resistance", 4.0), one("sensor_lag:tip_deflection", 3.0),
        one("sensor_gain_drift:film_resistance", 1.0), one("transition_kinetics", 6.0),
    ]  # fmt: skip
    assert reason(lag, mean, 0.1, 0.7).chosen is mean
    assert reason(lag, tip, 0.1, 0.12).chosen is kinetics
    assert reason(lag, tip, 0.1, 0.2) is None
    assert reason(lag, gain, 0.1, 0.1) is None


def test_whatever_a_correction_without_a_name_depends_on_has_an_experiment():
    groups = {group for families in (*BY_DEPENDENCE.values(), OF_ONE_LOOP) for group in families}
    assert groups == set(TO_SEE)
    for group in groups:
        found = without_explanation([Shape("tip_deflection", group, "what it follows", 0.5, 3.0)], [])
        assert found.kind == "manual" and TO_SEE[group] in found.instruction
    assert "follows nothing that was tried" in without_explanation([], []).why


def test_nothing_is_linearised_about_a_dead_time_below_nothing() -> None:
    constants = [
        Constant("driver.dead_time", "s", 1e-3, 5e-4),
        Constant("thermal.ambient", "degC", 22.0, 1.0, drifts=True),
        Constant("driver.dead_time", "s", 1e-3, 1e-5, drifts=True),
    ]
    assert _possible(constants, np.array([1.0, -3.0, -2.0])) == pytest.approx([1.0, -3.0, -2.0])
    found = _possible(constants, np.array([-3.0, -3.0, -20.0]))
    assert found[1] == -3.0 and np.all(found[[0, 2]] < 0.0)
    assert 1e-3 + 5e-4 * found[0] + 1e-5 * found[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("courses", "told"),
    [({}, "corrections of the loops that no law holds"), ({"ambient_drift": None}, "no more than its straight part")],
)  # fmt: skip
def test_why_a_corrected_model_leaves_more_than_the_answer(courses, told) -> None:
    device = preset("integrated")
    of_device = SimpleNamespace(model=SimpleNamespace(description=device))
    study = SimpleNamespace(
        located=SimpleNamespace(problem=SimpleNamespace(nominal=of_device)),
        decision=SimpleNamespace(chosen=SimpleNamespace(courses=courses)),
        limits=Limits(),
    )
    corrected = SimpleNamespace(nrmse={TIP_DEFLECTION: 0.04})
    answer = SimpleNamespace(fit={TIP_DEFLECTION: SimpleNamespace(nrmse_after=0.004, noise_floor=0.001)})
    (said,) = _farther_off(corrected, answer, study)
    assert said.startswith("corrected_model.yaml by itself leaves 4 % of the range") and told in said
