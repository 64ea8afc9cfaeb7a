"""Samples that were read early or late, moved to their instants by what a model does meanwhile."""

from dataclasses import replace

import numpy as np
from vo2_models.device import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank
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


def test_regular_samples_are_left_as_they_are():
    model = DeviceModel(
        "integrated", resistance=PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    )
    given = Recording(
        1e-3 * np.arange(100.0), {HEATER_CURRENT: np.ones(100), RESISTANCE: np.arange(100.0)}, "integrated"
    )
    assert read_in_time(given, model) is given
