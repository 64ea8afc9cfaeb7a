"""Another day is not new physics: constants that move are told as that, alone and beside an effect."""

import re

import numpy as np
import pytest
from concealed_devices import DEVICE, SEED, calibrated, concealed, measured
from vo2_models.device import DeviceModel, preset, truth
from vo2_models.device.coefficients import Coefficient
from vo2_models.diagnosis import diagnose, study, validate
from vo2_models.diagnosis import read as reading
from vo2_models.diagnosis.files import write_results
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import locate
from vo2_models.diagnosis.moved_alone import constants_leave, left_by, moved_alone
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.page import report_page
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.read import read
from vo2_models.diagnosis.report import assemble_diagnosis
from vo2_models.model_file import load_model_parameters
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

WARMER = ((Coefficient.AMBIENT, 1.0, 0.5),)


@pytest.fixture(scope="module")
def parameters():
    return calibrated()


def _read(recording: Recording, **factors: tuple[float, float]) -> Recording:
    """The recording of sensors with another gain and zero: channel -> (gain, zero)."""
    changed = {name: gain * recording[name] + zero for name, (gain, zero) in factors.items()}
    return Recording(recording.time_s, {**recording.channels, **changed}, recording.device)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_room_half_a_kelvin_off_is_a_drift_of_the_ambient(parameters, sign) -> None:
    answer = diagnose([concealed(moved=((Coefficient.AMBIENT, 1.0, 0.5 * sign),))], parameters)
    assert answer.verdict == "drifted" and answer.effects == []
    first = answer.moved[0]
    assert (first.constant, first.unit) == ("thermal.ambient", "degC")
    assert first.now - first.was == pytest.approx(0.5 * sign, abs=0.06)
    assert first.std < 0.05
    plain = answer.to_dict()
    validate(plain)
    assert plain["moved"][0]["is"] == first.now
    assert all("provenance" in limit for limit in plain["decision_limits"].values())


@pytest.mark.slow
@pytest.mark.parametrize("kelvin", [-4.0, 6.0])
def test_a_room_some_kelvin_off_is_no_laser_that_heats_all_the_time(parameters, kelvin) -> None:
    answer = diagnose([concealed(moved=((Coefficient.AMBIENT, 1.0, kelvin),))], parameters)
    assert answer.verdict == "drifted" and answer.effects == []
    (moved,) = answer.moved
    assert moved.constant == "thermal.ambient"
    assert moved.now - moved.was == pytest.approx(kelvin, abs=3.0 * moved.std)
    assert moved.std < 0.5


def test_of_a_recording_beyond_the_memory_the_beginning_is_judged(parameters, monkeypatch) -> None:
    recording = concealed(samples=900)
    monkeypatch.setattr(reading, "BYTES_A_SAMPLE", reading.BYTES_A_SAMPLE * reading._most_samples() / 600.0)
    seen = read(
        [recording], Nominal.from_parameters(parameters), ("long",), Limits(), Clock(lambda *_: None, 1)
    )
    assert abs(seen.parts[0].size - 600) <= 1
    assert seen.findings[0].text.startswith(
        f"long: of {len(recording)} samples the first {seen.parts[0].size} are"
    )


PAST = np.linspace(0.0, 1.0, 1000)


@pytest.mark.slow
@pytest.mark.parametrize(
    "room",
    [
        pytest.param(2.0 * np.sin(5.0 * np.pi * PAST + 1.0), id="swings"),
        pytest.param(3.0 * (1.0 - np.exp(-5.0 * PAST)), id="warms up"),
        pytest.param(1.5 / (1.0 + np.exp(-40.0 * (PAST - 0.5))), id="steps"),
    ],
)
def test_a_room_that_moves_by_kelvins_within_a_recording_is_named_with_its_course(parameters, room) -> None:
    seen = study([concealed(room=room)], parameters)
    answer = assemble_diagnosis(seen)
    (effect,) = answer.effects
    assert (answer.verdict, effect.id, answer.moved) == ("differs", "ambient_drift", [])
    assert "Course of ambient_drift over the time" in report_page(seen, answer)
    low, high = map(float, re.search(r"course in time from (\S+) to (\S+) K", effect.form).groups())
    assert low == pytest.approx(room.min(), abs=0.3) and high == pytest.approx(room.max(), abs=0.3)
    (even,) = [text for text in answer.limits if text.startswith("ambient_drift begins at")]
    assert "may be a constant that has moved" in even


@pytest.mark.slow
def test_a_second_body_is_no_course_of_the_room(parameters) -> None:
    slow = {"second_thermal_mode": {"time_constant": 0.5, "share": 0.06, "gain": 0.06}}
    (effect,) = diagnose([concealed(slow)], parameters).effects
    assert effect.id == "second_thermal_mode"


@pytest.mark.slow
def test_sensors_set_anew_are_told_apart(parameters) -> None:
    answer = diagnose(
        [_read(concealed(), **{TIP_DEFLECTION: (1.0, 3e-7), RESISTANCE: (1.02, 0.0)})], parameters
    )
    assert answer.verdict == "drifted"
    moved = {m.constant: m for m in answer.moved}
    assert set(moved) == {"deflection.zero", "resistance.gain"}
    assert moved["deflection.zero"].now == pytest.approx(3e-7, rel=0.15)
    assert moved["resistance.gain"].now == pytest.approx(1.02, abs=0.004)


@pytest.mark.slow
def test_the_corrected_model_has_the_moved_constants(parameters, tmp_path) -> None:
    changed = _read(concealed(moved=WARMER), **{TIP_DEFLECTION: (1.03, 3e-7)})
    answer = write_results(study([changed], parameters), tmp_path)
    assert answer.verdict == "drifted" and answer.effects == []
    moved = {m.constant: m for m in answer.moved}
    assert {"thermal.ambient", "deflection.zero"} <= set(moved)
    assert moved["thermal.ambient"].unit == "degC" and moved["thermal.ambient"].std < 0.05
    plain = answer.to_dict()
    validate(plain)
    assert all("provenance" in limit for limit in plain["decision_limits"].values())
    corrected = load_model_parameters(tmp_path / "corrected_model.yaml")
    assert corrected["model.thermal.ambient"] == pytest.approx(
        parameters["model.thermal.ambient"] + 0.5, abs=0.08
    )
    miss = [
        np.std(
            changed[TIP_DEFLECTION]
            - DeviceModel.from_parameters(m).simulate(changed[HEATER_CURRENT], noise=False)[TIP_DEFLECTION]
        )
        for m in (parameters, corrected)
    ]
    assert miss[1] < 0.6 * miss[0]
    assert "thermal.ambient" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_an_effect_beside_a_drift_is_named_and_the_drift_told(parameters) -> None:
    creep = {"creep": {"share": 0.06, "time_constant": 0.2}}
    answer = diagnose([concealed(creep, moved=WARMER)], parameters)
    assert answer.verdict == "differs"
    assert [(e.id, e.family) for e in answer.effects] == [("creep", "structure")]
    (room,) = [m for m in answer.moved if m.constant == "thermal.ambient"]
    assert room.now - room.was == pytest.approx(0.5, abs=0.08) and len(answer.moved) < 3


@pytest.mark.slow
def test_what_has_no_name_has_a_family(parameters) -> None:
    plain = concealed()
    hum = 0.02 * np.sin(2 * np.pi * 18.0 * plain.time_s)
    film = {**plain.channels, RESISTANCE: plain[RESISTANCE] * np.exp(hum)}
    answer = diagnose([Recording(plain.time_s, film, DEVICE)], parameters)
    assert [(e.id, e.family) for e in answer.effects] == [("unknown", f"sensor:{RESISTANCE}")]
    assert "18" in answer.effects[0].form


@pytest.mark.parametrize("periods", [-1, pytest.param(1, marks=pytest.mark.slow)])
def test_commands_stamped_at_the_other_end_of_their_interval_are_found(parameters, periods) -> None:
    plain = concealed()
    place = np.clip(np.arange(len(plain)) + periods, 0, len(plain) - 1)
    current = {**plain.channels, HEATER_CURRENT: plain[HEATER_CURRENT][place]}
    answer = diagnose([Recording(plain.time_s, current, DEVICE)], parameters)
    assert answer.verdict == "agrees"
    assert any("command_delay" in text and f"{1e-3 * periods:+.4g} s" in text for text in answer.limits)


@pytest.mark.slow
def test_a_dead_time_is_no_stamp(parameters) -> None:
    answer = diagnose([concealed({"dead_time": {"delay": 1.5e-3}})], parameters)
    assert [(e.id, e.family) for e in answer.effects] == [("dead_time", "drive")]
    assert not any("command_delay" in text for text in answer.limits)


@pytest.mark.parametrize("periods", [pytest.param(0.6, marks=pytest.mark.slow), 1.5])
def test_commands_stamped_late_by_a_fraction_are_moved_to_where_they_act(parameters, periods) -> None:
    nominal = preset(DEVICE)
    stamped = np.random.default_rng(2).uniform(*sorted(nominal.operating_range), 80).repeat(15)
    # a command that stands too late has acted before: what flows is partly the next one
    ends = np.arange(stamped.size + 1.0)
    charge = np.interp(ends + periods, ends, np.concatenate([[0.0], np.cumsum(stamped)]))
    flows = np.append(np.diff(charge)[:-3], stamped[-3:])
    seen = measured(truth(DEVICE, seed=SEED).simulate(flows, seed=3))
    recording = Recording(seen.time_s, {**seen.channels, HEATER_CURRENT: stamped}, DEVICE)
    reading = read([recording], Nominal.from_parameters(parameters), (), Limits(), Clock(lambda *_: None, 1))
    told = [f.text for f in reading.findings if f.kind == "stamps"]
    assert len(told) == 1
    delay = float(re.search(r"command_delay (\S+) s", told[0])[1])  # type: ignore[index]
    assert delay == pytest.approx(-1e-3 * periods, abs=0.05e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("moved", "name", "by"),
    [
        ((Coefficient.SQUARE_GAIN, 1.03, 0.0), "thermal.square_gain", 0.03 * 1.01e6),
        ((Coefficient.AMBIENT, 1.0, 1.5), "thermal.ambient", 1.5),
    ],
)
def test_a_constant_that_explains_a_recording_by_itself_is_told_with_loops_as_they_were(
    parameters, moved, name, by
) -> None:
    def alone(recording: Recording):
        limits, clock = Limits(), Clock(lambda share, text: None, 700)
        reading = read([recording], Nominal.from_parameters(parameters), (), limits, clock, calibrations=0)
        return moved_alone(locate(reading, limits, clock).problem, limits)

    drift = alone(concealed(moved=(moved,)))
    assert drift is not None and [c.name for c in drift.constants] == [name]
    assert 0.0 < drift.std[0] < 0.2 * by
    assert drift.move[0] == pytest.approx(by, abs=2.5 * drift.std[0])
    # the loops' own misfit is no move, and an effect of the response is none of these constants
    assert alone(concealed()) is None
    assert alone(concealed({"creep": {"share": 0.06, "time_constant": 0.2}})) is None


def test_a_moved_time_constant_is_no_slow_body_of_that_time(parameters) -> None:
    """What two constants do leaves no more than an effect with three parameters that stands for them."""
    moved = ((Coefficient.TIME_CONSTANT, 1.04, 0.0), (Coefficient.AMBIENT, 1.0, 0.3))
    limits, clock = Limits(), Clock(lambda share, text: None, 700)
    nominal = Nominal.from_parameters(parameters)
    found = read([concealed(moved=moved)], nominal, (), limits, clock, calibrations=0)
    problem = locate(found, limits, clock).problem
    unmoved = np.zeros(problem.origin.size)
    nothing, one, two = (constants_leave(problem, most) for most in (0, 1, 2))
    assert nothing == pytest.approx(left_by(problem, {}, unmoved))
    assert two < one < nothing
    tau = preset(DEVICE).time_constant
    slow = {"second_thermal_mode": {"time_constant": 0.92 * tau, "share": -0.5, "gain": 0.0}}
    assert two < left_by(problem, slow, unmoved)
