"""Sensors: what values show by themselves, and what a program makes of them sample by sample."""

from dataclasses import replace

import numpy as np
import pytest
from concealed_devices import DEVICE, calibrated, calibration, concealed, measured
from vo2_models.diagnosis import diagnose, study
from vo2_models.diagnosis.adequacy import ends_flat
from vo2_models.diagnosis.files import write_results
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.report import assemble_diagnosis, excess_by_channel
from vo2_models.effects import effect
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

STEP = 2e-6
"""Coarse for a noise of 0.1 um [m]."""
COARSE = {"adc_quantization": {"signal": TIP_DEFLECTION, "step": STEP}}
CREEP = {"creep": {"share": 0.05, "time_constant": 0.2}}


@pytest.fixture(scope="module")
def parameters():
    return calibrated()


@pytest.fixture(scope="module")
def coarse_model():
    return fit_model([measured(calibration(effects=COARSE))], DEVICE, plays=12, self_sensing=False)[1]


def with_tip(recording: Recording, change) -> Recording:
    channels = {**recording.channels, TIP_DEFLECTION: change(recording[TIP_DEFLECTION])}
    return Recording(recording.time_s, channels, recording.device)


def coarse(values: np.ndarray) -> np.ndarray:
    return STEP * np.rint(values / STEP)


def named(answer) -> list[tuple[str, str | None]]:
    return [(e.id, e.signal) for e in answer.effects]


@pytest.mark.slow
def test_a_converter_that_clips_is_read_off_its_values(parameters, tmp_path) -> None:
    whole = concealed()
    high = float(np.quantile(whole[TIP_DEFLECTION], 0.8))
    clipped = with_tip(whole, lambda tip: np.minimum(tip, high))
    seen = study([clipped], parameters)
    answer = write_results(seen, tmp_path)
    assert answer.verdict == "differs"
    assert named(answer) == [("adc_saturation", TIP_DEFLECTION)]
    assert answer.effects[0].parameters["high"].value == high
    assert "high" in answer.summary and "With that simulation and recording agree" in answer.summary
    (place,) = answer.location
    assert place.signal == TIP_DEFLECTION and place.share == pytest.approx(1.0)
    inside = [any(a <= t < b for a, b in place.time_s) for t in clipped.time_s]
    assert np.array_equal(inside, clipped[TIP_DEFLECTION] == high)
    # the corrected model is the model with the converter, and follows the recording where the model does not
    corrected = Nominal.load(tmp_path / "corrected_model.yaml")
    flat = clipped[TIP_DEFLECTION] == high
    current, period = clipped[HEATER_CURRENT], clipped.sample_period_s
    error = [
        np.std((model.respond(current, period).channels[TIP_DEFLECTION] - high)[flat])
        for model in (Nominal.from_parameters(parameters), corrected)
    ]
    assert error[1] < 0.1 * error[0]
    assert not any("scatter" in text for text in answer.limits)


@pytest.mark.slow
def test_what_the_steps_of_a_converter_do_is_in_the_figures_of_the_fit(parameters) -> None:
    seen = study([with_tip(concealed(), coarse)], parameters)
    answer = assemble_diagnosis(seen)
    assert named(answer) == [("adc_quantization", TIP_DEFLECTION)]
    assert answer.summary.count("With that simulation and recording agree") == 1
    fit, span = answer.fit[TIP_DEFLECTION], seen.located.nominal.span[TIP_DEFLECTION]
    assert fit.nrmse_after < seen.decision.judged.after[TIP_DEFLECTION] / span
    assert f"with it {100 * fit.nrmse_after:.3g} %" in answer.summary
    # noise of a few hundredths of a step moves as many of the values by a whole step
    assert 3.0 * seen.decision.judged.floor[TIP_DEFLECTION] / span < fit.noise_floor < 1.05 * fit.nrmse_after
    assert [b.channel for b in excess_by_channel(seen)] == [place.signal for place in answer.location]


@pytest.mark.slow
def test_an_end_at_which_the_values_scatter_may_be_a_stop(parameters) -> None:
    whole = concealed()
    high = float(np.quantile(whole[TIP_DEFLECTION], 0.8))
    noise = 6e-8 * np.random.default_rng(8).normal(size=len(whole))
    answer = diagnose([with_tip(whole, lambda tip: np.where(tip > high, high + noise, tip))], parameters)
    assert named(answer) == [("adc_saturation", TIP_DEFLECTION)]
    assert any("scatter" in text and "a stop" in text for text in answer.limits)


@pytest.mark.slow
def test_a_channel_that_is_beyond_its_range_most_of_the_time_is_judged_by_the_rest(parameters) -> None:
    whole = concealed(CREEP)
    high = float(np.quantile(whole[TIP_DEFLECTION], 0.4))
    answer = diagnose([with_tip(whole, lambda tip: np.minimum(tip, high))], parameters)
    assert named(answer) == [("adc_saturation", TIP_DEFLECTION), ("creep", None)]
    assert any("sits at its end value in 60" in text for text in answer.limits)
    few = with_tip(whole, lambda tip: np.where(np.arange(tip.size) % 100 == 50, tip, np.max(tip)))
    assert any("sits at its end value in 99 %" in text for text in diagnose([few], parameters).limits)


@pytest.mark.slow
def test_an_effect_beside_a_coarse_converter_is_named_too(parameters) -> None:
    answer = diagnose([with_tip(concealed(CREEP), coarse)], parameters)
    assert named(answer) == [("adc_quantization", TIP_DEFLECTION), ("creep", None)]
    assert answer.effects[0].parameters["step"].value == pytest.approx(STEP, rel=1e-6)
    assert answer.effects[1].parameters["share"].value == pytest.approx(0.05, rel=0.2)


@pytest.mark.slow
def test_a_converter_that_the_calibration_had_too_is_its_noise(coarse_model) -> None:
    answer = diagnose([concealed(COARSE)], coarse_model)
    assert answer.verdict == "agrees"


@pytest.mark.slow
def test_a_converter_that_was_coarse_all_along_is_told_where_that_is_asked(coarse_model) -> None:
    answer = diagnose([concealed(COARSE)], coarse_model, calibration=[measured(calibration(effects=COARSE))])
    assert named(answer) == [("adc_quantization", TIP_DEFLECTION)]


@pytest.mark.slow
def test_an_analogue_limit_before_the_noise_is_found_by_the_fit(parameters) -> None:
    whole = concealed()
    high = float(np.quantile(whole[TIP_DEFLECTION], 0.8))
    noise = 1e-7 * np.random.default_rng(5).standard_normal(whole.time_s.size)
    found = study([with_tip(whole, lambda tip: np.minimum(tip, high) + noise)], parameters)
    answer = assemble_diagnosis(found)
    assert named(answer)[0] == ("adc_saturation", TIP_DEFLECTION)
    assert answer.effects[0].parameters["high"].value == pytest.approx(high, abs=2e-7)
    # where the values go on beyond it, the law misses the end of its range
    option = found.search.options[0]
    (part,) = option.final.parts
    going_on = part.observed[TIP_DEFLECTION] + 0.5 * np.maximum(whole[TIP_DEFLECTION] - high, 0.0)
    bent = replace(part, observed={**part.observed, TIP_DEFLECTION: going_on})
    assert ends_flat(option, found.limits)
    assert not ends_flat(replace(option, final=replace(option.final, parts=(bent,))), found.limits)


def test_rest_and_few_repeats_are_no_limit() -> None:
    read = effect("adc_saturation").hooks["evident"]
    rng = np.random.default_rng(3)
    wave = np.sin(np.linspace(0.0, 60.0, 5000)) + 0.01 * rng.standard_normal(5000)
    assert read(wave) is None
    values, flat = read(np.clip(wave, -0.9, 0.8))
    assert values == {"low": -0.9, "high": 0.8}
    assert np.array_equal(flat, (wave <= -0.9) | (wave >= 0.8))
    resting = np.where(np.arange(5000) < 2000, 0.0, 1.0 + np.sin(np.linspace(0.0, 60.0, 5000)))
    assert read(np.round(resting, 2)) is None  # without noise a value at rest repeats like a limit
    assert read(np.full(5000, 2.0)) is None


@pytest.mark.slow
def test_outliers_and_jitter_hide_no_converter(parameters) -> None:
    coarse_one = with_tip(concealed(), coarse)
    rng = np.random.default_rng(8)
    off = rng.random(coarse_one.time_s.size) < 0.004
    spoilt = with_tip(coarse_one, lambda tip: np.where(off, tip + 5e-6 * rng.standard_normal(tip.size), tip))
    assert named(diagnose([spoilt], parameters)) == [("adc_quantization", TIP_DEFLECTION)]
    # a log that only repeats the command is no reading between its stamps: it would differ by 100 000 noise powers there
    moved = coarse_one.time_s + 2e-4 * rng.uniform(-1.0, 1.0, coarse_one.time_s.size)
    command = np.concatenate([coarse_one[HEATER_CURRENT][1:], coarse_one[HEATER_CURRENT][-1:]])
    channels = {**coarse_one.channels, COMMANDED_CURRENT: command}
    answer = diagnose([Recording(moved, channels, DEVICE)], parameters)
    assert ("adc_quantization", TIP_DEFLECTION) in named(answer)
    assert HEATER_CURRENT not in answer.excess


def test_limits_are_seen_past_outliers() -> None:
    read = effect("adc_saturation").hooks["evident"]
    rng = np.random.default_rng(4)
    wave = np.minimum(np.sin(np.linspace(0.0, 60.0, 5000)) + 0.01 * rng.standard_normal(5000), 0.8)
    off = rng.random(5000) < 0.01
    values, flat = read(np.where(off, wave + 3.0, wave))
    assert values == {"high": 0.8}
    assert np.array_equal(flat, (wave == 0.8) & ~off)


@pytest.mark.slow
def test_a_comb_finer_than_the_noise_is_nothing(parameters) -> None:
    fine = with_tip(concealed(), lambda tip: 5e-8 * np.rint(tip / 5e-8))
    assert diagnose([fine], parameters).verdict == "agrees"


@pytest.mark.slow
def test_the_first_recording_that_shows_it_counts(parameters) -> None:
    plain, clipped = concealed(), concealed(seed=5)
    high = float(np.quantile(clipped[RESISTANCE], 0.9))
    channels = {**clipped.channels, RESISTANCE: np.minimum(clipped[RESISTANCE], high)}
    both = [plain, Recording(clipped.time_s, channels, DEVICE)]
    answer = diagnose(both, parameters)
    assert named(answer) == [("adc_saturation", RESISTANCE)]
    assert answer.effects[0].parameters["high"].value == high


def moving_mean(values: np.ndarray, samples: int) -> np.ndarray:
    before = np.concatenate([np.full(samples - 1, values[0]), values])
    return np.convolve(before, np.ones(samples) / samples, "valid")


@pytest.mark.slow
def test_a_mean_of_three_samples_is_no_resonance(parameters) -> None:
    """A program's mean, not an integrating converter's: half a sample apart, which is hundreds of noise powers here."""
    answer = diagnose([with_tip(concealed(), lambda tip: moving_mean(tip, 3))], parameters)
    assert named(answer) == [("averaging", TIP_DEFLECTION)]
    found = answer.effects[0].parameters
    assert found["sampled"].value == 1.0
    assert found["window"].value == pytest.approx(3e-3, rel=0.02)


@pytest.mark.slow
def test_a_channel_that_is_late_by_many_samples_is_told_as_that(parameters) -> None:
    """The corrections of the loops' shape come late with the channel: else a second effect would stand for them."""
    answer = diagnose([with_tip(concealed(), lambda tip: np.roll(tip, 12))], parameters)
    assert named(answer) == [("clock_offset", TIP_DEFLECTION)]
    assert answer.effects[0].parameters["delay"].value == pytest.approx(12e-3, rel=0.01)


@pytest.mark.slow
def test_a_dead_time_of_many_samples_has_no_rival(parameters) -> None:
    late = concealed()
    current = np.concatenate([late[HEATER_CURRENT][5:], np.full(5, late[HEATER_CURRENT][-1])])
    answer = diagnose(
        [Recording(late.time_s, {**late.channels, HEATER_CURRENT: current}, DEVICE)], parameters
    )
    assert named(answer) == [("dead_time", None)]
    assert answer.effects[0].probability > 0.9
    assert answer.effects[0].parameters["delay"].value == pytest.approx(5e-3, rel=0.01)


@pytest.mark.slow
def test_what_two_effects_do_equally_well_is_told_as_a_set(parameters) -> None:
    """Straight lines between the samples, read 0.4 samples later, are a mean of two samples: both, and neither by name."""
    late = with_tip(concealed(), lambda tip: 0.6 * tip + 0.4 * np.roll(tip, 1))
    (effect,) = diagnose([late], parameters).effects
    assert effect.id == "unknown" and effect.parameters == {}
    assert set(effect.siblings) == {"averaging", "clock_offset"}
    assert effect.family in (f"sensor:{TIP_DEFLECTION}", f"clock:{TIP_DEFLECTION}")
    assert effect.probability > 0.9
