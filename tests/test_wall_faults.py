"""Faults injected into a loop of processes in wall time: it stays safe, and comes back without an excursion."""

import random
import signal

import numpy as np
import pytest
from wall_loop import NODES, wall_loop

UM = 1e-6
_EXCURSION = 2.0 * UM
"""What a return may rise above the overshoot of the first start: another sample of noise and timing."""
_HELD = 6
"""Measurements with current after a loss: three that are held, and one each under way, missing its time, being told."""


def flowing(loop, since):
    """Number of measurements with current from number `since` on, up to the first without."""
    currents = [abs(values[1]) for _, values in loop.rig.heard["/vo2/measurement"][since:]]
    return next((k for k, current in enumerate(currents) if current < 1e-4), len(currents))


def test_a_stall_of_any_node_ends_without_an_excursion(model_file, tmp_path):
    with wall_loop(tmp_path, model_file) as loop:
        allowed = loop.tip().max() + _EXCURSION
        for name in NODES:
            since = loop.samples
            loop.stall(name, 0.3)
            loop.until_closed(since + 30)
            tip = loop.tip(since)
            assert tip.min() < 10 * UM, f"{name}: the loop went on without its input"
            assert tip.max() < allowed, f"{name}: {tip.max() / UM:.1f} um"


@pytest.mark.parametrize("kills", [10, pytest.param(200, marks=pytest.mark.slow)])
def test_killing_any_one_process_leaves_the_device_safe_and_it_rejoins(kills, model_file, tmp_path, capfd):
    rng = random.Random(kills)
    held, highest = [], []
    with wall_loop(tmp_path, model_file) as loop:
        allowed = loop.tip().max() + _EXCURSION
        for _ in range(kills):
            name = rng.choice(NODES)
            loop.rig.spin(rng.uniform(0.0, 0.05))
            since = loop.samples
            loop.signal(name, signal.SIGKILL)
            loop.rig.spin(0.3)
            if name != "plant":
                held.append(flowing(loop, since))
                assert held[-1] <= _HELD, f"{name}: current flowed for {held[-1]} samples more"
            others = [each for each in NODES if each != name]
            assert all(loop.processes[each].process.poll() is None for each in others)
            loop.start(name)
            loop.until_closed(loop.samples)
            highest.append(loop.tip(since).max())
            assert highest[-1] < allowed, f"{name}: the tip rose to {highest[-1] / UM:.1f} um"
    with capfd.disabled():
        print(
            f"\n{kills} kills: safe current after at most {max(held)} samples (median {np.median(held):g}), "
            f"{kills} of {kills} rejoined, tip at most {max(highest) / UM:.1f} um at a set-point of 30"
        )
