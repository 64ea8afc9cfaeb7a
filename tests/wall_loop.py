"""A loop in wall time or in lockstep, one process a node, with this process as its witness."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vo2_interface.testing import Bench, bench
from vo2_interface.topics import LATCHED_QOS
from vo2_models.parameters import Value
from vo2_studies.demo.graph import Graph, NodeProcess

__all__ = ["NODES", "RATE_HZ", "WallLoop", "wall_loop"]

RATE_HZ = 40.0
"""Slow, so that a machine that does other work too misses no periods [Hz]."""
SET_POINT_M = 30e-6
CONTROLLER: dict[str, Value] = {"pid.kp": 1.4, "pid.ki": 810.0}
"""The published gains, the integral one per second instead of per sample."""
NODES = ("plant", "estimator", "reference", "controller")


class WallLoop:
    """The processes of the loop and what was seen of it.

    Attributes
    ----------
    rig : this process on the graph; `rig.heard` holds every measurement and command
    """

    def __init__(self, rig: Bench, folder: Path, model: Path, time: str = "wall") -> None:
        self.rig = rig
        self._time = time
        self._graph = Graph(int(os.environ["ROS_DOMAIN_ID"]), folder)
        self._model = model
        self.processes: dict[str, NodeProcess] = {}
        rig.hear("/vo2/measurement", ("true_tip_deflection", "heater_current"))
        rig.hear("/vo2/command", ("heater_current",))
        rig.hear("/vo2/estimate", ("tip_deflection", "tip_deflection_bound"))
        rig.hear("/vo2/reference", ("tip_deflection",), LATCHED_QOS)
        for name in NODES:
            self.start(name)

    def start(self, name: str, label: str = "") -> None:
        """Start a node, or start it again; `label` for a second one of its kind."""
        shared: dict[str, Value] = {"preset": "integrated", "time": self._time}
        shared |= {"rate_hz": RATE_HZ} if self._time == "wall" else {}
        own: dict[str, dict[str, Value]] = {
            "plant": {**shared, "true_channels": True},
            "estimator": {"preset": "integrated"},
            "reference": {"preset": "integrated", "steps.levels_m": [SET_POINT_M], "steps.hold_s": 1e6},
            "controller": {**shared, **CONTROLLER},
        }
        file = self._model if name in ("estimator", "controller") else None
        self.processes[label or name] = self._graph.start(
            name, name=label, parameters=own[name], parameter_file=file
        )

    def record(self, bag: Path) -> None:
        """Start a recorder, or start it again; it counts as a node of the loop."""
        self.processes["record"] = self._graph.start("record", arguments=["--output", str(bag)])

    def signal(self, name: str, number: int) -> None:
        """Send a signal to one node, and wait for its end where it ends it."""
        process = self.processes[name].process
        process.send_signal(number)
        if number == signal.SIGKILL:
            process.wait()
            # it ended as it should: not an accident of the graph
            self._graph.processes.remove(self.processes[name])

    def stall(self, name: str, seconds: float) -> None:
        """Stop a node for a while, as a machine that swaps does."""
        self.signal(name, signal.SIGSTOP)
        self.rig.spin(seconds)
        self.signal(name, signal.SIGCONT)

    def until_closed(self, since: int = 0, timeout_s: float = 120.0) -> None:
        """Wait until the tip has been at the set-point for half a second after measurement number `since`."""
        wanted = round(0.5 * RATE_HZ)

        def closed() -> bool:
            tip = self.tip(since)[-wanted:]
            return tip.size == wanted and bool(np.all(np.abs(tip - SET_POINT_M) < 4e-6))

        self.rig.until(closed, timeout_s)

    def tip(self, since: int = 0) -> NDArray[np.float64]:
        """True deflections [m] of the measurements from number `since` on."""
        return np.array([values[0] for _, values in self.rig.heard["/vo2/measurement"][since:]])

    def silence(self, since: int = 0) -> float:
        """Return the longest time without a newly answered sample [periods], by the commands from number `since` on."""
        stamps = [stamp for stamp, _ in self.rig.heard["/vo2/command"][since:]]
        return max(np.diff(stamps), default=0) * 1e-9 * RATE_HZ

    @property
    def commands(self) -> int:
        """Number of commands heard."""
        return len(self.rig.heard["/vo2/command"])

    @property
    def samples(self) -> int:
        """Number of measurements heard."""
        return len(self.rig.heard["/vo2/measurement"])

    def end(self) -> None:
        """End what runs, also what was stopped."""
        for each in self.processes.values():
            if each.process.poll() is None:
                each.process.send_signal(signal.SIGCONT)
        self._graph.end()


@contextmanager
def wall_loop(folder: Path, model: Path, time: str = "wall") -> Iterator[WallLoop]:
    """Give a loop that has closed."""
    with bench() as rig:
        loop = WallLoop(rig, folder, model, time)
        try:
            loop.until_closed()
            yield loop
        finally:
            loop.end()
