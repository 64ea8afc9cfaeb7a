"""The device's own misfit against the covariance that its equation says, written out in full."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from vo2_models.device import DeviceModel
from vo2_models.diagnosis.loop_shape import STRETCHES, _left_out_each, loop_shapes
from vo2_models.diagnosis.misfit import NO_MISFIT, Misfit, Whitening, innovations
from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.diagnosis.nominal import Nominal, basis_of
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.digest import CalibrationDigest
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION


def _path(rng, n):
    return 60.0 + np.cumsum(rng.normal(scale=0.8, size=n))


def test_innovations_are_those_of_the_covariance():
    rng = np.random.default_rng(5)
    n, travel = 60, 3.0
    temperature = _path(rng, n)
    slope = np.where(rng.random(n) < 0.8, 2.0, 0.0)
    variance = rng.uniform(0.5, 2.0, n)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(temperature)))]) / travel
    covariance = np.outer(slope, slope) * np.exp(-np.abs(way[:, None] - way)) + np.diag(variance)
    columns = rng.normal(size=(n, 3))
    found, log_determinant = innovations(columns, slope, np.diff(way, prepend=0.0), variance)
    np.testing.assert_allclose(found.T @ found, columns.T @ np.linalg.solve(covariance, columns), rtol=1e-10)
    assert log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-10)


@pytest.mark.parametrize("ar", [(), (0.6, -0.1)])
def test_whitening_is_undone_and_misses_no_sample_beside_a_gap(ar):
    rng = np.random.default_rng(6)
    n = 80
    temperature, values = _path(rng, n), rng.normal(size=n)
    weight = rng.uniform(0.3, 1.0, n)
    inside = temperature > 60.0
    whiten = Whitening.along(temperature, NoiseModel(0.2, ar), weight, Misfit(0.5, 4.0), inside)
    np.testing.assert_allclose(whiten.undo(whiten(values)), values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(whiten(np.column_stack([values, values]))[:, 1], whiten(values), rtol=1e-12)
    missing = weight.copy()
    missing[30:40] = 0.0
    gap = replace(whiten, weight=missing, slope=whiten.slope * (missing > 0))
    assert np.all(gap(values)[30:40] == 0.0)
    np.testing.assert_allclose(gap(values)[:30], whiten(values)[:30], rtol=1e-12)
    without = Whitening.along(temperature, NoiseModel(0.2, ar), weight, NO_MISFIT, inside)
    np.testing.assert_allclose(without(values), NoiseModel(0.2, ar).whiten(values) * weight, rtol=1e-12)


def test_what_is_slow_in_a_response_is_told_as_misfit_and_in_a_current_reading_is_not():
    slow, quick = NoiseModel(1e-3, (0.99,)), NoiseModel(1e-7, (0.3,))
    noise = {RESISTANCE: slow, TIP_DEFLECTION: quick, HEATER_CURRENT: slow}
    nominal = Nominal(DeviceModel("integrated"), {}, None, noise)
    told = nominal.with_slow_misfit_told(3.0).noise
    assert told == {RESISTANCE: NoiseModel(1e-3), TIP_DEFLECTION: quick, HEATER_CURRENT: slow}
    fast = replace(nominal, noise=noise | {RESISTANCE: quick})
    assert fast.with_slow_misfit_told(3.0) is fast


@pytest.fixture(scope="module")
def calibration():
    """Blocks of a calibration over twelve loops of several sizes: (temperatures at their ends, noise of a sample)."""
    rng = np.random.default_rng(7)
    turns = np.concatenate([[25.0, 85.0, 30.0], rng.uniform(48.0, 75.0, 40), [30.0, 85.0]])
    pieces = [np.linspace(a, b, max(int(abs(b - a) / 0.7), 1) + 1)[1:] for a, b in pairwise(turns)]
    return np.concatenate([[25.0], *pieces]), 1e-3


def _nominal(calibration, residual):
    ends, noise = calibration
    size = ends.size - 1
    digest = CalibrationDigest(
        ends, np.full(size, 10.0), residual, np.zeros(size), noise_log_resistance=(noise,)
    )
    bank = PlayBank([0.5], [0.0], [0.2], [-12.4], [0.2], [-11.0], [-4.7, 0.001])
    model = DeviceModel("integrated", resistance=bank)
    return Nominal(model, {}, digest, {RESISTANCE: NoiseModel(noise), TIP_DEFLECTION: NoiseModel(1e-9)})


def _shape(calibration, residual):
    return loop_shapes(_nominal(calibration, residual))[RESISTANCE]


def test_a_misfit_that_wanders_is_told_from_noise_and_from_another_loop(calibration):
    ends, noise = calibration
    rng = np.random.default_rng(8)
    blocks = rng.normal(scale=noise / np.sqrt(10.0), size=ends.size - 1)
    basis = basis_of(DeviceModel("integrated"))
    loop = basis.fold(0.5 * rng.standard_normal(basis.columns), span=4.0)(ends)
    shape = _shape(calibration, blocks + 0.5 * (loop[1:] + loop[:-1]))
    assert shape.misfit.level == 0.0, "a loop of another shape, and noise"
    assert shape.left_out < 0.3
    way = np.cumsum(np.abs(np.diff(ends)))
    covariance = np.exp(-np.abs(way[:, None] - way) / 10.0)
    wander = (
        10.0 * noise * np.linalg.cholesky(covariance + 1e-9 * np.eye(way.size)) @ rng.normal(size=way.size)
    )
    shape = _shape(calibration, blocks + wander)
    assert 3.0 * noise <= shape.misfit.level <= 10.0 * noise
    nominal = _nominal(calibration, blocks + wander)
    chosen = loop_shapes(nominal)
    again = loop_shapes(nominal, chosen)[RESISTANCE]
    assert again.misfit == shape.misfit, "what the calibration chose stays when the noise is refined"
    assert again.left_out == pytest.approx(shape.left_out)


@pytest.mark.parametrize(("samples", "many"), [(0, 0), (40, 7), (4000, 12)])
def test_main_directions_are_the_eigenvectors_of_the_whole_matrix(calibration, samples, many):
    """Fewer samples than weights, more, and none that says anything."""
    shape = _shape(calibration, np.zeros(calibration[0].size - 1))
    path = _path(np.random.default_rng(9), 4000)[:samples]
    features = (
        1e3 * shape.basis.features(path, span=shape.span) if samples else np.zeros((1, shape.mean.size))
    )
    gram = features.T @ features
    inverse = np.linalg.inv(shape.factor)
    value, vector = np.linalg.eigh(inverse @ gram @ inverse.T)
    wanted = inverse.T @ vector[:, value > 0.5][:, -12:]
    found = shape.main_directions(gram, most=12)
    assert found.shape == wanted.shape and found.shape[1] == many
    sign = np.sign(np.sum(found * wanted, axis=0))
    np.testing.assert_allclose(found * sign, wanted, atol=1e-6 * np.max(np.abs(wanted), initial=0.0))


@pytest.mark.parametrize("size", [1.0, 1e6], ids=["open", "known to a millionth"])
def test_a_stretch_is_judged_by_what_the_others_say_of_it(size):
    """One factor of all stretches against the definition: the others alone are regressed, and predict the one left out."""
    rng = np.random.default_rng(3)
    columns, target = size * rng.normal(size=(60, 7)), rng.normal(size=60)
    found = list(_left_out_each(columns, target))
    assert [piece.start for piece, _, _ in found] == [10 * k for k in range(STRETCHES)]
    for piece, chi_square, log_determinant in found:
        others = np.ones(60, bool)
        others[piece] = False
        precision = columns[others].T @ columns[others] + np.eye(7)
        left = target[piece] - columns[piece] @ np.linalg.solve(precision, columns[others].T @ target[others])
        spread = np.eye(10) + columns[piece] @ np.linalg.solve(precision, columns[piece].T)
        assert chi_square == pytest.approx(float(left @ np.linalg.solve(spread, left)), rel=1e-6)
        assert log_determinant == pytest.approx(np.linalg.slogdet(spread)[1], rel=1e-6)
