"""The demo's own pieces: errors as the contract defines them, the sample log, the page, the acts' list."""

import numpy as np
import pytest
from vo2_identification.demo.acts import ACTS, act
from vo2_identification.demo.errors import TRUE_DEFLECTION, estimation_error, phase_data, tracking_error
from vo2_identification.demo.stage import Phase
from vo2_identification.report.figures import figure_html, new_figure
from vo2_identification.report.page import page, section, table
from vo2_identification.sample_log import SampleLog
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, TIP_DEFLECTION, Recording

PHASE = Phase("steps", "/vo2", 2.0, 2.1)


def loop(estimate_error=0.0, reference_error=0.0, drop=()):
    """A loop of 1 kHz from 1 s to 3 s whose true deflection is a ramp, with constant errors of estimate and reference."""
    time = 1.0 + np.arange(2001) * 1e-3
    kept = np.setdiff1d(np.arange(time.size), drop)
    true = time * 1e-5
    return {
        "measurement": Recording(time, {TRUE_DEFLECTION: true, HEATER_CURRENT: np.full(time.size, 0.006)}),
        "estimate": Recording(time[kept], {TIP_DEFLECTION: true[kept] + estimate_error}),
        "reference": Recording(time, {TIP_DEFLECTION: true + np.where(time < 2.0055, 1.0, reference_error)}),
    }


def test_errors_of_a_phase_are_mean_absolute_and_leave_out_the_first_five_per_cent():
    data = phase_data(loop(estimate_error=-2e-6, reference_error=3e-6), PHASE)
    assert data.time_s.size == 100
    assert data.time_s[0] == pytest.approx(1e-3)
    assert estimation_error(data) == pytest.approx(2e-6)
    # the reference is a metre off in the first five samples of a hundred
    assert tracking_error(data) == pytest.approx(3e-6)


def test_a_missing_sample_is_an_error_with_its_place_and_not_a_smaller_mean():
    with pytest.raises(ValueError, match=r"steps: estimate lacks 2 samples, the first at 2\.01"):
        phase_data(loop(drop=(1010, 1011)), PHASE)


def test_a_missing_topic_is_named():
    recordings = loop()
    del recordings["estimate"]
    with pytest.raises(ValueError, match="found no estimate"):
        phase_data(recordings, PHASE)


def test_an_estimate_that_is_not_a_number_is_not_averaged_away():
    with pytest.raises(ValueError, match="100 samples have no estimate"):
        estimation_error(phase_data(loop(estimate_error=np.nan), PHASE))


def test_sample_log_files_a_command_under_the_interval_that_it_governs():
    log = SampleLog(("heater_current", "film_resistance", "tip_deflection"))
    for k in range(3):
        log.append(k * 1_000_000, (0.1 * k, 5.0 + k, float("nan")), command_a=10.0 + k)
    recording = log.recording("integrated")
    assert set(recording.channels) == {"heater_current", "film_resistance", COMMANDED_CURRENT}
    np.testing.assert_array_equal(recording[COMMANDED_CURRENT], [np.nan, 10.0, 11.0])
    np.testing.assert_allclose(recording.time_s, [0.0, 1e-3, 2e-3])


def test_sample_log_of_one_sample_is_refused():
    log = SampleLog(("heater_current",))
    log.append(0, (0.0,))
    with pytest.raises(ValueError, match="need at least 2"):
        log.recording("integrated")


def test_page_is_self_contained_and_escapes_what_it_is_given():
    with new_figure() as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [1, 0])
        svg = figure_html(figure, 'A "line" & more')
    text = page("<title>", "a & b", [section("S", table("cap", ["x"], [["<td>"]]), svg)])
    assert text.startswith("<!doctype html>")
    assert "&lt;title&gt;" in text
    assert "<td>&lt;td&gt;</td>" in text
    assert "<svg role=" in text
    assert "src=" not in text
    assert "<link" not in text


def test_every_act_can_be_found():
    assert len(set(ACTS)) == len(ACTS) > 4
    assert all(callable(act(name)) for name in ACTS)
