"""The identifier as a node: plays, records, cancels; a failed fit is told, not hidden."""

import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from vo2_identification.excitation_plan import (
    EXCITATION_PARAMETERS,
    excitation_currents,
    informative_excitation,
)
from vo2_identification.identifier_node import IdentifierNode
from vo2_interface.model import operating_point
from vo2_interface.parameters import ParameterTable
from vo2_interface.samples import SampleWriter
from vo2_interface.testing import bench
from vo2_interface.topics import EMERGENCY_STOP_QOS
from vo2_models.device import truth
from vo2_models.identification.digest import DIGEST_PARAMETERS
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.identification.model_fit import fit_model
from vo2_models.model_file import load_model_parameters, save_model_parameters
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

MS = 1_000_000


def arguments(**parameters):
    found = ["--ros-args"]
    for name, value in parameters.items():
        found += ["-p", f"{name.replace('__', '.')}:={value}"]
    return found


def trigger(rig, service):
    client = rig.node.create_client(Trigger, f"/vo2/identifier/{service}")
    rig.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    rig.until(future.done)
    return future.result()


def state(rig):
    return rig.status("identifier: progress")[1].get("state", "")


@pytest.mark.parametrize("preset", ["integrated", "peltier"])
def test_a_damped_oscillation_starts_and_ends_cold_and_meets_both_ends(preset):
    with bench() as rig:
        table = ParameterTable(rig.node, EXCITATION_PARAMETERS)
        table.set({"excitation.level": 6, "excitation.hold_s": 1.0})
        point = operating_point(preset)
        currents = excitation_currents(preset, 1.0 / point.rate_hz, table)
    assert currents[0] == currents[-1] == point.cold_a
    assert {round(currents.min(), 9), round(currents.max(), 9)} == {
        round(point.lower_a, 9),
        round(point.upper_a, 9),
    }
    assert np.all(np.diff(np.flatnonzero(np.diff(currents)))[1:-1] == round(point.rate_hz))


def test_it_answers_every_measurement_with_the_next_level_and_keeps_what_it_heard():
    with bench(arguments(excitation__kind="levels", excitation__levels_a="[0.004, 0.008]", excitation__hold_s="0.002",
                         excitation__cold_s="0.001", fit="false")) as rig:  # fmt: skip
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(IdentifierNode)
        assert "6 samples" in trigger(rig, "start").message
        for k in range(7):
            rig.say("/vo2/measurement", k * MS, {"heater_current": 0.001 * k, "film_resistance": 1e5})
        rig.until(lambda: state(rig) == "done")
        cold = operating_point("integrated").cold_a
        assert rig.heard["/vo2/command"] == [
            (k * MS, (level,)) for k, level in enumerate([cold, 0.004, 0.004, 0.008, 0.008, cold])
        ]
        assert len(node._last_recording) == 7
        np.testing.assert_allclose(node._last_recording["heater_current"], 0.001 * np.arange(7))


def test_a_second_start_is_refused_until_cancelled():
    with bench(arguments()) as rig:
        rig.add(IdentifierNode)
        assert trigger(rig, "start").success
        refused = trigger(rig, "start")
        assert not refused.success
        assert "cancel" in refused.message
        assert trigger(rig, "cancel").success
        assert not trigger(rig, "cancel").success
        assert trigger(rig, "start").success


def test_a_model_of_another_device_is_refused_at_the_start_and_at_run_time():
    wrong = "found integrated, need the preset peltier"
    with (
        bench(arguments(preset="peltier", model__device="integrated")) as rig,
        pytest.raises(ValueError, match=wrong),
    ):
        rig.add(IdentifierNode)
    with bench(arguments(preset="peltier")) as rig:
        node = rig.add(IdentifierNode)
        (refused,) = node.set_parameters([Parameter("model.device", value="integrated")])
        assert not refused.successful and "need the preset peltier" in refused.reason
        (taken,) = node.set_parameters([Parameter("model.device", value="peltier")])
        assert taken.successful


def test_a_sample_that_comes_late_is_dropped_and_counted():
    with bench(arguments(excitation__kind="listen", fit="false", quiet_s="0.3")) as rig:
        node = rig.add(IdentifierNode)
        trigger(rig, "start")
        for stamp in (4, 5, 4, 6):
            rig.say("/vo2/measurement", stamp * MS, {"heater_current": 0.0, "film_resistance": 1e5})
        rig.until(lambda: state(rig) == "done")
        assert "came late and were dropped" in rig.status("identifier: late")[0]
        np.testing.assert_allclose(node._last_recording.time_s, [0.004, 0.005, 0.006])


def test_a_source_that_starts_anew_fails_the_recording_with_the_remedy():
    with bench(arguments()) as rig:
        rig.add(IdentifierNode)
        trigger(rig, "start")
        rig.say("/vo2/measurement", 5000 * MS, {"heater_current": 0.0, "film_resistance": 1e5})
        for stamp in range(1, 40):
            rig.say("/vo2/measurement", stamp * MS, {"heater_current": 0.0, "film_resistance": 1e5})
        rig.until(lambda: state(rig) == "failed")
        assert "jumped back" in rig.status("identifier: progress")[0]
        assert "start again" in rig.status("identifier: progress")[0]


def test_an_absent_current_fails_at_once():
    with bench(arguments()) as rig:
        rig.add(IdentifierNode)
        trigger(rig, "start")
        rig.say("/vo2/measurement", 5 * MS, {"film_resistance": 1e5})
        rig.until(lambda: state(rig) == "failed")
        assert "heater_current" in rig.status("identifier: progress")[0]


def test_a_recording_that_cannot_be_fitted_is_told():
    with bench(arguments(excitation__kind="listen", quiet_s="0.3")) as rig:
        rig.add(IdentifierNode)
        trigger(rig, "start")
        for k in range(20):
            rig.say("/vo2/measurement", k * MS, {"heater_current": 0.005, "film_resistance": 1e5})
        rig.until(lambda: state(rig) == "failed", timeout_s=60.0)
        assert "cannot be fitted" in rig.status("identifier: progress")[0]


@pytest.mark.parametrize("preset", ["integrated", "peltier"])
@pytest.mark.parametrize("cold_samples", [0, 30])
def test_the_informative_excitation_gives_ten_thousand_samples_over_the_whole_range(preset, cold_samples):
    point = operating_point(preset)
    with bench() as rig:
        table = ParameterTable(rig.node, EXCITATION_PARAMETERS)
        table.set(
            {
                "excitation.kind": "informative",
                "excitation.cold_s": cold_samples / point.rate_hz,
                "excitation.seed": 5,
            }
        )
        currents = excitation_currents(preset, 1.0 / point.rate_hz, table)
        table.set({"excitation.duration_s": 600.0 / point.rate_hz})
        short = excitation_currents(preset, 1.0 / point.rate_hz, table)
    # one sample before the first current
    assert currents.size == 9_999
    assert 600 <= short.size - 2 * max(cold_samples, 1) <= 640
    # the ends of ramps lie between samples
    ends = [point.lower_a, point.upper_a]
    assert [currents.min(), currents.max()] == pytest.approx(ends, abs=0.01 * (point.upper_a - point.lower_a))
    assert currents[0] == currents[-1] == point.cold_a


def diagnosis(rig):
    return rig.status("identifier: diagnosis")


def listened(rig, recording):
    """Let the identifier listen to a recording, sample by sample."""
    node = rig.add(IdentifierNode)
    assert trigger(rig, "start").success
    names = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)
    columns = np.stack([recording[name] for name in names], axis=1)
    for k, row in enumerate(columns.tolist()):
        rig.say("/vo2/measurement", (k + 1) * MS, dict(zip(names, row, strict=True)))
        if k % 50 == 49:
            rig.until(lambda heard=k + 1: len(node._log) == heard)
    rig.until(lambda: state(rig) in ("done", "failed"), timeout_s=120.0)
    return node


def played(current, seed, effects=None):
    return truth("integrated", seed=11, effects=effects or {}).simulate(current, seed=seed)


def test_a_diagnosis_without_recording_or_model_is_refused_with_what_is_needed():
    with bench(arguments(excitation__kind="listen", fit="false", quiet_s="0.3")) as rig:
        node = rig.add(IdentifierNode)
        refused = trigger(rig, "diagnose")
        assert not refused.success
        assert "found no recording" in refused.message
        assert "~/start" in refused.message
        node._last_recording = Recording(np.arange(20) * 1e-3, {HEATER_CURRENT: np.full(20, 5e-3)})
        refused = trigger(rig, "diagnose")
        assert not refused.success
        assert "found no model" in refused.message


def test_a_diagnosis_is_refused_while_recording():
    with bench(arguments(excitation__kind="listen", model__device="integrated")) as rig:
        rig.add(IdentifierNode)
        assert trigger(rig, "start").success
        refused = trigger(rig, "diagnose")
        assert not refused.success
        assert "busy (listening)" in refused.message


def test_a_recording_that_cannot_be_diagnosed_is_told_with_the_reason():
    with bench(
        arguments(excitation__kind="listen", fit="false", quiet_s="0.3", model__device="integrated")
    ) as rig:
        node = listened(rig, played(np.full(20, 5e-3), 1))
        answer = trigger(rig, "diagnose")
        assert answer.success
        assert "20 samples" in answer.message
        rig.until(lambda: diagnosis(rig)[1].get("state") == "failed", timeout_s=60.0)
        assert "cannot be diagnosed" in diagnosis(rig)[0]
        # and the next one may be tried
        assert trigger(rig, "diagnose").success
        rig.until(lambda: node._diagnosis is None, timeout_s=60.0)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    """A model fitted to the oscillation that the identifier plays by itself."""
    point = operating_point("integrated")
    levels = point.cold_a + (point.hot_a - point.cold_a) * damped_oscillation(np.linspace(0.0, 1.0, 31))
    excited = played(np.repeat(levels, 10), 1)
    names = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)
    recording = Recording(excited.time_s, {name: excited[name] for name in names}, "integrated")
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    save_model_parameters(path, fit_model([recording], "integrated", plays=12, self_sensing=False)[1])
    return path


def test_a_running_diagnosis_can_be_cancelled_and_started_again(model_file):
    current = informative_excitation("integrated", 0.6, 1e-3, seed=4).sample(1e-3)
    ros = [
        *arguments(excitation__kind="listen", fit="false", quiet_s="0.3"),
        "--params-file",
        str(model_file),
    ]
    with bench(ros) as rig:
        node = listened(rig, played(current, 3))
        assert trigger(rig, "diagnose").success
        job = node._diagnosis
        answer = trigger(rig, "cancel")
        assert answer.success
        assert answer.message == "cancelled while diagnosing"
        rig.until(lambda: diagnosis(rig)[1].get("state") == "cancelled")
        assert state(rig) == "done"
        # the thread ends at its next step, without an answer
        rig.until(lambda: not job.running, timeout_s=120.0)
        assert job.answer is None
        assert not trigger(rig, "cancel").success
        assert trigger(rig, "diagnose").success
        job = node._diagnosis
        assert trigger(rig, "cancel").success
        rig.until(lambda: not job.running, timeout_s=120.0)


@pytest.mark.slow
def test_a_concealed_effect_is_named_on_diagnostics(model_file):
    current = informative_excitation("integrated", 4.0, 1e-3, seed=4).sample(1e-3)
    changed = played(current, 3, {"creep": {"share": 0.06, "time_constant": 0.2}})
    ros = [
        *arguments(excitation__kind="listen", fit="false", quiet_s="1.0"),
        "--params-file",
        str(model_file),
    ]
    with bench(ros) as rig:
        node = listened(rig, changed)
        found = load_model_parameters(model_file)
        kept = {record.name for record in DIGEST_PARAMETERS if found.get(record.name)}
        assert kept
        assert kept <= set(node._table.given("model."))
        assert trigger(rig, "diagnose").success
        rig.until(lambda: diagnosis(rig)[1].get("state") in ("done", "failed"), timeout_s=300.0)
        text, values = diagnosis(rig)
        assert values["verdict"] == "differs"
        assert values["effects"] == "creep"
        assert float(values["creep probability"]) > 0.5
        share, deviation = (float(part) for part in values["creep share"].split(" +- "))
        assert share == pytest.approx(0.06, rel=0.15)
        assert 0.0 < deviation < 0.01
        assert "creep" in text


def test_an_emergency_stop_ends_an_excitation_with_the_next_sample_and_bars_another():
    with bench(arguments(excitation__kind="levels", excitation__levels_a="[0.004]", fit="false")) as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.add(IdentifierNode)
        assert trigger(rig, "start").success
        rig.say("/vo2/measurement", MS, {"heater_current": 0.004})
        rig.until(lambda: rig.heard["/vo2/command"])
        button = rig.node.create_publisher(Bool, "/vo2/emergency_stop", EMERGENCY_STOP_QOS)
        button.publish(Bool(data=True))
        rig.until(lambda: "stopped" in rig.status("identifier: emergency stop")[0])
        rig.say("/vo2/measurement", 2 * MS, {"heater_current": 0.004})
        rig.until(lambda: state(rig) == "failed")
        rig.until(lambda: rig.heard["/vo2/command"][-1] == (2 * MS, (0.0,)))
        assert "release it first" in trigger(rig, "start").message


def test_malformed_measurements_do_not_end_it():
    with bench(arguments(excitation__kind="listen", fit="false", quiet_s="0.3")) as rig:
        node = rig.add(IdentifierNode)
        assert trigger(rig, "start").success
        rig.say("/vo2/measurement", MS, {"heater_current": 0.004})
        publisher = rig.node.create_publisher(JointState, "/vo2/measurement", 10)
        rig.until(lambda: publisher.get_subscription_count() == 1)
        rig.spin(0.2)
        publisher.publish(SampleWriter(("heater_current",)).write(2 * MS, (0.004,))[:30])
        rig.until(lambda: "cut short" in rig.status("identifier: input measurement")[0])
        rig.say("/vo2/measurement", 3 * MS, {"heater_current": 0.004})
        rig.until(lambda: state(rig) == "done")
        assert len(node._last_recording) == 2
