"""Processes killed in lockstep: somebody tells, simulated time stands, and goes on when the process is back."""

import random
import signal

import pytest
from wall_loop import NODES, wall_loop

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
            rig.spin(rng.uniform(0.0, 0.3))
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
