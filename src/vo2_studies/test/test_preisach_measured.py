"""Readers of the measured recordings, the smooth fit, and what it predicts of measured data."""

from pathlib import Path

import numpy as np
import pytest
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.hysteresis.preisach.smooth_fit import fit_smooth, roughness
from vo2_models.identification.excitation import damped_oscillation, first_order_reversal_fan
from vo2_studies.preisach.measured import (
    data_folder,
    read_piezo,
    read_reversal_curves,
    read_voltage_sweep,
)
from vo2_studies.preisach.measured_study import (
    magnetic_range_study,
    magnetic_study,
    piezo_study,
    sweep_study,
)

FOUND = data_folder()
DATA = FOUND or Path()
needs_data = pytest.mark.skipif(FOUND is None, reason="no measured recordings at ../shared/data or $VO2_DATA")


def smooth_truth(level):
    walls = np.linspace(0.0, 1.0, level + 1)
    middle = 0.5 * (walls[1:] + walls[:-1])
    bump = np.exp(-(((middle[:, None] - 0.6) / 0.2) ** 2) - ((middle[None, :] - 0.4) / 0.2) ** 2)
    return PreisachOperator(walls, np.tril(bump), -1.0)


def test_roughness_is_zero_for_planes_and_counts_every_triple():
    walls = np.linspace(0.0, 1.0, 8)
    i, j = np.tril_indices(7)
    plane = 2.0 * i - 3.0 * j + 1.0
    rough = roughness(walls)
    assert np.abs(rough @ plane).max() < 1e-12
    # triples: 5 on the diagonal; along alpha and beta inside the strict triangle of 6 rows 1 + ... + 4 each
    assert rough.shape == (5 + 2 * (1 + 2 + 3 + 4), 28)
    kink = (i == 5) & (j == 2)
    assert np.sort(rough @ kink.astype(float))[:2].tolist() == [-2.0, -2.0]


def test_smooth_fit_recovers_a_smooth_density_better_than_plain_least_squares():
    truth = smooth_truth(16)
    inputs = damped_oscillation(truth.walls)
    rng = np.random.default_rng(0)
    noisy = truth(inputs) + 0.02 * np.ptp(truth.output_range) * rng.normal(size=inputs.size)
    smooth = fit_smooth(inputs, noisy, truth.walls)
    plain = fit_smooth(inputs, noisy, truth.walls, strengths=[1e-12])
    errors = [np.sqrt(np.mean((f.operator.density - truth.density) ** 2)) for f in (smooth, plain)]
    assert errors[0] < 0.5 * errors[1]
    assert smooth.operator.density.min() >= 0.0
    assert smooth.strength == smooth.strengths[np.argmin(smooth.held_out_rmse)]


def test_missing_curves_are_bridged_and_unmeasured_samples_do_not_count():
    truth = smooth_truth(16)
    fan = first_order_reversal_fan(truth.walls)
    top = np.cumsum(fan == 1.0)
    known = top % 2 == 0
    outputs = np.where(known, truth(fan), 1e6)
    fit = fit_smooth(fan, outputs, truth.walls, groups=top, measured=known)
    error = fit.operator(fan) - truth(fan)
    assert np.sqrt(np.mean(error[~known] ** 2)) < 2e-3 * np.ptp(truth.output_range)
    assert fit.residual.size == np.count_nonzero(known)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"strengths": [-1.0]}, r"strengths: found \[-1.0\], need at least one, all above 0"),
        ({"groups": np.zeros(3)}, r"groups: found shape \(3,\), need \(22,\)"),
        ({"groups": np.zeros(22)}, r"groups: found 1, need at least as many as folds, 5"),
        ({"measured": np.zeros(22, dtype=bool)}, r"measured: found shape \(22,\) with 0 True"),
    ],
)
def test_bad_input_is_named(kwargs, message):
    inputs = damped_oscillation(np.arange(7.0))
    with pytest.raises(ValueError, match=message):
        fit_smooth(inputs, inputs, np.arange(7.0), **kwargs)


def test_reversal_file_is_read_with_its_drift_taken_out(tmp_path):
    drifting = "HSat = +5.0E-01\n\n+2E-01,+1.0E-05\n\n+1E-02,+4E-06\n+2E-02,+6E-06\n\n+2E-01,+1.2E-05\n\n+0E+00,+2.4E-06\n"
    path = tmp_path / "curves"
    path.write_text(drifting)
    curves = read_reversal_curves(path)
    assert curves.saturation_t == 0.5 and curves.calibration_am2.tolist() == [1.0e-5, 1.2e-5]
    gain = 1.1e-5 / (1e-5 + 0.2e-5 * np.array([1, 2]) / 3)
    assert curves.moment_am2[0] == pytest.approx(np.array([4e-6, 6e-6]) * gain)
    assert curves.moment_am2[1] == pytest.approx([2.4e-6 * 1.1 / 1.2])
    path.write_text("+2E-01,+1.0E-05\n+2E-01,+1.0E-05\n\n+1E-02,+4E-06\n")
    with pytest.raises(ValueError, match=r"need one calibration point before each curve"):
        read_reversal_curves(path)
    path.write_text("+2E-01,abc\n")
    with pytest.raises(ValueError, match=r"line 1: found '\+2E-01,abc', need 'field,moment'"):
        read_reversal_curves(path)
    path.write_text("a,b\nx\n")
    with pytest.raises(ValueError, match=r"found no line of five numbers"):
        read_voltage_sweep(path)
    path.write_text("1 2\n3 4\n")
    with pytest.raises(ValueError, match=r"found shape \(2, 2\), need at least 5 columns"):
        read_piezo(path)


@needs_data
def test_magnetic_curves_held_out_are_predicted_a_fifth_better_with_smoothness():
    curves = read_reversal_curves(DATA / "magnetic_forc" / "UB199BF")
    assert len(curves.field_t) == 140 and sum(map(len, curves.field_t)) == 15504
    study = magnetic_study(curves, (-0.028, 0.032), level=34, strengths=(1e-3, 1e-5, 1e-7))
    assert study.gain >= 0.2
    assert study.smooth_rmse < 0.003 * study.output_range
    # no better than the residual it was fitted to: the held-out curves are of the same kind
    assert study.smooth_rmse == pytest.approx(study.noise_rmse, rel=0.5)


@needs_data
@pytest.mark.parametrize(
    ("level", "limit"), [(20, 0.2), (40, 0.4), pytest.param(215, 0.9, marks=pytest.mark.slow)]
)
def test_whole_magnetic_recording_is_predicted_a_fifth_better(level, limit):
    """At every level; the last has cells of the field step between reversals."""
    curves = read_reversal_curves(DATA / "magnetic_forc" / "UB199BF")
    study = magnetic_range_study(curves, level, strengths=(1e-3, 1e-5, 1e-7))
    # the yardstick is the optimum of the constrained problem
    assert study.slope > -1e-9
    assert study.slackness < 1e-4
    assert study.gain >= limit
    # the same sign on both sides: smoothness by itself changes little over the whole range
    assert study.nonnegative_rmse == pytest.approx(study.plain_rmse, rel=0.05)
    # what was held out is predicted nearly as well as what was fitted; negative densities are part of it
    assert study.smooth_rmse < (1.1 if level < 100 else 3.0) * study.fit.rmse
    assert study.fit.operator.density.min() < 0.0


@needs_data
def test_training_curves_choose_the_signed_density():
    curves = read_reversal_curves(DATA / "magnetic_forc" / "UB199BF")
    v = np.concatenate([np.r_[curves.saturation_t, field] for field in curves.field_t])
    u = np.concatenate([np.r_[0.0, 1e6 * moment] for moment in curves.moment_am2])
    label = np.repeat(np.arange(140), [field.size + 1 for field in curves.field_t])
    measured = (label % 2 == 1) & (np.diff(label, prepend=-1) == 0)
    walls = np.r_[np.linspace(-0.1881, 0.2075, 20), curves.saturation_t]
    fit, positive = (
        fit_smooth(v, u, walls, nonnegative=sign, groups=label, measured=measured, strengths=(1e-5, 1e-7))
        for sign in (None, True)
    )
    assert not fit.nonnegative
    assert fit.held_out_rmse.min() < 0.85 * positive.held_out_rmse.min()


def test_sign_is_chosen_by_what_is_left_out():
    rng = np.random.default_rng(1)
    truth = smooth_truth(12)
    dented = PreisachOperator(truth.walls, truth.density - np.tril(np.full((12, 12), 0.3)), -1.0)
    fan = first_order_reversal_fan(truth.walls)
    groups = np.cumsum(fan == 1.0)
    found = []
    for operator in (truth, dented):
        noisy = operator(fan) + 0.01 * np.ptp(operator(fan)) * rng.normal(size=fan.size)
        found.append(fit_smooth(fan, noisy, truth.walls, nonnegative=None, groups=groups))
    assert [fit.nonnegative for fit in found] == [True, False]
    assert found[0].operator.density.min() >= 0.0
    error = found[1].operator(fan) - dented(fan)
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.ptp(dented(fan))  # the noise
    alone = fit_smooth(fan, noisy, truth.walls, groups=groups)
    assert alone.nonnegative
    assert found[1].held_out_rmse.min() < 0.2 * alone.held_out_rmse.min()


@needs_data
def test_piezo_is_predicted_beyond_the_part_fitted():
    study = piezo_study(*read_piezo(DATA / "piezo" / "Model_Vi_Do.dat"), level=14, strengths=(1e-1, 1e-3))
    assert study.smooth_rmse < 0.015 * study.output_range


@needs_data
def test_film_sweep_is_predicted_between_the_samples_fitted():
    voltage, current, resistance = read_voltage_sweep(DATA / "vo2_device" / "VO2_data_RvsV_transition.csv")
    assert voltage.size == 419 and np.median(np.abs(voltage / current / resistance - 1)) < 0.01
    study = sweep_study(voltage, resistance, level=14, strengths=(1e-1, 1e-3))
    assert study.smooth_rmse < 0.05 * study.output_range
