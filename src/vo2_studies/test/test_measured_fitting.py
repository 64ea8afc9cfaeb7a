"""Fits and judgements on made-up recordings, written here with numpy alone: not by the project's simulation."""

import json
from dataclasses import replace

import numpy as np
import pytest
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording
from vo2_studies.measured import fitting
from vo2_studies.measured.candidates import LAG, PIEZO, RATE_INDEPENDENT, VO2, Candidate, Extra
from vo2_studies.measured.cases import Case, cases_of, drive_share, with_share
from vo2_studies.measured.figures import error_figure, piezo_figure
from vo2_studies.measured.fitting import Setting, fit_candidate, fit_lag
from vo2_studies.measured.report import SetReport, write_report
from vo2_studies.measured.sources import Source, Trace
from vo2_studies.measured.study import study_set
from vo2_studies.measured.where import decades, line_of, rms_over_time

DT = 1e-3
SETTING = Setting(RESISTANCE, True, 4, 0.01, (0.003, 0.01), steps=20)
SECOND = next(c for c in VO2 if c.id == "second_thermal_mode")
KINETICS = next(c for c in VO2 if c.id == "transition_kinetics")


def lagged(drive, constant):
    out = np.zeros(drive.size)
    keep = np.exp(-DT / constant)
    for k in range(1, drive.size):
        out[k] = keep * out[k - 1] + (1.0 - keep) * drive[k]
    return out


def relaxation(power, *, slow_share=0.0, seed=0, hum=0.0, count=400):
    """Log10 R of a film that cools after a pulse of 60 samples: a smooth curve over a temperature of two heat paths."""
    drive = np.where((np.arange(count) > 0) & (np.arange(count) <= 60), power, 0.0)
    heat = (1.0 - slow_share) * lagged(drive, 0.006) + slow_share * lagged(drive, 0.06)
    time = DT * np.arange(count)
    y = 4.5 - 0.6 * heat - 1.2 / (1.0 + np.exp(-(heat - 0.35) / 0.08))
    y += 0.001 * np.random.default_rng(seed).normal(size=count) + hum * np.sin(2 * np.pi * 50.0 * time)
    judged = np.arange(count) > 61
    recording = Recording(
        time, {HEATER_CURRENT: np.zeros(count), RESISTANCE: np.where(judged, 10.0**y, np.nan)}, "integrated"
    )
    since = np.where(np.arange(count) > 60, time - 60 * DT, np.nan)
    case = Case(f"{power:g} W", recording, RESISTANCE, since, drive, "W")
    return replace(case, recording=with_share(recording, drive / 1.0))


def family(powers=(0.4, 0.55, 0.7, 0.85, 1.0), **kwargs):
    return [relaxation(p, seed=k, **kwargs) for k, p in enumerate(powers)]


def test_share_of_the_drive_survives_the_equivalent_current():
    share = np.linspace(0.0, 1.0, 7)
    case = relaxation(1.0, count=100)
    recording = with_share(case.recording.slice(0, 7), share)
    assert drive_share(recording[HEATER_CURRENT]) == pytest.approx(share, abs=1e-12)


def test_loop_derivatives_are_those_of_the_residual():
    cases = [case.thinned() for case in family()[:2]]
    fit = fit_lag(SETTING, cases)
    grids = [case.grid for case in cases]
    problem = fitting._problem(SETTING, grids, LAG, fit.model)
    theta = problem.start.copy()
    loop = sum("[" in c.name for c in problem.coordinates)
    here, path = fitting._run(problem, theta, SETTING)
    columns = fitting._loop_columns(SETTING, theta[:loop], path, grids)
    for place in range(loop):
        step = 1e-5 * problem.coordinates[place].scale
        moved = theta.copy()
        moved[place] += step
        difference = (fitting._run(problem, moved, SETTING)[0] - here) / step
        # a play between two samples is a corner: a few samples may lie on its other side
        wrong = np.abs(columns[:, place] - difference) > 1e-3 * (1.0 + np.abs(difference).max())
        assert np.count_nonzero(wrong) <= 0.03 * wrong.size


def test_a_lag_is_found_and_predicts_a_pulse_between():
    cases = [case.thinned() for case in family()]
    fit = fit_lag(SETTING, [cases[0], cases[2], cases[4]])
    assert fit.values["thermal.time_constant"] == pytest.approx(0.006, rel=0.1)
    rigid = fit_candidate(SETTING, [cases[0], cases[2], cases[4]], RATE_INDEPENDENT, 0.0)
    for case in (cases[1], cases[3]):
        with_lag, without = fit.gap(case), rigid.gap(case)
        good = np.isfinite(with_lag)
        assert np.sqrt(np.mean(with_lag[good] ** 2)) < 0.2 * np.sqrt(np.mean(without[good] ** 2))


@pytest.fixture(scope="module")
def two_paths():
    cases = family(np.linspace(0.4, 1.0, 7), slow_share=0.3, count=300)
    return study_set("made up", cases, candidates=(SECOND, KINETICS), setting=SETTING)


def test_second_heat_path_is_named_and_measured(two_paths):
    found = two_paths
    assert found.chosen.candidate.id == "second_thermal_mode"
    assert found.named, found.reasons
    assert found.chosen.gain > 0.85
    constants = [fit.values["second_thermal_mode.time_constant"] for fit in found.chosen.fits]
    # which of the two paths is called the second is a matter of names
    fast = [fit.values["thermal.time_constant"] for fit in found.chosen.fits]
    assert np.max([constants, fast], axis=0) == pytest.approx(0.06, rel=0.25)
    assert len({fold.words for fold in found.folds}) == 2


def test_page_and_answer_tell_what_the_study_found(two_paths, tmp_path):
    source = Source("made up", "A made-up film", "nowhere", "none", "this test")
    report = SetReport(source, two_paths, None, None, ("one gap",), 1.0)
    html, answer = write_report(tmp_path, [report], ["piezo/Model_Vi_Do.dat"])
    text = html.read_text()
    assert text.count("<figure") == 3
    assert "Named: second_thermal_mode" in text
    assert "Not there: piezo/Model_Vi_Do.dat" in text
    assert "http" not in text.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    ).replace("https://matplotlib.org", "")
    found = json.loads(answer.read_text())["sets"]["made up"]
    assert found["named"] == "second_thermal_mode"
    held = {c["id"]: c["rms_held_out"] for c in found["candidates"]}
    assert held["second_thermal_mode"] == pytest.approx(two_paths.chosen.held)
    assert held["one_lag"] > 3.0 * held["second_thermal_mode"]
    assert sum(n["later"] for n in found["laws"]["best"].values()) == 7


def test_nothing_is_named_where_one_lag_is_all_there_is():
    found = study_set("made up", family(count=200), candidates=(SECOND,), setting=SETTING)
    assert not found.named
    assert found.reasons


def test_parameters_outside_the_catalogue_are_fitted_with_the_loop():
    def delayed(grids, values, settled):
        return [replace(grid, current=np.sqrt(np.exp(values[0])) * grid.current) for grid in grids]

    gain = Candidate(
        "gain", "drive times g", {}, extra=(Extra("g", "1", 150.0, 0.3, 3.0, 0.02, True),), transform=delayed
    )
    cases = [case.thinned() for case in family()[::2]]
    lag = fit_lag(SETTING, cases)
    fit = fit_candidate(SETTING, cases, gain, 0.006, lag)
    # the drive is as recorded, and the loop absorbs most of a gain: the true 1 lies within what the fit says it knows
    assert fit.std["g"] > 0.002
    assert abs(np.log(fit.values["g"])) <= 4.0 * fit.std["g"]
    assert fit.rms <= 1.05 * lag.rms < 0.01


def test_hum_is_told_from_a_slow_course():
    quiet, loud = family(count=1200), family(hum=0.02, count=1200)
    fit = fit_lag(SETTING, [case.thinned() for case in quiet[::2]])
    assert line_of(fit, quiet) is None
    line = line_of(fit, loud)
    assert line is not None
    assert line.frequency_hz == pytest.approx(50.0, abs=2.0)
    assert line.amplitude == pytest.approx(0.02, rel=0.3)
    assert line.recordings == 5


def test_error_over_time_keeps_all_of_the_energy():
    cases = [case.thinned() for case in family()]
    fit = fit_lag(SETTING, cases[::2])
    edges = decades(cases)
    error, count = rms_over_time([(fit, cases)], edges)
    total = sum(float(np.nansum(fit.gap(case) ** 2)) for case in cases)
    assert np.sum(error**2 * count) == pytest.approx(total, rel=1e-9)
    assert count.sum() == sum(np.count_nonzero(np.isfinite(c.recording[RESISTANCE])) for c in cases)


def pulsed(voltage):
    time = 2e-4 * np.arange(1000)
    on = ((time < 0.01) & (time > 0)) | ((time > 0.1) & (time < 0.11))
    v = np.where(on, voltage, 0.5)
    v[-3:] = 0.0
    r = np.where(on, 100.0, 600.0)
    channels = {"heater_voltage": v, HEATER_CURRENT: v / r, RESISTANCE: r}
    return Trace(f"{voltage:g} V", Recording(time, channels, "two_terminal_vo2"), None, ())


def test_pulses_are_not_judged_and_reading_is_no_drive():
    low, high = cases_of("pulses", [pulsed(4.0), pulsed(6.0)])
    judged = np.isfinite(high.recording[RESISTANCE])
    assert not judged[high.drive > 0].any()
    assert judged[high.drive == 0].mean() > 0.95
    assert drive_share(high.recording[HEATER_CURRENT]).max() == pytest.approx(1.0)
    # power, not voltage: the two are as the squares of the voltages
    assert drive_share(low.recording[HEATER_CURRENT]).max() == pytest.approx(16.0 / 36.0)
    assert np.nanmax(high.since_s) < 0.1


def test_one_recording_is_split_in_time_and_drawn():
    time = 0.02 * np.arange(600)
    voltage = 1.8 + 1.8 * np.sin(2 * np.pi * time)
    # bending proportional to the voltage, with a creep that grows with the logarithm of time
    tip = 1e-5 * voltage + 5e-7 * np.log1p(time / 0.5) + 2e-8 * np.random.default_rng(4).normal(size=600)
    trace = Trace("1", Recording(time, {"heater_voltage": voltage, TIP_DEFLECTION: tip}, "piezo"), None, ())
    cases = cases_of("piezo", [trace])
    assert drive_share(cases[0].recording[HEATER_CURRENT]) == pytest.approx(voltage / voltage.max(), abs=1e-9)
    setting = Setting(TIP_DEFLECTION, False, 2, 1e-7, (0.01,), steps=15)
    wanted = [c for c in PIEZO if c.id in ("creep", "logarithmic_creep")]
    found = study_set("piezo", cases, candidates=wanted, setting=setting)
    held = found.folds[0].held[0].recording[TIP_DEFLECTION]
    assert np.count_nonzero(np.isfinite(held)) == 240
    assert not np.isfinite(held[:360]).any()
    law = found.of("logarithmic_creep")
    assert law.gain > 0.8
    assert law.fits[0].values["size"] == pytest.approx(5e-7, rel=0.2)
    for figure in (piezo_figure(found), error_figure(found)):
        assert "<svg" in figure
