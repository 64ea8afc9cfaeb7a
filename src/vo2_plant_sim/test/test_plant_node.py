"""The plant as a node: lockstep answers, repeats, standing still, wall time with the safe current."""

import itertools
from importlib.resources import files

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from vo2_interface.testing import bench
from vo2_models.device import preset, truth
from vo2_plant_sim.plant_node import PlantNode

CHANNELS = ("heater_current", "film_resistance", "tip_deflection")
MS = 1_000_000
S = 1_000_000_000


def lockstep(*parameters):
    arguments = ["--ros-args"]
    for parameter in parameters:
        arguments += ["-p", parameter]
    return bench(arguments)


def test_each_command_advances_one_sample_with_the_values_of_the_library():
    currents = [0.004, 0.006, 0.008, 0.008, 0.005]
    with lockstep("seed:=3") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        for k, current in enumerate(currents):
            rig.say("/vo2/command", S + k * MS, {"heater_current": current})
            rig.until(lambda k=k: rig.heard["/vo2/measurement"][-1][0] == S + (k + 1) * MS)
        heard = dict(rig.heard["/vo2/measurement"])
    stepper = truth("integrated", seed=3).stepper(seed=4)
    for k, current in enumerate([0.0, *currents]):
        assert heard[S + k * MS] == tuple(stepper.step(current))


def test_before_the_first_command_the_safe_current_of_the_device_file_flows(tmp_path):
    device = tmp_path / "warm.yaml"
    shipped = (files("vo2_models.device") / "files" / "integrated.yaml").read_text()
    device.write_text(shipped.replace("safe: 0.0", "safe: 2.0e-3").replace("id: integrated", "id: warm"))
    with lockstep(f"preset:={device}", "noise:=false") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        assert rig.heard["/vo2/measurement"][0][1][0] == 2.0e-3


def test_the_noise_has_a_seed_of_its_own_and_the_device_does_not_change_with_it():
    heard = {}
    for given in ((), ("noise_seed:=4",), ("noise_seed:=9",)):
        with lockstep("seed:=3", "true_channels:=true", *given) as rig:
            rig.hear("/vo2/measurement", (*CHANNELS, "true_tip_deflection"))
            rig.add(PlantNode)
            rig.until(lambda rig=rig: rig.heard["/vo2/measurement"])
            rig.say("/vo2/command", S, {"heater_current": 0.006})
            rig.until(lambda rig=rig: rig.heard["/vo2/measurement"][-1][0] == S + MS)
            heard[given] = rig.heard["/vo2/measurement"][-1][1]
    # by default the seed after the device's
    assert heard[()] == heard["noise_seed:=4",]
    assert heard["noise_seed:=9",][1] != heard[()][1]
    assert heard["noise_seed:=9",][3] == heard[()][3]


def test_an_unanswered_sample_is_repeated_and_an_old_or_second_answer_changes_nothing(monkeypatch):
    monkeypatch.setattr("vo2_plant_sim.plant_node._OVER_S", 0.3)
    with lockstep() as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: len(rig.heard["/vo2/measurement"]) >= 3)
        assert len(set(rig.heard["/vo2/measurement"])) == 1
        rig.say("/vo2/command", S, {"heater_current": 0.005})
        rig.say("/vo2/command", S, {"heater_current": 0.012})
        rig.say("/vo2/command", S - MS, {"heater_current": 0.012})
        rig.until(lambda: rig.heard["/vo2/measurement"][-1][0] == S + MS)
        rig.spin(0.5)
        assert rig.heard["/vo2/measurement"][-1][0] == S + MS
        assert rig.heard["/vo2/measurement"][-1][1][0] == pytest.approx(0.005, abs=1e-4)
        assert "two different commands" in rig.status("plant: command")[0]
        rig.say("/vo2/command", S + MS, {"heater_current": 0.005})
        rig.until(lambda: "one command for each measurement again" in rig.status("plant: command")[0])


def test_simulated_time_stands_still_at_run_until_and_goes_on_when_it_is_raised():
    with lockstep("run_until_s:=1.002") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        plant = rig.add(PlantNode)
        answered: set[int] = set()

        def answer_all(until_ns):
            for stamp_ns, _ in list(rig.heard["/vo2/measurement"]):
                if stamp_ns not in answered:
                    answered.add(stamp_ns)
                    rig.say("/vo2/command", stamp_ns, {"heater_current": 0.006})
            return rig.heard["/vo2/measurement"] and rig.heard["/vo2/measurement"][-1][0] >= until_ns

        rig.until(lambda: answer_all(S + 2 * MS))
        rig.until(
            lambda: answer_all(S + 2 * MS) and rig.status("plant: time")[1].get("stamp_s") == "1.002000000"
        )
        rig.spin(0.4)
        assert rig.heard["/vo2/measurement"][-1][0] == S + 2 * MS
        plant._table.set({"run_until_s": 0.0})
        rig.until(lambda: answer_all(S + 6 * MS))


def test_a_command_that_is_not_a_number_leads_to_the_safe_current():
    with lockstep() as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        rig.say("/vo2/command", S, {"heater_current": float("nan")})
        rig.until(lambda: rig.heard["/vo2/measurement"][-1][0] == S + MS)
        assert rig.heard["/vo2/measurement"][-1][1][0] == pytest.approx(0.0, abs=1e-4)
        rig.until(lambda: "heater_current on command is nan" in rig.status("plant: command")[0])


def test_wall_time_keeps_the_pace_and_takes_the_safe_current_after_three_periods_without_command():
    with lockstep("time:=wall", "rate_hz:=20.0") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        for _ in range(4):
            count = len(rig.heard["/vo2/measurement"])
            answered = rig.heard["/vo2/measurement"][-1][0]
            rig.say("/vo2/command", answered, {"heater_current": 0.006})
            rig.until(lambda count=count: len(rig.heard["/vo2/measurement"]) > count)
        rig.until(lambda: rig.heard["/vo2/measurement"][-1][0] >= answered + 10 * 50 * MS)
        # by stamps: a machine that stands still for a while skips samples
        currents = [
            ((stamp - answered) // (50 * MS), values[0]) for stamp, values in rig.heard["/vo2/measurement"]
        ]
        assert all(i == pytest.approx(0.006, abs=2e-4) for periods, i in currents if 2 <= periods <= 3)
        assert all(i == pytest.approx(0.0, abs=1e-4) for periods, i in currents if periods >= 8)
        assert currents[-1][0] >= 10
        stamps = [stamp for stamp, _ in rig.heard["/vo2/measurement"]]
        steps = {after - before for before, after in itertools.pairwise(stamps)}
        assert all(step % (50 * MS) == 0 for step in steps)
        assert "safe current" in rig.status("plant: command")[0]


def test_the_plant_repeats_itself_on_the_clock_that_it_publishes_itself():
    with lockstep("use_sim_time:=true") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        plant = rig.add(PlantNode)
        rig.until(lambda: len(rig.heard["/vo2/measurement"]) >= 3)
        assert plant.get_parameter("use_sim_time").value is True
        rig.say("/vo2/command", S, {"heater_current": 0.005})
        rig.until(lambda: rig.heard["/vo2/measurement"][-1][0] == S + MS)


def test_simulated_time_begins_where_it_is_told_to():
    with lockstep("start_s:=1700000000.25") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        start = 1_700_000_000_250 * MS
        assert rig.heard["/vo2/measurement"][0][0] == start
        rig.say("/vo2/command", start, {"heater_current": 0.005})
        rig.until(lambda: rig.heard["/vo2/measurement"][-1][0] == start + MS)


def test_a_stopped_plant_applies_the_safe_current_from_the_next_sample_on():
    with lockstep() as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        stop = rig.node.create_client(SetBool, "/vo2/plant/emergency_stop")
        rig.until(lambda: rig.heard["/vo2/measurement"] and stop.service_is_ready())
        for k, (stopped, expected) in enumerate([(False, 0.006), (True, 0.0), (True, 0.0), (False, 0.006)]):
            # a release counts once the topic brings it back, see EmergencyStop
            answer = stop.call_async(SetBool.Request(data=stopped))
            rig.until(answer.done)
            rig.spin(0.2)
            rig.say("/vo2/command", S + k * MS, {"heater_current": 0.006})
            rig.until(lambda k=k: rig.heard["/vo2/measurement"][-1][0] == S + (k + 1) * MS)
            assert rig.heard["/vo2/measurement"][-1][1][0] == pytest.approx(expected, abs=2e-4)


def test_another_clock_and_commands_from_another_run_are_told_once():
    with lockstep() as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.node.create_publisher(Clock, "/clock", 10)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        for k in range(20):
            rig.say("/vo2/command", 5 * S + k * MS, {"heater_current": 0.006})
        rig.until(lambda: "1 more on /clock" in rig.status("plant: clock")[0])
        rig.spin(1.5)
        told = [
            name.rsplit(": ")[-1] for name, text, _ in rig.statuses if "ahead" in text or "more on" in text
        ]
        assert sorted(told) == ["clock", "command"]


@pytest.mark.parametrize("time", ["wall", "lockstep"])
def test_two_devices_in_one_namespace_are_told_once(time):
    with lockstep(f"time:={time}", "rate_hz:=20.0", "clock:=false") as rig:
        rig.add(PlantNode)
        other = rig.node.create_publisher(JointState, "/vo2/measurement", 10)
        rig.until(
            lambda: "1 more on measurement: let one device publish" in rig.status("plant: measurement")[0]
        )
        rig.spin(1.2)
        assert sum("more on measurement" in text for _, text, _ in rig.statuses) == 1
        rig.node.destroy_publisher(other)
        rig.until(lambda: rig.status("plant: measurement")[0] == "alone on measurement again")


def test_the_plant_says_what_it_simulates_on_the_clock_of_its_samples():
    with lockstep("seed:=3", "effects:='{creep: {share: 0.05}}'") as rig:
        stamps = []
        rig.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda message: stamps.append(message.header.stamp.sec), 10
        )
        plant = rig.add(PlantNode)
        rig.until(lambda: stamps)
        plant._diagnostics.beat()
        rig.until(lambda: rig.status("plant: device")[0])
        said = rig.status("plant: device")[0]
        assert said.startswith(
            "simulates integrated, seed 3, effects {creep: {share: 0.05}}, noise on, lockstep"
        )
        assert set(stamps) == {1}


@pytest.mark.parametrize("as_file", [True, False])
def test_the_plant_tells_a_device_by_its_id_however_it_was_given(tmp_path, as_file):
    device = tmp_path / "device.yaml"
    shipped = (files("vo2_models.device") / "files" / "integrated.yaml").read_text()
    device.write_text(shipped.replace("id: integrated", "id: warm"))
    # a published parameter file holds the whole description
    given = {"/**": {"ros__parameters": {"preset": str(device) if as_file else preset(device).key}}}
    (tmp_path / "parameters.yaml").write_text(yaml.safe_dump(given))
    with bench(["--ros-args", "--params-file", str(tmp_path / "parameters.yaml")]) as rig:
        plant = rig.add(PlantNode)
        rig.until(lambda: rig.status("plant: device")[0])
        assert rig.status("plant: device")[0].startswith("simulates warm, seed 1, ")
        assert plant._diagnostics.hardware_id == "warm"


def wall(rig, samples, command):
    """Answer each of the next measurements with what `command` returns for the newest stamp [ns]."""
    for _ in range(samples):
        count = len(rig.heard["/vo2/measurement"])
        rig.until(lambda count=count: len(rig.heard["/vo2/measurement"]) > count)
        stamp_ns = rig.heard["/vo2/measurement"][-1][0]
        for offset_ns, values in command(stamp_ns):
            rig.say("/vo2/command", stamp_ns + offset_ns, values)
    return [values[0] for _, values in rig.heard["/vo2/measurement"]]


def test_wall_time_a_command_that_is_half_a_second_old_is_not_applied():
    with lockstep("time:=wall", "rate_hz:=20.0") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        wall(rig, 3, lambda _: [(0, {"heater_current": 0.005})])
        currents = wall(
            rig, 10, lambda _: [(-500 * MS, {"heater_current": 0.012}), (0, {"heater_current": 0.005})]
        )
        assert max(currents) < 0.0055
        assert "answer no sample of the last 3 periods" in rig.status("plant: stale")[0]


def test_wall_time_the_first_of_two_commanders_is_heard_until_it_is_silent():
    first = {"heater_current": 0.004, "commander": 1.0}
    second = {"heater_current": 0.012, "commander": 2.0}
    stranger = {"heater_current": 0.011}
    with lockstep("time:=wall", "rate_hz:=20.0") as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        wall(rig, 3, lambda _: [(0, first)])
        before = len(rig.heard["/vo2/measurement"])
        currents = wall(rig, 10, lambda _: [(0, second), (0, first), (0, stranger)])
        assert max(currents[before:]) < 0.0045
        assert "another node commands too" in rig.status("plant: commanders")[0]
        assert wall(rig, 8, lambda _: [(0, second)])[-1] == pytest.approx(0.012, abs=2e-4)


def test_no_current_that_the_device_does_not_bear_is_applied():
    with lockstep() as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        rig.say("/vo2/command", S, {"heater_current": 0.0193})
        rig.until(lambda: rig.heard["/vo2/measurement"][-1][0] == S + MS)
        assert rig.heard["/vo2/measurement"][-1][1][0] == pytest.approx(0.01278, abs=1e-4)
        rig.until(
            lambda: "outside the 0 to 0.01278 A that the device bears" in rig.status("plant: command")[0]
        )


def test_a_lockstep_sample_that_nobody_answers_is_told_and_taken_back():
    with lockstep() as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        rig.add(PlantNode)
        rig.until(lambda: rig.heard["/vo2/measurement"])
        rig.say("/vo2/command", S, {"heater_current": 0.005})
        rig.until(lambda: "nothing on command for 1 s" in rig.status("plant: bonds")[0])
        rig.say("/vo2/command", S + MS, {"heater_current": 0.005})
        rig.until(lambda: "every topic again" in rig.status("plant: bonds")[0])
