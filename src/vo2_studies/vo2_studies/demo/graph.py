"""Nodes as separate processes: started, watched, ended by process id."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from vo2_interface.one_host import one_host_environment
from vo2_models.parameters import Value

__all__ = ["MODULES", "NODES", "Graph", "GraphError", "NodeProcess"]

MODULES = {
    "plant": "vo2_plant_sim.plant_node",
    "estimator": "vo2_estimation.estimator_node",
    "controller": "vo2_control.controller_node",
    "reference": "vo2_control.reference_node",
    "feedforward": "vo2_control.feedforward_node",
    "loop": "vo2_control.loop_node",
    "identifier": "vo2_identification.identifier_node",
    "record": "vo2_identification.record",
    "replay": "vo2_identification.replay",
    "convert": "vo2_identification.convert",
    "disturbance": "vo2_studies.reproduce.disturbance_node",
}
"""Executable -> module: the same code as `ros2 run`, without the search for entry points at every start."""

NODES = ("plant", "estimator", "controller", "reference", "feedforward", "identifier", "disturbance")
"""Executables that are one node each and can be renamed."""
_END_S = 10.0
_POLL_S = 0.05


class GraphError(RuntimeError):
    """A process ended that should run, or did not end well; the message quotes its last words."""


@dataclass
class NodeProcess:
    """One process, its log, and what it has used: peak memory [kB], processor time [s]."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    executable: str = ""
    peak_kb: int = 0
    cpu_s: float = 0.0

    def last_words(self, lines: int = 4) -> str:
        """Return the end of the log in one line."""
        text = self.log.read_text(errors="replace").strip().splitlines() if self.log.exists() else []
        return " | ".join(text[-lines:]) or "it said nothing"


@dataclass
class Graph:
    """A set of processes on one ROS domain of this host.

    Attributes
    ----------
    domain : ROS_DOMAIN_ID of all of them
    log_folder : where their output goes, one file each
    peak_kb : largest memory of a process so far [kB]
    cpu_s : name -> processor time of the processes of this name that have ended [s]
    """

    domain: int
    log_folder: Path
    processes: list[NodeProcess] = field(default_factory=list)
    peak_kb: int = 0
    cpu_s: dict[str, float] = field(default_factory=dict)

    def environment(self) -> dict[str, str]:
        """Return the environment of the processes: this domain, this host only, logs beside the rest."""
        return {
            **os.environ,
            **one_host_environment(self.domain),
            "ROS_LOG_DIR": str(self.log_folder),
            "PYTHONUNBUFFERED": "1",
        }

    def start(
        self,
        executable: str,
        *,
        name: str = "",
        namespace: str = "/vo2",
        parameters: Mapping[str, Value] | None = None,
        parameter_file: Path | None = None,
        remap: Mapping[str, str] | None = None,
        arguments: Sequence[str] = (),
    ) -> NodeProcess:
        """Start an executable as a process of its own; `arguments` go before the ROS arguments."""
        label = f"{namespace.strip('/').replace('/', '_')}_{name or executable}"
        command = [sys.executable, "-m", MODULES[executable], *arguments]
        if executable != "convert":
            command += ["--ros-args"]
            if executable in (*NODES, "loop"):
                command += ["-r", f"__ns:={namespace}"]
            if name and executable in NODES:
                command += ["-r", f"__node:={name}"]
            for source, target in (remap or {}).items():
                command += ["-r", f"{source}:={target}"]
            if parameter_file is not None:
                command += ["--params-file", str(parameter_file)]
            for key, value in (parameters or {}).items():
                command += ["-p", f"{key}:={_yaml(value)}"]
        self.log_folder.mkdir(parents=True, exist_ok=True)
        log = self.log_folder / f"{label}.log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                command,
                stdout=stream,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self.environment(),
                # Ctrl-C reaches the demo alone, which then ends the processes in order
                start_new_session=True,
            )
        started = NodeProcess(label, process, log, executable)
        self.processes.append(started)
        return started

    def check(self) -> None:
        """Note the peak memory of all; raise a `GraphError` if one that should run has ended badly."""
        for each in self.processes:
            if each.process.poll() not in (None, 0):
                raise GraphError(
                    f"{each.name} ended with status {each.process.returncode}: {each.last_words()}"
                )
            self._note_use(each)

    def end(self, *which: NodeProcess, timeout_s: float = _END_S) -> None:
        """End processes (all, if none is named) with SIGINT, and SIGKILL for one that does not obey.

        Of all, recorders end first: what they lag behind by is still with the publishers, and would go with them.
        """
        recorders = [each for each in self.processes if each.executable == "record"]
        if recorders and not which:
            self.end(*recorders, timeout_s=timeout_s)
        ending = list(which) or list(reversed(self.processes))
        for each in ending:
            self._note_use(each)
            if each.process.poll() is None:
                each.process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + timeout_s
        for each in ending:
            try:
                each.process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                each.process.kill()
                each.process.wait()
            self._note_end(each)
        self.processes = [each for each in self.processes if each not in ending]

    def wait(self, which: NodeProcess, timeout_s: float) -> None:
        """Wait until a process has ended by itself; raise a `GraphError` if it fails or takes too long."""
        deadline = time.monotonic() + timeout_s
        while (status := which.process.poll()) is None:
            if time.monotonic() > deadline:
                raise GraphError(f"{which.name} still runs after {timeout_s:g} s: {which.last_words()}")
            self._note_use(which)
            time.sleep(_POLL_S)
        self.processes = [each for each in self.processes if each is not which]
        self._note_end(which)
        if status:
            raise GraphError(f"{which.name} ended with status {status}: {which.last_words()}")

    def _note_end(self, each: NodeProcess) -> None:
        self.cpu_s[each.name] = self.cpu_s.get(each.name, 0.0) + each.cpu_s

    def _note_use(self, each: NodeProcess) -> None:
        try:
            status = Path(f"/proc/{each.process.pid}/status").read_text()
            # after the name in brackets, which may hold blanks; user and system time in clock ticks
            counts = Path(f"/proc/{each.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            return
        each.cpu_s = (int(counts[11]) + int(counts[12])) / os.sysconf("SC_CLK_TCK")
        for line in status.splitlines():
            if line.startswith("VmHWM:"):
                each.peak_kb = max(each.peak_kb, int(line.split()[1]))
                self.peak_kb = max(self.peak_kb, each.peak_kb)


def _yaml(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(element) for element in value) + "]"
    # a text is quoted, so that "1" and "" stay texts
    return "'" + value.replace("'", "''") + "'" if isinstance(value, str) else repr(value)
