"""`./vo2 bench`: the lockstep loop over three processes, beside the same three processes with empty callbacks.

Both run in the same minute on the same executor, messages, quality of service and transport. The yardstick's
callbacks send on a sample that was serialized before the run; the loop steps the device, estimates, controls.
The reference is a set-point that holds, so that three processes are all there is.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rclpy.executors import Executor
from vo2_models.device import truth
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.model_file import save_model_parameters
from vo2_models.workflow import fit

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["ENTRIES", "lockstep_rate", "relay_rate", "save_small_model"]

_SECONDS = 4.0
_WARM_S = 1.0
_TURNS = 3
_SET_POINT_M = 30e-6
_DOMAINS = itertools.count(os.getpid())


def _relay(role: str) -> None:
    """One of three processes that send a fixed sample on; the first prints the rate of rounds."""
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from vo2_interface.executable import fastest_executor
    from vo2_interface.samples import SampleWriter
    from vo2_interface.topics import READ_QOS, SAMPLE_QOS

    rclpy.init()
    node = Node(f"relay_{role}")
    heard, said = {"first": ("c", "a"), "second": ("a", "b"), "third": ("b", "c")}[role]
    sample = SampleWriter(("heater_current", "film_resistance", "tip_deflection"), "integrated").write(
        1, (1.0, 2.0, 3.0)
    )
    publisher = node.create_publisher(JointState, said, SAMPLE_QOS)
    count = 0

    def send_on(_data: bytes) -> None:
        nonlocal count
        count += 1
        publisher.publish(sample)

    node.create_subscription(JointState, heard, send_on, READ_QOS, raw=True)
    executor = fastest_executor()
    executor.add_node(node)
    if role != "first":
        while True:
            executor.spin_once(timeout_sec=0.05)
    deadline = time.monotonic() + 30.0
    while count == 0 and time.monotonic() < deadline:
        publisher.publish(sample)
        executor.spin_once(timeout_sec=0.2)
    _spin(executor, _WARM_S)
    before = count
    seconds = _spin(executor, _SECONDS)
    print((count - before) / seconds)
    rclpy.shutdown()


def _watch() -> None:
    """Publish the set-point, then count the commands of the loop and print their rate."""
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from vo2_interface.executable import fastest_executor
    from vo2_interface.samples import SampleReader, SampleWriter
    from vo2_interface.topics import LATCHED_QOS, REFERENCE, REFERENCE_CHANNELS

    rclpy.init()
    node = Node("watch", namespace="/vo2")
    publisher = node.create_publisher(JointState, REFERENCE, LATCHED_QOS)
    publisher.publish(SampleWriter(REFERENCE_CHANNELS, "integrated").write(0, (_SET_POINT_M,)))
    executor = fastest_executor()
    executor.add_node(node)
    reader = SampleReader(("heater_current",))

    def newest_stamp() -> float:
        """Listen for one command only: a fourth process in the loop's way would slow it down."""
        found: list[int] = []

        def keep(data: bytes) -> None:
            found.append(reader.read(data)[0])

        listening = node.create_subscription(JointState, "command", keep, 10, raw=True)
        deadline = time.monotonic() + 30.0
        while not found and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.05)
        node.destroy_subscription(listening)
        return found[-1] * 1e-9

    newest_stamp()
    _spin(executor, _WARM_S)
    first, began = newest_stamp(), time.perf_counter()
    time.sleep(_SECONDS)
    last, seconds = newest_stamp(), time.perf_counter() - began
    print((last - first) * 1000.0 / seconds)
    rclpy.shutdown()


def _spin(executor: Executor, seconds: float) -> float:
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        executor.spin_once(timeout_sec=0.05)
    return time.perf_counter() - began


def _environment() -> dict[str, str]:
    from vo2_interface.one_host import one_host_environment

    return {**os.environ, **one_host_environment(1 + next(_DOMAINS) * 37 % 100)}


def _measure(background: list[list[str]], printing: list[str]) -> float:
    """Run processes, return the number that the last one prints, end the others."""
    environment = _environment()
    running = [
        subprocess.Popen([sys.executable, *command], env=environment, stdout=subprocess.DEVNULL)
        for command in background
    ]
    try:
        shown = subprocess.run(
            [sys.executable, *printing],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            timeout=90,
            check=True,
        ).stdout
        return float(shown.strip().splitlines()[-1])
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait()


def relay_rate() -> float:
    """Rounds per second of three processes with empty callbacks."""
    here = "vo2_studies.bench.lockstep"
    return _measure([["-m", here, "second"], ["-m", here, "third"]], ["-m", here, "first"])


def save_small_model(path: Path) -> None:
    """Identify device 1 from a short damped oscillation and save its model."""
    share = damped_oscillation(np.linspace(0.0, 1.0, 21))
    recording = truth("integrated", seed=1).simulate(np.repeat(3.68e-3 + 4.81e-3 * share, 10), seed=1)
    save_model_parameters(path, fit(recording, "integrated"))


def lockstep_rate() -> float:
    """Samples per second of plant, estimator and controller as three processes."""
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model.yaml"
        save_small_model(model)
        ros = ["--ros-args", "--params-file", str(model)]
        return _measure(
            [
                ["-m", "vo2_plant_sim.plant_node", *ros],
                ["-m", "vo2_estimation.estimator_node", *ros],
                ["-m", "vo2_control.controller_node", *ros, "-p", "reference_hold:=true"],
            ],
            ["-m", "vo2_studies.bench.lockstep", "watch"],
        )


def lockstep() -> Figure:
    """The loop and the empty relay in turn; the middle of each, since another process may disturb one of them."""
    runs = [(relay_rate(), lockstep_rate()) for _ in range(_TURNS)]
    relay, loop = (float(np.median(rates)) for rates in zip(*runs, strict=True))
    spread = ", ".join(f"{loop_rate / relay_rate_:.2f}" for relay_rate_, loop_rate in runs)
    return Figure(
        loop, "samples/s", yardstick=relay, note=f"empty callbacks, same transport; in turn {spread}"
    )


ENTRIES = (Entry("lockstep", lockstep, 0.7, of="ratio", above=True),)

if __name__ == "__main__":
    if sys.argv[1] == "watch":
        _watch()
    else:
        _relay(sys.argv[1])
