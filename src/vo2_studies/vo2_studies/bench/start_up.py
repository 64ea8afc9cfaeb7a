"""How long a new process waits: for the package, for the first compiled call, for a node, once the caches are there."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
from time import monotonic, perf_counter
from typing import NamedTuple

from vo2_interface.one_host import free_domain

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["ENTRIES", "NODES", "start_node"]

_FIRST_CALL = """
from vo2_models.hysteresis import GPI, RobustInverse, TanhEnvelopes
model = GPI([0.0, 0.5], [1.0, 1.0], TanhEnvelopes(1.0, -0.4, 1.0, 0.4), input_range=(-2, 2))
output, state = model.simulate([0.0, 1.0, 0.0])
model.update(0.5, state)
RobustInverse(model).update(0.1, state)
"""


NODES = {
    "plant": "vo2_plant_sim.plant_node:PlantNode",
    "estimator": "vo2_estimation.estimator_node:EstimatorNode",
    "controller": "vo2_control.controller_node:ControllerNode",
    "feedforward": "vo2_control.feedforward_node:FeedforwardNode",
    "reference": "vo2_control.reference_node:ReferenceNode",
    "identifier": "vo2_identification.identifier_node:IdentifierNode",
    "live": "vo2_interface.live.node:LiveNode",
}
"""Name -> class of the nodes whose start is timed."""
_NODE = """
import importlib, os, sys, time
module, name = sys.argv[1].split(":")
from vo2_interface.executable import join_graph
make = getattr(importlib.import_module(module), name)
join_graph(["node"])
node = make()
slow = [name for name in ("scipy.linalg", "scipy.optimize", "scipy.signal", "matplotlib") if name in sys.modules]
print(time.process_time(), time.monotonic(), *slow, flush=True)
os._exit(0)
"""


class Start(NamedTuple):
    """One start of a node.

    Attributes
    ----------
    passed_s : from the start of the process until the node is there
    used_s : processor time of it
    slow : what it has loaded that only fits need
    """

    passed_s: float
    used_s: float
    slow: tuple[str, ...]


def start_node(name: str) -> Start:
    """Start a node in a process of its own, and end it once it is there.

    Parameters
    ----------
    name : one of `NODES`
    """
    began = monotonic()
    said = subprocess.run(
        [sys.executable, "-c", _NODE, NODES[name]],
        env={**os.environ, "ROS_DOMAIN_ID": str(free_domain())},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()[-1]
    used_s, there, *slow = said.split()
    return Start(float(there) - began, float(used_s), tuple(slow))


def _seconds(code: str, repeats: int) -> float:
    """Median wall-clock seconds of new processes that run `code`; one unmeasured before fills the caches."""
    seconds = []
    for k in range(repeats + 1):
        start = perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        if k:
            seconds.append(perf_counter() - start)
    return statistics.median(seconds)


def import_package() -> Figure:
    """`import vo2_models` in a new process, less the start of Python itself."""
    return Figure(
        max(_seconds("import vo2_models", 7) - _seconds("pass", 7), 0.0), "s", note="above bare Python"
    )


def first_call() -> Figure:
    """A second process from its start to a simulated, a streamed and an inverted sample."""
    return Figure(_seconds(_FIRST_CALL, 3), "s", note="whole process, compiled code from the disk cache")


def node_start() -> Figure:
    """The node that takes longest from the start of its process until it is there; five starts of each."""
    median_s, used_s = {}, {}
    for name in NODES:
        start_node(name)
        starts = [start_node(name) for _ in range(5)]
        median_s[name] = statistics.median(start.passed_s for start in starts)
        used_s[name] = statistics.median(start.used_s for start in starts)
    slowest = max(median_s, key=lambda name: median_s[name])
    return Figure(
        median_s[slowest],
        "s",
        note=f"{slowest}, {used_s[slowest]:.2f} s of a processor; load {os.getloadavg()[0]:.0f} on {os.cpu_count()}",
    )


ENTRIES = (
    Entry("import", import_package, 0.1),
    Entry("first_call", first_call, 2.0),
    Entry("node_start", node_start, 1.5),
)
