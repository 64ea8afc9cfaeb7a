"""Processes killed or stalled in lockstep: somebody tells, simulated time stands, and goes on when the process is back."""

import random
import signal

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from wall_loop import NODES, wall_loop

_STALL_S = 4.0
"""In this time the loop makes several times the samples that may be on their way."""
_TOLD_S = 10.0
"""Wall time within which a loss must be told: two looks half a second apart, on a machine that does other work too."""


@pytest.mark.slow
@pytest.mark.parametrize("chunk", range(4))
def test_the_loss_of_any_node_is_told_and_the_loop_goes_on_when_it_is_back(
    chunk, model_file, tmp_path, capfd
):
    rng, told = random.Random(chunk), {}
    with wall_loop(tmp_path, model_file, "lockstep") as loop:
        rig = loop.rig
        for name in rng.sample(NODES, len(NODES)):
            # the loss before has been told to be over by then: what still stands is not told again
            rig.spin(rng.uniform(1.0, 1.3))
            loop.signal(name, signal.SIGKILL)
            rig.spin(0.2)
            rig.statuses.clear()
            stamps = {stamp for stamp, _ in rig.heard["/vo2/measurement"][-3:]}
            rig.until(lambda: any("nothing on" in text for _, text, _ in rig.statuses), _TOLD_S)
            told[name] = next(f"{who}: {text}" for who, text, _ in rig.statuses if "nothing on" in text)
            assert {stamp for stamp, _ in rig.heard["/vo2/measurement"]} >= stamps
            assert all(loop.processes[other].process.poll() is None for other in NODES if other != name), name
            since = loop.samples
            loop.start(name)
            loop.until_closed(since + 200)
    with capfd.disabled():
        print(f"\nlockstep: {len(told)} of {len(NODES)} losses told, {len(told)} rejoined: {told}")


def test_simulated_time_waits_for_a_recorder_that_stalls_and_nothing_is_lost(model_file, tmp_path):
    with wall_loop(tmp_path, model_file, "lockstep") as loop:
        loop.record(tmp_path / "bag")
        hears = loop.processes["record"].log
        topics = {f"/vo2/{role}" for role in ("measurement", "estimate", "command")}

        def met():
            lines = hears.read_text().splitlines() if hears.exists() else []
            return {topic for line in lines if line.startswith("Hears ") for topic in line[6:].split(", ")}

        loop.rig.until(lambda: topics <= met(), 60.0)
        before = loop.samples
        loop.stall("record", _STALL_S)
        during = loop.samples - before
        told = [text for who, text, _ in loop.rig.statuses if who == "vo2/plant: listeners"]
        loop.rig.until(lambda: loop.samples > before + during + 3000, 240.0)  # beside full lanes of tests
        loop.signal("record", signal.SIGINT)
        assert loop.processes["record"].process.wait(60.0) == 0, hears.read_text()[-2000:]
    assert any("does not keep up" in text for text in told), during
    with Reader(tmp_path / "bag") as bag:
        stamps: dict[str, list[int]] = {topic: [] for topic in topics}
        for connection, stamp, _ in bag.messages():
            if connection.topic in stamps:
                stamps[connection.topic].append(stamp)
    for topic, each in stamps.items():
        assert len(each) > during
        np.testing.assert_array_equal(np.diff(each), 1_000_000, err_msg=topic)
