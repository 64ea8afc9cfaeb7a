"""The identifier as a node: plays, records, cancels; a failed fit is told, not hidden."""

import numpy as np
import pytest
from std_srvs.srv import Trigger
from vo2_identification.excitation_plan import EXCITATION_PARAMETERS, excitation_currents
from vo2_identification.identifier_node import IdentifierNode
from vo2_plant_sim.interface.model import operating_point
from vo2_plant_sim.interface.parameters import ParameterTable
from vo2_plant_sim.testing import bench

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


def test_a_stamp_that_jumps_back_fails_the_recording_with_the_remedy():
    with bench(arguments()) as rig:
        rig.add(IdentifierNode)
        trigger(rig, "start")
        rig.say("/vo2/measurement", 5 * MS, {"heater_current": 0.0, "film_resistance": 1e5})
        rig.say("/vo2/measurement", 4 * MS, {"heater_current": 0.0, "film_resistance": 1e5})
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
