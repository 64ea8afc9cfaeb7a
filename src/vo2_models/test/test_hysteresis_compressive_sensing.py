"""Compressive sensing of play weights: against non-negative least squares on the same few measurements."""

import numpy as np
import pytest
from scipy.optimize import nnls
from vo2_models.hysteresis import EGPI, GPI, Linear, TanhEnvelopes
from vo2_models.hysteresis.compressive_sensing_gpi import identify_play_weights
from vo2_models.identification.excitation import damped_oscillation

N = 60
RADII = np.arange(N) / N
ENVELOPES = TanhEnvelopes(1.2, -0.4, 1.2, 0.4)
EXCITATION = damped_oscillation(np.linspace(-2.5, 2.5, 15))
NEW = 2.5 * np.sin(np.linspace(0, 40, 700)) * np.cos(np.linspace(0, 7, 700))


def device(seed):
    """A smooth weight distribution with its peak somewhere in the middle."""
    centre = np.random.default_rng(seed).uniform(0.3, 0.5)
    return GPI(RADII, np.exp(-(((RADII - centre) / 0.15) ** 2)), ENVELOPES, 1.0)


def errors(model, truth):
    expected = truth.simulate(NEW)[0]
    gap = np.sqrt(np.mean((model.simulate(NEW)[0] - expected) ** 2)) / np.ptp(expected)
    return np.linalg.norm(model.weights - truth.weights) / np.linalg.norm(truth.weights), gap


def test_thirteen_measurements_of_sixty_plays():
    """106 levels, 13 of them measured: far better than least squares, in the weights and in new outputs."""
    sparse, plain = [], []
    for seed in range(20):
        truth = device(seed)
        rows = np.sort(np.random.default_rng(seed).choice(EXCITATION.size, 13, replace=False))
        y = truth.simulate(EXCITATION)[0][rows]
        sparse.append(errors(identify_play_weights(truth, EXCITATION, rows, y).model, truth))
        columns = np.concatenate(
            [truth.play_outputs(EXCITATION)[rows], np.ones((13, 1)), -np.ones((13, 1))], axis=1
        )
        found = nnls(columns, y)[0]
        plain.append(errors(GPI(RADII, found[:N], ENVELOPES, found[N] - found[N + 1]), truth))
    (weight, output), (plain_weight, plain_output) = np.mean(sparse, axis=0), np.mean(plain, axis=0)
    assert weight < 0.05
    assert output < 0.001
    assert plain_weight > 20 * weight
    assert plain_output > 10 * output


def test_noise_within_its_bound_is_allowed_for():
    truth = device(1)
    rng = np.random.default_rng(2)
    rows = np.sort(rng.choice(EXCITATION.size, 50, replace=False))
    y = truth.simulate(EXCITATION)[0][rows]
    bound = 2e-3 * np.ptp(y)
    noisy = y + rng.uniform(-bound, bound, y.size)
    found = identify_play_weights(truth, EXCITATION, rows, noisy, noise=bound)
    given = found.model.simulate(EXCITATION)[0][rows]
    assert np.max(np.abs(given - noisy)) <= bound * (1 + 1e-6)
    assert errors(found.model, truth)[1] < 2e-3
    assert np.all(found.model.weights >= 0)
    # the truth obeys the same constraints, so the least norm is not above its norm
    assert found.norm <= np.sum(np.abs(identify_play_weights(truth, EXCITATION, rows, y).coefficients)) * (
        1 + 1e-9
    )


def test_a_memoryless_part_is_kept_aside():
    truth = device(3)
    extended = EGPI(RADII, truth.weights, ENVELOPES, Linear(-3.0), 1.0)
    rows = np.arange(0, EXCITATION.size, 3)
    y = extended.simulate(EXCITATION)[0][rows]
    found = identify_play_weights(extended, EXCITATION, rows, y).model
    assert isinstance(found, EGPI)
    np.testing.assert_allclose(found.weights, truth.weights, atol=0.02)


@pytest.mark.parametrize(
    ("rows", "measured", "options", "message"),
    [
        ([0, 0], [1.0, 2.0], {}, r"rows: found repeated"),
        ([0, 106], [1.0, 2.0], {}, r"rows: found repeated or outside values, need distinct indices 0 to 105"),
        ([0], [1.0, 2.0], {}, r"rows: found shape \(1,\)"),
        ([0, 1], [1.0, np.nan], {}, r"measured: found nan"),
        ([0, 1], [1.0, 2.0], {"noise": -1.0}, r"noise: found -1.0"),
        # the lowest level gives the least output of all: no weights >= 0 put it above the highest
        ([0, 14], [2.0, 1.0], {}, r"measured: found outputs that no non-negative weights"),
    ],
)
def test_bad_input_is_named(rows, measured, options, message):
    with pytest.raises(ValueError, match=message):
        identify_play_weights(device(0), EXCITATION, rows, measured, **options)
