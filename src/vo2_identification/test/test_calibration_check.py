"""What `fit` refuses to make a model of, and what it says beside a model."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from vo2_models.device.description import described, preset
from vo2_models.device.model import DeviceModel, SensorModel
from vo2_models.identification.calibration_check import bare_stretches, check_calibration, judge_fit
from vo2_models.identification.device_fit import FitResult
from vo2_models.identification.model_fit import fit_model
from vo2_models.identification.plausibility import impossible, unusual
from vo2_models.recording import (
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

COUNT = 1200


@pytest.fixture
def recording():
    """A rig's numbers, by a formula of their own: two turns up and down, resistance and tip along them."""
    phase = np.linspace(0.0, 4 * np.pi, COUNT)
    heat = 0.5 * (1 - np.cos(phase))
    noise = np.random.default_rng(0).standard_normal((2, COUNT))
    channels = {
        HEATER_CURRENT: 8.4e-3 * heat,
        RESISTANCE: 10 ** (5.3 - 1.2 * heat) * (1 + 0.002 * noise[0]),
        TIP_DEFLECTION: 57e-6 * heat + 5e-8 * noise[1],
    }
    return Recording(1e-3 * np.arange(COUNT), channels, "integrated")


def with_channel(recording, **changed):
    return replace(recording, channels={**recording.channels, **changed})


def test_a_good_recording_passes_unchanged_and_without_a_word(recording):
    checked, notes = check_calibration([recording], "integrated")
    assert notes == []
    assert checked[0].channels.keys() == recording.channels.keys()
    for name, values in recording.channels.items():
        np.testing.assert_array_equal(checked[0][name], values)


@pytest.mark.parametrize(
    ("channel", "change", "said"),
    [
        (
            HEATER_CURRENT,
            lambda x: 1e3 * x,
            r"heater_current runs from 0 to 8\.4 A.*off by a factor of 1 000, ",
        ),
        (HEATER_CURRENT, lambda x: -x, r"heater_current runs from -0\.0084.*is its sign reversed\?"),
        (HEATER_CURRENT, lambda x: 2 * x, r"allows 0 to 0\.01278 A: check the unit$"),
        (TIP_DEFLECTION, lambda x: 1e6 * x, "off by a factor of 1 000 000, in the values or in the map"),
        (TIP_DEFLECTION, lambda x: 1e3 * x, "off by a factor of 1 000, in the values or in the map"),
        (HEATER_CURRENT, lambda x: 1e-3 * x, r"varies by 8\.4e-06 A .*off by a factor of 1 000, "),
        (RESISTANCE, lambda x: -x, r"film_resistance is not above zero"),
    ],
)
def test_what_the_device_cannot_have_is_refused(recording, channel, change, said):
    wrong = with_channel(recording, **{channel: change(recording[channel])})
    with pytest.raises(ValueError, match=rf"^sweep: .*{said}"):
        check_calibration([wrong], "integrated", names=["sweep"])


PIEZO = {
    "schema": "vo2-device/1",
    "id": "piezo",
    "drive": {"channel": "volts", "unit": "V", "limits": [0.0, 3.6]},
    "responses": {"stroke": {"unit": "m"}},
}


@pytest.mark.parametrize(
    ("drive", "stroke", "said"),
    [
        (lambda v, s: s, lambda v, s: 1e-6 * v, "the column: are those of volts and stroke swapped?"),
        (lambda v, s: s, lambda v, s: 1e-6 * s, "stroke is a copy of volts, times 1e-06"),
        (lambda v, s: -v, lambda v, s: 1e-6 * s, "the unit (is its sign reversed?)"),
        (
            lambda v, s: 1e3 * v,
            lambda v, s: 1e-6 * s,
            "the unit (off by a factor of 1 000, in the values or in the map?)",
        ),
        (lambda v, s: 2 * v, lambda v, s: 1e-6 * v**2, "check the unit"),
    ],
)
@pytest.mark.parametrize("extent", [None, [-1.3e-4, -7e-5]])
def test_a_wrong_column_is_told_from_a_wrong_unit(drive, stroke, said, extent):
    phase = np.linspace(0.0, 4 * np.pi, COUNT)
    volts, micrometres = 1.8 - 1.8 * np.cos(phase), -98.0 - 25.0 * np.cos(phase - 0.3)
    response = {"unit": "m"} | ({"range": extent} if extent else {})
    device = described({**PIEZO, "responses": {"stroke": response}}, "test")
    channels = {HEATER_CURRENT: drive(volts, micrometres), TIP_DEFLECTION: stroke(volts, micrometres)}
    (told,) = impossible(Recording(1e-3 * np.arange(COUNT), channels), device.key)
    assert told.endswith(said) or ("copy" in said and told.startswith(said))


def test_kelvin_in_place_of_degrees_is_refused(recording):
    wrong = with_channel(recording, **{STAGE_TEMPERATURE: np.linspace(300.0, 360.0, COUNT)})
    assert "is it in K?" in impossible(wrong, "peltier")[0]
    right = with_channel(recording, **{STAGE_TEMPERATURE: np.linspace(27.0, 87.0, COUNT)})
    assert impossible(right, "peltier") == []


def test_a_clock_and_a_length_that_cannot_be_are_refused(recording):
    with pytest.raises(ValueError, match=r"a sample every 1e-06 s, need at least 2\.5e-05 s"):
        check_calibration([replace(recording, time_s=recording.time_s / 1000)], "integrated")
    with pytest.raises(ValueError, match="recording 2: found 19 samples, need at least 20"):
        check_calibration([recording, recording.slice(0, 19)], "integrated")
    with pytest.raises(ValueError, match="recordings: found 149 samples, need at least 150"):
        check_calibration([recording.slice(0, 100), recording.slice(0, 49)], "integrated")


def test_few_samples_are_counted_over_all_recordings_and_need_both_branches(recording):
    assert check_calibration([recording.slice(0, 300), recording.slice(300, 599)], "integrated")[1] == []
    (note,) = check_calibration([recording.slice(0, 499)], "integrated")[1]
    assert note.startswith("recording 1: 499 samples are few")
    with pytest.raises(
        ValueError, match=r"recording 1: found 290 samples and .*only goes one way.*need at least 500"
    ):
        check_calibration([recording.slice(0, 290)], "integrated")


def lossy(recording, kept):
    return Recording(
        recording.time_s[kept], {k: v[kept] for k, v in recording.channels.items()}, "integrated"
    )


def test_a_recording_of_gaps_or_on_no_clock_is_refused_unless_one_insists(recording):
    rng = np.random.default_rng(4)
    some = lossy(recording, rng.uniform(size=COUNT) < 0.7)
    with pytest.raises(ValueError, match=r"^sweep: gaps make up 5\d % of the recording, need at most 30 %"):
        check_calibration([some], "integrated", names=["sweep"])
    (note,) = check_calibration([some], "integrated", gap_limit=0.6)[1]
    assert re.search(r"recording 1: \d+ gaps are 5\d\.\d % of the time", note)
    steps = rng.choice([0.6e-3, 1e-3, 1.4e-3], COUNT, p=[0.45, 0.1, 0.45])
    restless = replace(recording, time_s=np.cumsum(steps))
    with pytest.raises(ValueError, match="the clock is not that of a regular acquisition"):
        check_calibration([restless], "integrated")
    check_calibration([restless], "integrated", gap_limit=0.3)


def test_samples_far_longer_apart_than_the_device_takes_are_told(recording):
    _, (note,) = check_calibration([replace(recording, time_s=recording.time_s * 1000)], "integrated")
    assert re.search(r"^recording 1: the samples are 1 s apart, .* check the time column and its unit", note)


def test_what_may_be_is_doubted(recording):
    kilo = with_channel(recording, **{RESISTANCE: recording[RESISTANCE] / 1000})
    (note,) = check_calibration([kilo], "integrated", names=["sweep"])[1]
    assert note.startswith("sweep: film_resistance runs from 12") and "is it in kohm?" in note
    few = recording[RESISTANCE] * np.where(np.arange(COUNT) % 100 == 7, -1.0, 1.0)
    (note,) = unusual(with_channel(recording, **{RESISTANCE: few}), "integrated")
    assert note == "film_resistance is not above zero in 12 samples, which count as missing"


def test_an_empty_channel_is_left_out_and_a_thin_one_named(recording):
    nothing = np.full(COUNT, np.nan)
    (one,), notes = check_calibration([with_channel(recording, **{RESISTANCE: nothing})], "integrated")
    assert RESISTANCE not in one and TIP_DEFLECTION in one
    assert notes == ["recording 1: film_resistance has no value at all and is left out"]
    thin = np.where(np.arange(COUNT) % 4, np.nan, recording[TIP_DEFLECTION])
    (note,) = check_calibration([with_channel(recording, **{TIP_DEFLECTION: thin})], "integrated")[1]
    assert note == "recording 1: tip_deflection has no value in 75 % of the samples"


def test_gaps_and_a_missing_branch_are_said(recording):
    keep = np.r_[0:400, 600:COUNT]
    holed = Recording(
        recording.time_s[keep], {k: v[keep] for k, v in recording.channels.items()}, recording.device
    )
    (note,) = check_calibration([holed], "integrated")[1]
    assert "1 gaps are 16.8 % of the time" in note
    up = recording.slice(600, 1190)
    rising = with_channel(up, **{HEATER_CURRENT: np.linspace(0, 8e-3, len(up))})
    (note,) = check_calibration([rising], "integrated")[1]
    assert note.startswith("the current only goes one way: the cooling branch is a guess")
    falling = with_channel(up, **{HEATER_CURRENT: np.linspace(8e-3, 0, len(up))})
    assert check_calibration([rising, falling], "integrated")[1] == []
    # the peltier device heats with a negative current
    rising = with_channel(up, **{HEATER_CURRENT: np.linspace(0, 0.5, len(up))})
    assert "the heating branch is a guess" in check_calibration([rising], "peltier")[1][-1]


def fitted(recording, **residuals):
    """The fit whose residuals [log10 ohm, m] are those given, at the preset's noise."""
    noise = {RESISTANCE: 2e-3, TIP_DEFLECTION: 5e-8}
    sensors = {
        channel: SensorModel(noise=noise[channel], colour=(), residual=size, residual_colour=())
        for channel, size in residuals.items()
    }
    return FitResult(
        model=replace(DeviceModel("integrated"), sensors=sensors),
        path=np.zeros(len(recording)),
        ends=(len(recording),),
        residuals={},
        settled=False,
        notes=(),
    )


def test_noise_far_above_what_a_shipped_device_declares_is_told(recording):
    result = fitted(recording, tip_deflection=2e-6)
    sensors = {TIP_DEFLECTION: replace(result.model.sensors[TIP_DEFLECTION], noise=1.9e-6)}
    loud = replace(result, model=replace(result.model, sensors=sensors))
    (note,) = judge_fit(loud, [recording])
    assert note.startswith("tip_deflection: its noise was found to be 38 times what device integrated has")


def test_stretches_of_the_operating_range_without_samples_are_told(recording):
    low, high = sorted(
        preset("integrated").steady_temperature(i) for i in preset("integrated").operating_range
    )
    half = 0.5 * (low + high)
    whole = replace(fitted(recording), path=np.linspace(low - 1.0, high + 1.0, COUNT))
    assert bare_stretches(whole) == []
    (note,) = bare_stretches(replace(whole, path=np.linspace(low - 1.0, half, COUNT)))
    assert (
        re.match(rf"hardly a sample at {half + 1:.0f} to {high:.0f} degC", note)
        or f"to {high:.0f} degC, of" in note
    )


def test_a_fit_is_judged_by_what_it_leaves(recording):
    good = fitted(recording, film_resistance=1.5e-3, tip_deflection=8e-8)
    assert judge_fit(good, [recording]) == []
    (note,) = judge_fit(fitted(recording, film_resistance=1.5e-3, tip_deflection=6.5e-6), [recording])
    assert note.startswith("tip_deflection is fitted poorly: 6.5 um r.m.s. are left of a span of 57")
    with pytest.raises(
        ValueError, match=r"film_resistance does not follow heater_current in a loop.* 0 % of its"
    ):
        judge_fit(fitted(recording, film_resistance=0.5, tip_deflection=8e-8), [recording])


@pytest.mark.parametrize(("declared", "said"), [(4e-4, True), (1.5e-3, False)])
def test_a_noise_far_above_the_device_file_is_told(recording, declared, said):
    entries = json.loads(preset("integrated").document)
    entries["id"], entries["responses"]["film_resistance"]["noise"] = "mine", declared
    found = fitted(recording, film_resistance=1.5e-3)
    own = replace(found, model=replace(found.model, device=json.dumps(entries)))
    notes = judge_fit(own, [recording])
    assert ["5 times what the device file says" in note for note in notes] == [True] * said
    assert judge_fit(found, [recording]) == []  # a preset's noise is no statement about this rig


@pytest.mark.parametrize(("side", "words"), [(1.0, "while heating"), (-1.0, "while cooling")])
def test_a_poor_fit_is_told_with_the_branch_and_the_rate_where_it_is(recording, side, words):
    rng = np.random.default_rng(6)
    # up and down, slowly and then quickly
    path = 50.0 - 30.0 * np.cos(np.concatenate([np.linspace(0, 2, 800), np.linspace(2, 6, 400)]) * np.pi)
    rate = np.gradient(path)
    worst = (np.sign(rate) == side) & (np.abs(rate) > np.median(np.abs(rate)))
    left = np.where(worst, 1e-5, 1e-6) * rng.standard_normal(COUNT)
    result = replace(fitted(recording, tip_deflection=6.5e-6), path=path, residuals={TIP_DEFLECTION: left})
    (note,) = judge_fit(result, [recording])
    assert f", most of it {words} and at the higher rates; look for" in note


@pytest.mark.parametrize(("ends", "way"), [([-5.0, 5.0], "rises"), ([5.0, -5.0], "falls")])
def test_a_fit_without_a_heated_body_is_judged_in_words_and_units_of_its_file(recording, ends, way):
    device = {
        "schema": "vo2-device/1",
        "id": "film",
        "drive": {"channel": "field", "unit": "V", "limits": [-5.0, 5.0], "operating": ends},
        "responses": {"capacitance": {"unit": "F", "scale": "log10", "noise": 1e-3}},
    }
    path = 50.0 - 30.0 * np.cos(np.linspace(0.0, 6.0, COUNT) * np.pi)
    left = np.where(np.gradient(path) > 0.0, 1e-2, 1e-3) * np.random.default_rng(6).standard_normal(COUNT)
    found = fitted(recording, film_resistance=0.05)
    model = replace(found.model, device=described(device, "film").document)
    result = replace(found, model=model, path=path, residuals={RESISTANCE: left})
    notes = judge_fit(result, [recording])
    assert any("0.05 log10 F r.m.s." in note and f"most of it while field {way}" in note for note in notes)


def test_a_channel_of_one_value_is_left_out_and_told(recording):
    stuck = with_channel(recording, tip_deflection=np.full(COUNT, 1e-5))
    (kept,), notes = check_calibration([stuck], "integrated")
    assert TIP_DEFLECTION not in kept and RESISTANCE in kept
    assert any("tip_deflection is 1e-05 in every sample and is left out" in note for note in notes)
    (kept, _), notes = check_calibration([stuck, recording], "integrated")
    assert TIP_DEFLECTION in kept and not any("in every sample" in note for note in notes)


def test_noise_is_not_made_a_model_of(recording):
    noise = np.random.default_rng(3).standard_normal((2, COUNT))
    nothing = {RESISTANCE: 1e5 * np.exp(0.3 * noise[0]), TIP_DEFLECTION: 3e-5 + 1e-5 * noise[1]}
    with pytest.raises(ValueError, match="does not follow heater_current in a loop"):
        fit_model([with_channel(recording, **nothing)], "integrated", plays=2)
