"""Samples that were read early or late, moved to their instants by what a model does meanwhile."""

from dataclasses import replace

import numpy as np
import pytest
from vo2_models.device import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.grid import held
from vo2_models.identification.read_in_time import read_in_time
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, Recording, regular

FINE = 100


def test_a_body_as_fast_as_the_samples_is_followed_within_one():
    """Its time constant is of two samples: a third of a step's answer falls within one, which no straight line follows."""
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    model = DeviceModel("integrated", resistance=bank)
    true = replace(model, scalars={**model.scalars, "thermal.time_constant": 2.0e-3})
    fitted = replace(model, scalars={**model.scalars, "thermal.time_constant": 2.1e-3})
    rng, dt, count = np.random.default_rng(1), 1e-3, 2000
    current = np.repeat(rng.uniform(4e-3, 9e-3, count // 4), 4)
    out = np.log10(true.simulation.run(np.repeat(current, FINE), dt=dt / FINE)[:, 1])
    late = rng.uniform(-0.25, 0.25, count)
    late[[0, -1]] = 0.0
    at = (np.arange(count) + late + 1.0) * FINE - 1.0
    read, exact = 10.0 ** np.interp(at, np.arange(out.size), out), out[FINE - 1 :: FINE]
    keep = rng.random(count) > 0.05
    keep[[0, -1]] = True
    unread = 5.0 + dt * np.flatnonzero(~keep), current[~keep]
    stamps = 5.0 + dt * (np.arange(count) + late)
    channels = {COMMANDED_CURRENT: current, HEATER_CURRENT: current, RESISTANCE: read}
    given = Recording(stamps[keep], {name: v[keep] for name, v in channels.items()}, "integrated", unread)

    def error(moved):
        assert len(moved) == count and np.array_equal(moved[COMMANDED_CURRENT], current)
        off = (np.log10(moved[RESISTANCE]) - exact)[10:]
        assert np.array_equal(np.isfinite(off), keep[10:])
        return float(np.sqrt(np.nanmean(off**2)))

    as_read = float(np.sqrt(np.mean((np.log10(read) - exact)[10:] ** 2)))
    assert error(read_in_time(given, fitted)) < 0.15 * as_read
    assert 0.2 * as_read < error(regular(given)) < as_read


@pytest.mark.parametrize(
    "says", ["what flowed up to the instant", "what flows when it is read", "what moves on in between"]
)
def test_a_drive_that_is_only_logged_is_read_as_the_model_follows_it(says):
    """A loop of a law's own, of a body of two samples; what a late sample logs is what flowed before, or already the next."""
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    model = DeviceModel("integrated", resistance=bank)
    model = replace(model, scalars={**model.scalars, "thermal.time_constant": 2.0e-3})
    rng, dt, count = np.random.default_rng(3), 1e-3, 2000
    levels = np.repeat(rng.uniform(4e-3, 9e-3, count // 10 + 1), 10)
    fine = np.repeat(levels, FINE)
    if says == "what moves on in between":
        fine = 6.5e-3 + 2.5e-3 * np.sin(np.arange(fine.size) / (40.0 * FINE))
    out = np.log10(model.simulation.run(fine, dt=dt / FINE)[:, 1])
    late = rng.uniform(-0.3, 0.3, count)
    at = (np.arange(count) + late + 1.0) * FINE - 1.0
    read = 10.0 ** np.interp(at, np.arange(out.size), out)
    drive = fine[np.ceil(at).astype(int)]
    if says == "what flowed up to the instant":
        drive = levels[:count]
    given = Recording(dt * (np.arange(count) + late), {HEATER_CURRENT: drive, RESISTANCE: read}, "integrated")

    def error(moved):
        run = model.simulation.run(held(moved[HEATER_CURRENT]), dt=moved.sample_period_s)[:, 1]
        off = np.log10(moved[RESISTANCE] / run)[10:]
        assert np.isfinite(off).mean() > 0.9
        return float(np.nanmean(off**2)) ** 0.5

    plain = error(regular(given))
    if says == "what moves on in between":
        assert error(read_in_time(given, model)) <= plain < 0.01
    else:
        assert error(read_in_time(given, model)) < 0.02 < 3.0 * plain


def test_regular_samples_are_left_as_they_are():
    model = DeviceModel(
        "integrated", resistance=PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    )
    given = Recording(
        1e-3 * np.arange(100.0), {HEATER_CURRENT: np.ones(100), RESISTANCE: np.arange(100.0)}, "integrated"
    )
    assert read_in_time(given, model) is given
