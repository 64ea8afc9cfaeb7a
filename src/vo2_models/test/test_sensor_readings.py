"""What is of a sensor and not of the device: something periodic, which is named and taken out, and readings of nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest
from own_devices import STACK
from vo2_models.effects import effect
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

import vo2_models as vo2

PERIOD, SAMPLES = 0.01, 3000
TIME = PERIOD * np.arange(SAMPLES)
DRIVE = np.cumsum(np.random.default_rng(8).choice([-1.0, 0.0, 1.0], SAMPLES // 100).repeat(100)) / 100.0
line = effect("sensor_interference").hooks["line"]


def noisy(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(SAMPLES)


def swing(amplitude: float, frequency: float, phase: float = 0.7) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * frequency * TIME + phase)


@pytest.mark.parametrize("frequency", [7.31, 23.4, 44.9])
@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_a_line_is_found_with_its_amplitude_frequency_and_phase(frequency, lost):
    off = []
    for seed in range(12):
        left = noisy(seed) + swing(0.8, frequency) + 2.0 * np.sin(TIME / 5.0)
        left[np.random.default_rng(seed).random(SAMPLES) < lost] = np.nan
        values, deviations = line(left, np.ones(SAMPLES), DRIVE, PERIOD)
        truth = {"amplitude": 0.8, "frequency": frequency, "phase_angle": 0.7}
        off += [(values[name] - truth[name]) / deviations[name] for name in truth]
    assert np.max(np.abs(off)) < 4.0
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_what_goes_with_the_drive_are_no_line(seed):
    assert line(noisy(seed), np.ones(SAMPLES), DRIVE, PERIOD) is None
    # a law that misses the drive's own swing, at its frequency and at multiples of it
    swings = np.sin(2.0 * np.pi * 1.7 * TIME)
    missed = 0.3 * swings + 0.5 * swings**2 + 0.4 * np.sign(swings) + 0.1 * noisy(seed)
    assert line(missed, np.ones(SAMPLES), swings, PERIOD) is None
    # a phase that does not go on
    turned = np.where(TIME[-1] / 2.0 > TIME, 1.0, -1.0) * swing(2.0, 17.0) + noisy(seed)
    assert line(turned, np.ones(SAMPLES), DRIVE, PERIOD) is None


@pytest.fixture(scope="module")
def model():
    levels = 3.68e-3 + 4.81e-3 * np.repeat(vo2.damped_oscillation(np.linspace(0, 1, 13)), 30)
    return levels, vo2.fit(vo2.simulate("integrated", levels, seed=1), "integrated")


def with_mains(levels: np.ndarray, added: dict[str, float], seed: int = 2) -> Recording:
    plain = vo2.simulate("integrated", levels, seed=seed)
    hum = np.sin(2.0 * np.pi * 50.0 * (plain.time_s - plain.time_s[0]) + 0.5 * seed)
    return replace(
        plain, channels={**plain.channels, **{c: plain[c] + size * hum for c, size in added.items()}}
    )


@pytest.mark.filterwarnings("ignore:no step of the drive")
def test_the_mains_on_one_sensor_are_named_measured_and_taken_out(model):
    levels, fitted = model
    for channel, size in ((TIP_DEFLECTION, 0.3e-6), (RESISTANCE, 800.0)):
        found = vo2.diagnose([with_mains(levels, {channel: size})], fitted)
        (named,) = found.effects
        assert (found.verdict, named.id, named.signal) == ("differs", "sensor_interference", channel)
        assert named.family == f"sensor:{channel}"
        amplitude, frequency = named.parameters["amplitude"], named.parameters["frequency"]
        assert abs(amplitude.value - size) < 4.0 * amplitude.std < 0.1 * size
        assert frequency.value == pytest.approx(50.0, abs=0.05)
        assert found.fit[channel].nrmse_after < 1.5 * found.fit[channel].noise_floor
        assert max(found.excess.values()) < 0.2


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no step of the drive")
def test_what_swings_in_two_channels_is_no_sensors(model):
    levels, fitted = model
    found = vo2.diagnose([with_mains(levels, {TIP_DEFLECTION: 0.3e-6, RESISTANCE: 800.0})], fitted)
    assert all(one.id != "sensor_interference" for one in found.effects)
    assert any("swings at 50 Hz, and so does" in text for text in found.limits)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no step of the drive")
def test_a_hum_that_is_the_smaller_part_of_what_has_no_name_is_told_and_not_named(model):
    """A sensor that jumps to and fro by more than it hums: one line does not tell what it does."""
    levels, fitted = model
    hums = with_mains(levels, {TIP_DEFLECTION: 0.3e-6})
    rng = np.random.default_rng(4)
    jumps = 0.3e-6 * np.repeat(rng.choice([-1.0, 1.0], len(hums) // 60 + 1), 60)[: len(hums)]
    found = vo2.diagnose(
        replace(hums, channels={**hums.channels, TIP_DEFLECTION: hums[TIP_DEFLECTION] + jumps}), fitted
    )
    assert [(one.id, one.family) for one in found.effects] == [("unknown", "sensor:tip_deflection")]
    said = next(text for text in found.limits if text.startswith("tip_deflection swings"))
    assert re.match(r"tip_deflection swings at (50|49\.9\d?) Hz as well, by (2\.9|3)\S*e-07 m:", said)
    assert found.next_experiment is not None and found.next_experiment.kind == "manual"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no step of the drive")
def test_what_the_calibration_had_is_not_new(model):
    levels, _ = model
    both = {TIP_DEFLECTION: 0.3e-6}
    fitted = vo2.fit(with_mains(levels, both, seed=1), "integrated")
    assert vo2.diagnose([with_mains(levels, both)], fitted).verdict == "agrees"


@pytest.mark.slow
def test_a_device_without_body_has_its_mains_named_and_its_steps_told():
    def recorded(seed: int, hum: float) -> Recording:
        rng, count = np.random.default_rng(seed), 500
        levels = np.concatenate([[0.0, 60.0, 0.0], rng.uniform(0.0, 60.0, 14)])
        volts = np.interp(np.arange(count) / 30.0, np.arange(17), levels)
        play, felt = 0.0, np.empty(count)
        for k, u in enumerate(volts):
            play = felt[k] = min(max(play, u - 6.0), u + 6.0)
        stroke = (volts + 0.5 * felt) / 90.0 + 2e-3 * rng.standard_normal(count) + swing(hum, 31.0)[:count]
        return Recording(TIME[:count], {HEATER_CURRENT: volts, TIP_DEFLECTION: 1e-5 * stroke}, "stack")

    with pytest.warns(UserWarning, match="plays"):
        fitted = vo2.fit(recorded(1, 0.0), STACK.key)
    (named,) = vo2.diagnose([recorded(2, 1.5e-2)], fitted).effects
    assert (named.id, named.family) == ("sensor_interference", "sensor:extension")
    amplitude = named.parameters["amplitude"]
    assert abs(amplitude.value - 1.5e-7) < 4.0 * amplitude.std < 0.3e-7
    coarse, step = recorded(3, 0.0), 6e-8
    coarse.channels[TIP_DEFLECTION][:] = step * np.round(coarse[TIP_DEFLECTION] / step)
    found = vo2.diagnose([coarse], fitted)
    assert not found.effects
    assert any("the values of extension lie 6e-08 m apart" in text for text in found.limits)
    assert not any("apart" in text for text in vo2.diagnose([recorded(3, 0.0)], fitted).limits)


@pytest.mark.filterwarnings("ignore:no step of the drive")
def test_readings_of_exactly_nothing_are_told_and_not_judged(model):
    levels, fitted = model
    plain = vo2.simulate("integrated", levels, seed=2)
    loose = plain[TIP_DEFLECTION].copy()
    for start in range(60, 1500, 240):
        loose[start : start + 7] = 0.0
    found = vo2.diagnose([replace(plain, channels={**plain.channels, TIP_DEFLECTION: loose})], fitted)
    assert found.verdict == "agrees"
    (told,) = [text for text in found.limits if "exactly 0" in text]
    assert f"{np.count_nonzero(loose == 0.0)} samples of tip_deflection" in told
    assert f"the first at {plain.time_s[60]:.6g} s" in told
    clamped = np.maximum(plain[TIP_DEFLECTION] - 4e-6, 0.0)
    found = vo2.diagnose([replace(plain, channels={**plain.channels, TIP_DEFLECTION: clamped})], fitted)
    assert not any("exactly 0" in text for text in found.limits)
