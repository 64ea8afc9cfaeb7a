"""The inverse compensation as a node: the library's currents, a real plant, and what it does without usable input."""

import math
from importlib.resources import files

import numpy as np
import pytest
from vo2_control.designs import design_feedforward, reach
from vo2_control.feedforward_node import FeedforwardNode
from vo2_control.reference_node import ReferenceNode
from vo2_interface.model import operating_point
from vo2_interface.parameters import ros_parameters
from vo2_interface.testing import bench
from vo2_models.device import preset
from vo2_plant_sim.plant_node import PlantNode

MS = 1_000_000
UM = 1e-6
POINT = operating_point("integrated")


def graph(*parameters):
    arguments = ["--ros-args"]
    for parameter in parameters:
        arguments += ["-p", parameter]
    return bench(arguments)


def with_model(node, model):
    result = node.set_parameters_atomically(ros_parameters(model))
    assert result.successful, result.reason


def command_of(rig, k, reference=30 * UM):
    """Say measurement and reference of sample k and return the command that answers."""
    rig.say("/vo2/measurement", k * MS, {"heater_current": 0.005})
    rig.say("/vo2/reference", k * MS, {"tip_deflection": reference})
    rig.until(lambda: any(stamp == k * MS for stamp, _ in rig.heard["/vo2/command"]))
    return next(values[0] for stamp, values in rig.heard["/vo2/command"] if stamp == k * MS)


def library(model):
    return design_feedforward(preset="integrated", sample_period_s=1e-3, values=model)


def test_currents_are_those_of_the_library_and_a_repeat_is_answered_alike(fitted_model):
    wanted = [30 * UM, 35 * UM, 35 * UM, 22 * UM, 26 * UM]
    with graph() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        with_model(rig.add(FeedforwardNode), fitted_model)
        got = [command_of(rig, k, reference) for k, reference in enumerate(wanted, 1)]
        assert got == list(library(fitted_model).run(wanted)[0])
        rig.say("/vo2/measurement", 5 * MS, {"heater_current": 0.005})
        rig.until(lambda: len(rig.heard["/vo2/command"]) == 6)
        assert rig.heard["/vo2/command"][-1] == (5 * MS, (got[-1],))


def test_a_command_waits_for_the_reference_of_its_stamp(fitted_model):
    with graph() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        with_model(rig.add(FeedforwardNode), fitted_model)
        rig.say("/vo2/reference", 0, {"tip_deflection": 30 * UM})
        rig.say("/vo2/measurement", MS, {"heater_current": 0.0})
        rig.spin(0.3)
        assert rig.heard["/vo2/command"] == []
        rig.say("/vo2/reference", MS, {"tip_deflection": 30 * UM})
        rig.until(lambda: [stamp for stamp, _ in rig.heard["/vo2/command"]] == [MS])


def test_without_model_the_safe_current_and_one_message_with_the_remedy(fitted_model):
    with graph() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(FeedforwardNode)
        assert [command_of(rig, k) for k in (1, 2, 3)] == [0.0, 0.0, 0.0]
        node._diagnostics.beat()
        rig.until(lambda: "model.device: found none" in rig.status("feedforward: model")[0])
        assert "run the identifier" in rig.status("feedforward: model")[0]
        with_model(node, fitted_model)
        assert command_of(rig, 4) > POINT.lower_a
        rig.until(lambda: "reachable" in rig.status("feedforward: model")[0])


def test_a_model_of_another_preset_is_refused_and_the_former_stays(fitted_model):
    with graph() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        node = rig.add(FeedforwardNode)
        with_model(node, fitted_model)
        first = command_of(rig, 1)
        node._table.set({"model.device": "peltier"})
        assert command_of(rig, 2) != 0.0 and first != 0.0
        rig.until(lambda: "found peltier, need the preset integrated" in rig.status("feedforward: model")[0])


def test_a_model_of_the_device_in_a_file_is_taken_whatever_a_fit_has_completed(fitted_model, tmp_path):
    device = tmp_path / "warm.yaml"
    shipped = (files("vo2_models.device") / "files" / "integrated.yaml").read_text()
    device.write_text(shipped.replace("id: integrated", "id: warm"))
    completed = preset(device).completed({"temperature": {"channel": "stage_temperature"}})
    given = {**fitted_model, "model.device": completed.key}
    found = design_feedforward(preset=str(device), sample_period_s=1e-3, values=given)
    wanted = design_feedforward(preset="integrated", sample_period_s=1e-3, values=fitted_model)
    assert found.run([30e-6] * 5)[0] == pytest.approx(wanted.run([30e-6] * 5)[0])
    with pytest.raises(ValueError, match=r"model\.device: found warm, need the preset peltier"):
        design_feedforward(preset="peltier", sample_period_s=1e-3, values=given)


@pytest.mark.parametrize(("asked", "end"), [(200 * UM, 1), (-50 * UM, 0)])
def test_an_unreachable_reference_is_clipped_and_told(fitted_model, asked, end):
    ahead = library(fitted_model)
    nearest = reach(ahead)[end]
    with graph() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        with_model(rig.add(FeedforwardNode), fitted_model)
        got = [command_of(rig, k, asked) for k in (1, 2, 3)]
        assert got == list(ahead.run([nearest] * 3)[0])
        rig.until(lambda: "outside the reachable" in rig.status("feedforward: reference")[0])
        command_of(rig, 4)
        rig.until(lambda: "again" in rig.status("feedforward: reference")[0])


def test_a_bad_reference_is_held_three_samples_then_the_safe_current_then_it_goes_on(fitted_model):
    with graph() as rig:
        rig.hear("/vo2/command", ("heater_current",))
        with_model(rig.add(FeedforwardNode), fitted_model)
        last = [command_of(rig, k) for k in range(1, 4)][-1]
        assert [command_of(rig, k, math.nan) for k in range(4, 9)] == [last, last, last, 0.0, 0.0]
        rig.until(lambda: "safe current 0 A" in rig.status("feedforward: input")[0])
        assert "is nan: send finite set-points" in rig.status("feedforward: input")[0]
        assert command_of(rig, 9) == library(fitted_model).run([30 * UM])[0][0]
        rig.until(lambda: "loop is closed" in rig.status("feedforward: input")[0])


def test_wall_time_a_plant_that_stops_leads_to_the_safe_current(fitted_model):
    with graph("time:=wall", "rate_hz:=20.0") as rig:
        rig.hear("/vo2/command", ("heater_current",))
        with_model(rig.add(FeedforwardNode), fitted_model)
        rig.say("/vo2/measurement", MS, {"heater_current": 0.0})
        rig.spin(0.8)  # it listens for other commanders
        for k in range(21, 26):  # the measured current follows: the loop closes
            last = command_of(rig, 50 * k)
        assert last > POINT.lower_a
        rig.until(lambda: rig.heard["/vo2/command"][-1][1][0] == 0.0)
        values = [value[0] for _, value in rig.heard["/vo2/command"]]
        assert 3 <= values.count(last) <= 5
        rig.until(lambda: "nothing on measurement" in rig.status("feedforward: input")[0])


def test_a_simulated_plant_follows_the_reference_open_loop(fitted_model):
    """The plant is an ensemble of domains, the model a fit to another recording of the same kind of device."""
    with graph("seed:=2", "true_channels:=true", "run_until_s:=3.0", "signal:=sine") as rig:
        rig.hear("/vo2/measurement", ("true_tip_deflection",))
        rig.hear("/vo2/reference", ("tip_deflection",))
        with_model(rig.add(FeedforwardNode), fitted_model)
        rig.add(ReferenceNode)
        rig.add(PlantNode)
        rig.until(lambda: any(stamp >= 2_900 * MS for stamp, _ in rig.heard["/vo2/measurement"]), 60.0)
        wanted = dict(rig.heard["/vo2/reference"])
        error = np.array(
            [
                value[0] - wanted[stamp][0]
                for stamp, value in rig.heard["/vo2/measurement"]
                if stamp in wanted and stamp > 1_200 * MS
            ]
        )
        assert error.size > 1500
        assert np.sqrt(np.mean(error**2)) < 0.05 * POINT.deflection_range_m
