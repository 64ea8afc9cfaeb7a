"""Play a proposed experiment on the running graph, and record it.

The identifier plays and the recorder records, as in processes of their own; here they share one, so that the
diagnosis can go on with what they bring.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.executors import Executor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from vo2_interface.executable import StopFlag, fastest_executor, join_graph, leave_graph
from vo2_interface.parameters import ros_parameters
from vo2_interface.samples import SampleReader
from vo2_interface.timers import create_steady_timer
from vo2_interface.topics import COMMAND, MEASUREMENT, READ_QOS
from vo2_models.device import preset
from vo2_models.parameters import Value

from vo2_identification.bags import BagWriter
from vo2_identification.identifier_node import IdentifierNode
from vo2_identification.recorder_node import Recorder, contract_topics

__all__ = ["play", "playable_levels"]

_NAME = "next_experiment"
_SPIN_S = 0.05
_TAKE_S = 0.02
_NAMELESS = "_NODE_NAME_UNKNOWN_"
"""What the ROS graph says of a node whose name has not arrived yet."""
_LISTEN_S = 0.5
"""Time in which links settle."""
_OTHERS_S = 3.0
"""Time in which another commander would be heard: a process that keeps a core busy is discovered late."""
_SILENT_S = 10.0
"""Time without a new sample after which the device counts as gone."""
_END_S = 1.0
"""Time that an interrupted excitation waits for the sample that it answers with the safe current."""


def playable_levels(excitation: Mapping[str, Any], device: str) -> list[float]:
    """Return the levels [A] of a proposed experiment, from the coldest operating current on, as it was designed.

    Parameters
    ----------
    excitation : of a proposed experiment, as `diagnosis.json` holds it

    Raises
    ------
    ValueError : not a sequence of levels, or one outside the currents that the device allows.
    """
    levels = np.asarray(excitation.get("levels_a", []), dtype=np.float64)
    if excitation.get("kind") != "levels" or levels.size == 0 or not np.all(np.isfinite(levels)):
        raise ValueError(
            f"excitation: found {', '.join(excitation) or 'nothing'}, need kind levels and levels_a"
        )
    low, high = preset(device).current_range
    if np.min(levels) < low or np.max(levels) > high:
        raise ValueError(
            f"excitation.levels_a: found {np.min(levels):.6g} to {np.max(levels):.6g} A, need {low:g} to {high:g} A, "
            f"the limits of {preset(device).id}"
        )
    return [preset(device).operating_range[0], *levels.tolist()]


def play(
    excitation: Mapping[str, Any],
    bag: Path,
    *,
    device: str,
    sample_period_s: float,
    namespace: str = "/vo2",
    wait_s: float = 30.0,
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> bool:
    """Play an experiment on the device that runs in the graph, and record it into a new bag.

    Whatever happens after the first command, the device is left at the safe current and the bag readable.
    Uses the default context of `rclpy`; call it from the main thread.

    Parameters
    ----------
    excitation : `next_experiment.excitation` of a diagnosis
    bag : folder to create, mcap
    device : that the experiment was designed for, as `preset` takes it: the text that a model holds too
    sample_period_s : sampling [s] that it was designed for
    namespace : of the loop
    wait_s : time in which a device must be found [s]
    progress : called with the share played, 0 to 1, and what is being done

    Returns
    -------
    bool : whether it was played to its end; False after SIGINT or SIGTERM.

    Raises
    ------
    ValueError : an excitation that this device does not allow; no device, another device, or another commander in
        the graph; samples that stop coming; what the identifier refuses.
    OSError : the disk is full.
    """
    levels = playable_levels(excitation, device)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    stop = StopFlag()
    # what goes well is told by `progress`
    arguments = ["--log-level", "warn", "-r", f"__ns:={namespace}", "-r", f"identifier:__node:={_NAME}"]
    # a description is quoted as YAML: bare, ROS takes it for a mapping
    quoted = "'" + device.replace("'", "''") + "'"
    arguments += ["-p", f"preset:={quoted}", "-p", f"rate_hz:={1.0 / sample_period_s!r}"]
    executor, nodes = None, list[Node]()
    try:
        join_graph(["--ros-args", *arguments])
        node = IdentifierNode()
        nodes.append(node)
        executor = fastest_executor()
        executor.add_node(node)
        settings: dict[str, Value] = {
            "excitation.kind": "levels",
            "excitation.levels_a": levels,
            "excitation.hold_s": float(excitation["hold_s"]),
            "excitation.rate_a_per_s": float(excitation["rate_a_per_s"]),
            "fit": False,
        }
        accepted = node.set_parameters_atomically(ros_parameters(settings))
        if not accepted.successful:
            raise ValueError(accepted.reason)
        progress(0.0, "looking for the device")
        _meet(node, executor, stop, device, wait_s)
        if stop.is_set:
            return False
        with BagWriter(bag) as writer:
            recorder = Recorder(writer, contract_topics(namespace))
            nodes.append(recorder)
            create_steady_timer(node, _TAKE_S, recorder.take)
            try:
                _play(node, recorder, executor, stop, progress)
            finally:
                node.stop()
                node.rest()
                _spin(executor, _LISTEN_S)
                recorder.take()
                recorder.finish()
        if recorder.failure is not None:
            raise recorder.failure
        for line in recorder.missing():
            print(f"diagnose: --next: {line}", file=sys.stderr)
        return not stop.is_set
    finally:
        leave_graph(executor, nodes)
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _meet(node: IdentifierNode, executor: Executor, stop: StopFlag, device: str, wait_s: float) -> None:
    """Wait until a device measures and takes commands; make sure that it is the right one and nobody else commands."""
    measurement, command = (node.resolve_topic_name(topic) for topic in (MEASUREMENT, COMMAND))
    reader = SampleReader(())
    measured: list[bytes] = []
    commanded: list[bytes] = []
    listening = [
        node.create_subscription(JointState, measurement, measured.append, READ_QOS, raw=True),
        node.create_subscription(JointState, command, commanded.append, READ_QOS, raw=True),
    ]
    # one listener of the commands is this node itself
    met = _spin(executor, wait_s, lambda: stop.is_set or (measured and node.count_subscribers(command) > 1))
    if stop.is_set:
        return
    if not met:
        missing = f"listens to {command}" if measured else f"publishes {measurement}"
        raise ValueError(
            f"--next: nobody {missing}, waited {wait_s:g} s: start the plant or the rig, with this ROS_DOMAIN_ID "
            f"({os.environ.get('ROS_DOMAIN_ID', '0')}), and run this again"
        )
    _spin(executor, _OTHERS_S, lambda: bool(commanded))
    reader.read(measured[-1])
    wanted = preset(device).id
    if reader.device and wanted not in (reader.device, _id_of(reader.device)):
        raise ValueError(
            f"--next: {measurement} comes from device {reader.device!r}, the model is of {wanted!r}"
        )
    if commanded:

        def others() -> list[str]:
            found = {info.node_name for info in node.get_publishers_info_by_topic(command)}
            return sorted(found - {_NAME, _NAMELESS})

        # a link comes up before the name of the node behind it is known
        _spin(executor, _OTHERS_S, others)
        raise ValueError(
            f"--next: another node commands on {command} ({', '.join(others()) or 'unknown'}); stop it first"
        )
    for subscription in listening:
        node.destroy_subscription(subscription)


def _id_of(name: str) -> str:
    """Return the id of the device that a rig calls itself; its name where no preset and no file here is called so."""
    try:
        return preset(name).id
    except ValueError:  # the file of a rig on another machine
        return name


def _play(
    node: IdentifierNode,
    recorder: Recorder,
    executor: Executor,
    stop: StopFlag,
    progress: Callable[[float, str], None],
) -> None:
    measurement = node.resolve_topic_name(MEASUREMENT)
    _spin(executor, _SILENT_S, lambda: measurement not in recorder.open_topics)
    _spin(executor, _LISTEN_S)
    start = node.create_client(Trigger, "~/start").call_async(Trigger.Request())
    _spin(executor, _SILENT_S, start.done)
    if not start.done() or not start.result().success:
        raise ValueError(start.result().message if start.done() else "--next: the excitation does not start")
    # what is loaded by now stays: walking it at every collection would stop the loop for a tenth of a second
    gc.collect()
    gc.freeze()
    try:
        last, changed = -1.0, time.monotonic()
        while node.state == "exciting" and recorder.failure is None:
            if stop.is_set:
                node.stop()
            executor.spin_once(timeout_sec=_SPIN_S)
            now = time.monotonic()
            if node.share_played != last:
                last, changed = node.share_played, now
                progress(last, "playing the proposed experiment")
            elif now - changed > (_END_S if stop.is_set else _SILENT_S):
                break
    finally:
        gc.unfreeze()
    if node.state == "failed" and not stop.is_set:
        raise ValueError(f"--next: {node.last_words}")
    if node.state == "exciting" and recorder.failure is None and not stop.is_set:
        raise ValueError(
            f"--next: no new sample on {measurement} for {_SILENT_S:g} s; what was recorded is kept"
        )


def _spin(executor: Executor, seconds: float, enough: Callable[[], object] = lambda: False) -> bool:
    """Spin until `enough` or for so long; return whether it was enough."""
    deadline = time.monotonic() + seconds
    while not enough():
        if time.monotonic() > deadline:
            return False
        executor.spin_once(timeout_sec=_SPIN_S)
    return True
