"""Faults injected into a loop of processes in wall time: it stays safe, and comes back without an excursion."""

import random
import signal
from itertools import pairwise

import pytest
from vo2_identification.bags import BagError, read_bag
from vo2_interface.lockstep import HOLD_SAMPLES
from wall_loop import NODES, RATE_HZ, wall_loop

UM = 1e-6
_EXCURSION = 2.0 * UM
"""What a return may rise above the overshoot of the first start: another sample of noise and timing."""
_SAYS = {"estimator": "/vo2/estimate", "reference": "/vo2/reference", "controller": "/vo2/command"}


def held(loop, name):
    """Return for how many samples the plant held the current after a node was killed.

    The node's last word is on the sample of its stamp. The current that it led to is the next sample's; those after it are
    held. Counted by the plant's own stamps: when this process hears of them does not matter. A node may be killed between
    its readers: a command that is new and flows shows a last word that the controller heard and this process did not.
    """
    flows = [(stamp, current) for stamp, (current,) in loop.rig.heard["/vo2/command"] if current > 1e-4]
    answered_ns = max(stamp for (_, before), (stamp, now) in pairwise(flows) if now != before)
    last_ns = max(loop.rig.heard[_SAYS[name]][-1][0], answered_ns)

    def after():
        return [
            (stamp, abs(values[1])) for stamp, values in loop.rig.heard["/vo2/measurement"] if stamp > last_ns
        ]

    loop.rig.until(lambda: any(current < 1e-4 for _, current in after()))
    safe_ns = next(stamp for stamp, current in after() if current < 1e-4)
    flowed = [stamp for stamp, _ in after() if stamp < safe_ns]
    return round((max(flowed, default=last_ns) - last_ns) * 1e-9 * RATE_HZ) - 1


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


def last_of(bag):
    """Stamp of the last measurement in a bag [s]."""
    recordings, _ = read_bag(bag)
    return recordings["measurement"].time_s[-1]


@pytest.mark.parametrize("chunk", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 11))])
def test_killing_any_one_process_leaves_the_device_safe_and_it_rejoins(chunk, model_file, tmp_path, capfd):
    """The short form kills each process once; the ten slow ones kill 200 times together."""
    rng, whom = random.Random(chunk), (*NODES, "record")
    killed = rng.choices(whom, k=20) if chunk else rng.sample(whom, len(whom))
    kills = len(killed)
    samples, highest, lost, silent = [], [], [], []
    with wall_loop(tmp_path, model_file) as loop:
        allowed = loop.tip().max() + _EXCURSION
        bags = [tmp_path / "bag_0"]
        loop.record(bags[0])
        loop.rig.until(lambda: readable(bags[0]))
        for number, name in enumerate(killed):
            loop.rig.spin(rng.uniform(0.0, 0.05))
            since, commands = loop.samples, loop.commands
            # by the plant's own stamps: the host's time of day may be set while the loop runs
            killed_ns = loop.rig.heard["/vo2/measurement"][-1][0]
            loop.signal(name, signal.SIGKILL)
            loop.rig.spin(0.5)
            others = [each for each in whom if each != name]
            assert all(loop.processes[each].process.poll() is None for each in others)
            if name == "record":
                lost.append(1e-9 * killed_ns - last_of(bags[-1]))
                assert lost[-1] < 1.0, f"the bag ends {lost[-1]:.2f} s before the kill"
                bags.append(tmp_path / f"bag_{number + 1}")
                loop.record(bags[-1])
            else:
                if name != "plant":
                    samples.append(held(loop, name))
                    assert samples[-1] <= HOLD_SAMPLES, f"{name}: held for {samples[-1]} samples"
                if name in ("estimator", "reference"):
                    silent.append(loop.silence(commands))
                loop.start(name)
            loop.until_closed(loop.samples)
            if name == "record":
                loop.rig.until(lambda: readable(bags[-1]), 60.0)
            highest.append(loop.tip(since).max())
            assert highest[-1] < allowed, f"{name}: the tip rose to {highest[-1] / UM:.1f} um"
    with capfd.disabled():
        print(
            f"\n{kills} kills: current held for at most {max(samples, default=0)} samples (of {len(samples)}), commands "
            f"answer a new sample after at most {max(silent, default=0):.1f} periods (of {len(silent)}), a bag ends at most "
            f"{max(lost, default=0):.2f} s before the kill (of {len(lost)}), {kills} of {kills} rejoined, tip at most "
            f"{max(highest) / UM:.1f} um at a set-point of 30"
        )


def readable(bag):
    """Whether a bag has a measurement by now."""
    try:
        return "measurement" in read_bag(bag)[0]
    except BagError:
        return False
