"""Keep the processes of a rig running: start them, restart one that dies or hangs, and tell it on /diagnostics.

Each entry of `run` is what stands behind `ros2 run`: package, executable, arguments. A process that ends with status 0 was
asked to; one with status 2 was given what it cannot use, and is not started again; any other is started anew, at once the
first time and later after longer and longer waits. The beat is what every node says on /diagnostics anyway: one that has
spoken and then is silent for `silence_s` is killed and started anew. A node that comes back commands nothing before
its input is live and the device follows, and never more than the device file allows.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from vo2_models.parameters import Parameter, Value

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.executable import node_main
from vo2_interface.parameters import ParameterTable
from vo2_interface.timers import create_steady_timer
from vo2_interface.topics import DEFAULT_NAMESPACE, DIAGNOSTICS, OVERRIDABLE_INPUT, READ_QOS

__all__ = ["SUPERVISE_PARAMETERS", "SuperviseNode", "main"]

SUPERVISE_PARAMETERS = (
    Parameter(
        "run",
        [],
        "",
        "Processes, each as 'PACKAGE EXECUTABLE [ARGUMENTS]'.",
        kind="string_array",
    ),
    Parameter(
        "silence_s", 10.0, "s", "Silence on /diagnostics after which a node is killed; 0 for never.", 0.0, 1e6
    ),
)
_LOOK_S = 0.1
_BEAT_S = 1.0
_SHORT_LIFE_S = 20.0
"""A process that dies sooner after its start waits longer before the next [s]."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 30.0
_UNUSABLE = 2
"""Exit status of a process that was given what it cannot use."""
_END_S = 8.0


@dataclass
class _Child:
    """One process that is looked after.

    Attributes
    ----------
    label : package and executable, for people
    command : that starts it
    node : name under which it speaks on /diagnostics
    process : that runs or has ended
    started_s, heard_s : when it was started, and when it last spoke; NaN before
    wait_s : before the next start
    due_s : when that is, None while it runs or is not to be started
    restarts : how many so far
    over : whether it is not started again
    """

    label: str
    command: list[str]
    node: str
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    heard_s: float = float("nan")
    wait_s: float = 0.0
    due_s: float | None = 0.0
    restarts: int = 0
    over: bool = False


class SuperviseNode(Node):
    """Processes in hand, their beats in, restarts and statuses out."""

    def __init__(self) -> None:
        super().__init__("supervise", namespace=DEFAULT_NAMESPACE)
        table = self._table = ParameterTable(self, SUPERVISE_PARAMETERS, judge=self._judge)
        self._diagnostics = Diagnostics(self, wall_time=True)
        entries = table["run"]
        self._children = [_child(str(entry)) for entry in entries] if isinstance(entries, list) else []
        if not self._children:
            raise ValueError("run: found no process, need some such as ['vo2_plant_sim plant']")
        labels = [child.label for child in self._children]
        if twice := {label for label in labels if labels.count(label) > 1}:
            raise ValueError(
                f"run: found {', '.join(twice)} twice under one name, need -r __node:=NAME for one of them"
            )
        self.create_subscription(
            DiagnosticArray,
            DIAGNOSTICS,
            self._on_beat,
            copy(READ_QOS),  # an override is written into it
            qos_overriding_options=OVERRIDABLE_INPUT,
        )
        create_steady_timer(self, _LOOK_S, self._look)
        create_steady_timer(self, _BEAT_S, self._diagnostics.beat)  # for who comes late

    def close(self) -> None:
        """End the processes in the order opposite to their start: who commands goes before what is commanded."""
        running = [child.process for child in reversed(self._children) if child.process is not None]
        for process in running:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + _END_S
        for process in running:
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _judge(self, values: Mapping[str, Value]) -> None:
        if values.get("run", self._table["run"]) != self._table["run"]:
            raise ValueError("run: cannot be changed while the processes run; start another supervisor")

    def _on_beat(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        names = {status.name.partition(":")[0] for status in message.status}
        for child in self._children:
            if child.node in names:
                child.heard_s = now

    def _look(self) -> None:
        now = time.monotonic()
        silence_s = self._table.number("silence_s")
        for child in self._children:
            if child.process is not None and (status := child.process.poll()) is not None:
                self._ended(child, status, now)
            elif child.process is not None and 0.0 < silence_s < now - child.heard_s:
                self._diagnostics.report(child.label, "error", f"silent for {silence_s:g} s: killed")
                child.process.kill()
                child.heard_s = float("nan")
            if child.due_s is not None and now >= child.due_s:
                self._start(child, now)

    def _start(self, child: _Child, now: float) -> None:
        # a session of its own: Ctrl-C reaches this process alone, which then ends the others in order
        child.process = subprocess.Popen(child.command, stdin=subprocess.DEVNULL, start_new_session=True)
        child.started_s, child.heard_s, child.due_s = now, float("nan"), None
        times = f"started {child.restarts} times again" if child.restarts else "started"
        self._diagnostics.report(
            child.label, "ok", times, {"pid": child.process.pid, "restarts": child.restarts}
        )

    def _ended(self, child: _Child, status: int, now: float) -> None:
        child.process = None
        how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
        if status in (0, _UNUSABLE):
            child.over = True
            level = "ok" if status == 0 else "error"
            self._diagnostics.report(child.label, level, f"{how}: not started again")
            return
        lived_s = now - child.started_s
        if lived_s > _SHORT_LIFE_S:
            child.wait_s = 0.0
        child.due_s = now + child.wait_s
        self._diagnostics.report(child.label, "error", f"{how}: started again in {child.wait_s:g} s")
        child.wait_s = min(max(2.0 * child.wait_s, _FIRST_WAIT_S), _LONGEST_WAIT_S)
        child.restarts += 1


def _child(entry: str) -> _Child:
    """The process of an entry of `run`."""
    try:
        package, executable, *arguments = shlex.split(entry)
    except ValueError as error:
        raise ValueError(f"run: found {entry!r}, need 'PACKAGE EXECUTABLE [ARGUMENTS]'") from error
    space, name = DEFAULT_NAMESPACE, executable
    for each in arguments:
        space = each.removeprefix("__ns:=") if each.startswith("__ns:=") else space
        name = each.removeprefix("__node:=") if each.startswith("__node:=") else name
    node = f"{space.strip('/')}/{name}".lstrip("/")
    return _Child(node, [str(_installed(package, executable)), *arguments], node)


def _installed(package: str, executable: str) -> Path:
    """Where `ros2 run` finds an executable."""
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        path = Path(prefix) / "lib" / package / executable
        if path.is_file():
            return path
    raise ValueError(
        f"run: found no executable {executable!r} of package {package!r}; is the workspace sourced?"
    )


main = node_main(SuperviseNode)

if __name__ == "__main__":
    sys.exit(main())
