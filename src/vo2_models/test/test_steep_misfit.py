"""A law's misfit that is larger where the response is steep: its two sizes, and what a diagnosis makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from own_devices import STACK
from vo2_models.device import DeviceModel
from vo2_models.device.model import SensorModel
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import Located, locate
from vo2_models.diagnosis.misfit import NO_MISFIT, Whitening
from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.pipeline import study
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.read import read
from vo2_models.identification.model_fit import fit_model
from vo2_models.identification.steepness import steep_misfit, unevenness, variation
from vo2_models.recording import HEATER_CURRENT, TIP_DEFLECTION, Recording


def recorded(seed: int, change: float = 0.0) -> Recording:
    """Loops whose place wanders from branch to branch, which no law has; `change` of the span comes about the middle."""
    rng = np.random.default_rng(seed)
    count = 1500
    share = np.arange(count) / count
    size = np.interp(share, np.linspace(0.0, 1.0, 9), 28.0 * rng.permutation(np.linspace(0.5, 1.0, 9)))
    size[: count // 6] = 28.0
    volts = 30.0 - size * np.cos(2 * np.pi * 12 * share)
    place = 2.0 * rng.normal(size=25)[(24 * share).astype(int)]
    play, felt = volts[0], np.empty(count)
    for k, u in enumerate(volts):
        play = felt[k] = min(max(play, u - 5.0), u + 5.0)
    stroke = np.tanh((felt + place - 30.0) / 4.0) + 2.0 * change * np.interp(share, [0.45, 0.55], [0.0, 1.0])
    stroke += 2e-3 * rng.standard_normal(count)
    return Recording(0.1 * np.arange(count), {HEATER_CURRENT: volts, TIP_DEFLECTION: 1e-5 * stroke}, "stack")


def located(recording: Recording, model: dict) -> Located:
    limits, clock = Limits(), Clock(lambda share, text: None, 700)
    nominal = Nominal.from_parameters(model)
    return locate(
        read([nominal.model.description.understood(recording)], nominal, (), limits, clock), limits, clock
    )


@pytest.mark.slow
def test_a_change_on_flat_stretches_shows_beside_a_misfit_of_the_steep_ones():
    model = fit_model([recorded(1)], STACK.key)[1]
    sensor = f"model.sensors.{TIP_DEFLECTION}"
    assert model[f"{sensor}.misfit_flat"] < 0.1 * model[f"{sensor}.misfit"]
    even = {name: value for name, value in model.items() if "misfit_" not in name}

    unchanged = study([recorded(2)], model)
    assert unchanged.located.nominal.uneven and unchanged.decision.verdict == "agrees"
    seen, hidden = (located(recorded(2, 0.05), one) for one in (model, even))
    assert seen.nominal.uneven and not hidden.nominal.uneven
    # in powers of noise and misfit, on top of what the unchanged device has
    assert seen.total_excess > unchanged.located.total_excess + 1.0
    assert hidden.total_excess < 0.3
    # a limitation: what differs at all is judged by the error of all samples, so that this one still agrees
    assert seen.within_misfit(Limits().own_misfit)
    # what is large may have moved what is steep
    assert not located(recorded(2, 0.6), model).nominal.uneven


def test_the_variation_is_what_the_response_goes_up_and_down_while_the_path_travels_the_window():
    # up and down again in steps of a tenth, a rest of five samples at the top
    path = np.concatenate([np.linspace(0.0, 5.0, 51), np.full(5, 5.0), np.linspace(5.0, 0.0, 51)[1:]])
    response = np.where(path > 2.0, 3.0 * (path - 2.0), 0.0)
    found = variation(path, response, 1.0)
    assert found[10] == 0.0
    assert found[35] == pytest.approx(3.0, rel=1e-6)
    assert found[52] == pytest.approx(3.0, rel=1e-6)  # half of the window on either side of the turn
    assert found[20] == pytest.approx(1.5, rel=1e-6)
    np.testing.assert_allclose(found, found[::-1], atol=1e-6)


def test_both_sizes_of_a_misfit_are_found():
    rng = np.random.default_rng(3)
    varies = np.abs(rng.normal(size=4000)) ** 3
    residual = rng.normal(size=4000) * np.hypot(0.2, 0.5 * varies)
    residual[::7] = np.nan
    flat, steep = steep_misfit(residual, varies, 0.05)
    assert flat == pytest.approx(0.2, rel=0.1)
    assert steep == pytest.approx(0.5, rel=0.1)


def test_one_size_stays_one_and_no_flat_stretch_is_quieter_than_the_sensor():
    rng = np.random.default_rng(4)
    varies = np.abs(rng.normal(size=2000))
    assert steep_misfit(rng.normal(size=2000), varies, 0.1) == (0.0, 0.0)
    assert steep_misfit(np.zeros(2000), varies, 0.0) == (0.0, 0.0)
    flat, _ = steep_misfit(rng.normal(size=2000) * varies, varies, 0.3)
    assert flat == pytest.approx(0.3, rel=0.05)


def test_noise_of_uneven_size_is_whitened_by_its_size_and_back():
    rng = np.random.default_rng(5)
    n, noise = 4000, NoiseModel(0.3, (0.7,))
    size = np.where(np.arange(n) % 100 < 10, 20.0, 0.5)
    values = size * noise.color(rng.normal(size=n))
    even = Whitening.along(np.zeros(n), noise, np.ones(n), NO_MISFIT, np.ones(n, bool))
    uneven = replace(even, size=size)
    white = uneven(values)
    np.testing.assert_allclose(uneven.undo(white), values, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(uneven(values[:, None])[:, 0], white, rtol=1e-12)
    # behind each steep stretch a whitening of one size takes the end of it for a jump
    assert np.mean(white[10::100] ** 2) == pytest.approx(1.0, abs=0.5)
    assert np.mean(even(values)[10::100] ** 2) > 100.0


def test_a_sensor_without_flat_misfit_is_even():
    path = np.linspace(30.0, 90.0, 200)
    response = np.tanh((path - 60.0) / 4.0)
    sensor = SensorModel(noise=0.01, residual=0.2, misfit=0.25)
    np.testing.assert_array_equal(unevenness(STACK, sensor, path, response), np.ones(200))
    uneven = unevenness(STACK, replace(sensor, misfit_flat=0.05, misfit_steep=0.4), path, response)
    assert uneven[3] == pytest.approx(0.05 / 0.25, rel=1e-3)
    assert uneven[100] == pytest.approx(np.hypot(0.05, 0.4 * 0.03 * 60.0 / 4.0) / 0.25, rel=0.02)


def test_sizes_are_in_the_model_file_only_where_there_are_two():
    sensor = SensorModel(noise=0.01, residual=0.2, misfit=0.25)
    plain = DeviceModel(STACK.key, sensors={TIP_DEFLECTION: sensor})
    assert not any("misfit_" in name for name in plain.to_parameters())
    two = replace(
        plain,
        sensors={
            TIP_DEFLECTION: replace(sensor, misfit_flat=0.05, misfit_steep=0.4, misfit_colour=(0.5, -0.1))
        },
    )
    back = DeviceModel.from_parameters(two.to_parameters())
    assert back.sensors[TIP_DEFLECTION] == two.sensors[TIP_DEFLECTION]
