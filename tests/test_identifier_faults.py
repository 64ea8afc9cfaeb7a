"""The plant is killed and started again while the identifier excites it: no sample counts twice, and the next run is whole."""

import os
import random
import signal
from functools import partial

import numpy as np
import pytest
from std_srvs.srv import Trigger
from vo2_identification.identifier_node import IdentifierNode
from vo2_interface.testing import bench
from vo2_studies.demo.graph import Graph

LEVELS = 40
SETTINGS = {
    "excitation.kind": "random_levels",
    "excitation.count": LEVELS,
    "excitation.hold_s": 0.01,
    "excitation.cold_s": 0.005,
    "fit": "false",
}
SAMPLES = 10 * LEVELS + 10


def asked(rig, service):
    client = rig.node.create_client(Trigger, f"/vo2/identifier/{service}")
    rig.until(client.service_is_ready)
    answer = client.call_async(Trigger.Request())
    rig.until(answer.done)
    return answer.result()


def recorded(node, count):
    return len(node._log) >= count


def words(rig):
    return rig.status("identifier: progress")[1].get("state", "")


@pytest.mark.parametrize("kills", [2, pytest.param(30, marks=pytest.mark.slow)])
def test_a_plant_that_starts_anew_is_counted_once(kills, tmp_path, capfd):
    chance = random.Random(kills)
    arguments = [
        "--ros-args",
        *(part for key, value in SETTINGS.items() for part in ("-p", f"{key}:={value}")),
    ]
    lost = []
    with bench(arguments) as rig:
        node = rig.add(IdentifierNode)
        assert isinstance(node, IdentifierNode)
        graph = Graph(int(os.environ["ROS_DOMAIN_ID"]), tmp_path)
        plant = graph.start("plant")
        try:
            for _ in range(kills):
                before = len(rig.statuses)
                assert asked(rig, "start").success
                wanted = chance.randrange(1, SAMPLES - 50)
                rig.until(partial(recorded, node, wanted), 60.0)
                plant.process.send_signal(signal.SIGKILL)
                plant.process.wait()
                graph.processes.remove(plant)
                rig.spin(0.3)
                lost.append(len(node._log))
                assert lost[-1] < SAMPLES and words(rig) == "exciting"
                plant = graph.start("plant")
                rig.until(lambda: words(rig) == "failed", 60.0)
                told = [
                    text for name, text, _ in rig.statuses[before:] if name.endswith("identifier: progress")
                ]
                assert "jumped back" in told[-1] and "start again" in told[-1]
                assert len(node._log) == lost[-1], (
                    "a sample of the new plant stands beside those of the old one"
                )
                # the next run begins where the new plant stands
                assert asked(rig, "start").success
                rig.until(lambda: words(rig) == "done", 60.0)
                recording = node._last_recording
                assert recording is not None and len(recording) == SAMPLES + 1
                np.testing.assert_allclose(np.diff(recording.time_s), 1e-3, rtol=1e-6)
                np.testing.assert_array_equal(recording["commanded_current"][1:], node._currents)
        finally:
            graph.end()
    with capfd.disabled():
        print(
            f"\nidentifier: {kills} kills of the plant after {min(lost)} to {max(lost)} of {SAMPLES} samples, told each time; "
            f"{kills} of {kills} next runs with each sample once"
        )
