"""Closed loops on a running ROS graph, in lockstep, side by side, recorded; their samples come from the bag alone."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

import numpy as np
import yaml
from numpy.typing import NDArray
from vo2_interface.one_host import free_domain
from vo2_models.device.description import preset
from vo2_models.parameters import Value

from vo2_studies.demo.errors import PhaseData, loop_recordings, phase_data
from vo2_studies.demo.stage import Phase

if TYPE_CHECKING:
    from vo2_studies.demo.graph import Graph

__all__ = ["GraphLoop", "run_loops"]

Floats = NDArray[np.float64]

_FIRST_STAMP_S = 1.0
_SAMPLES = ("command", "measurement", "estimate", "reference")
_SECONDS_PER_SAMPLE = 0.02
"""Wall time per sample beyond which something hangs [s]."""


@dataclass(frozen=True)
class GraphLoop:
    """One loop of plant, estimator, controller and reference, composed in one process.

    Attributes
    ----------
    namespace : as `/vo2`; the first loop's plant gives the clock
    estimator, controller : parameters of the nodes; `model.*` may be among them
    disturbance_seed : None for no current noise
    """

    namespace: str
    estimator: Mapping[str, Value]
    controller: Mapping[str, Value]
    disturbance_seed: int | None = None
    nodes: tuple[str, ...] = field(default=("plant", "estimator", "controller", "reference"), init=False)


def run_loops(
    loops: Sequence[GraphLoop],
    device: str,
    seed: int,
    wanted_m: Floats,
    lead: int,
    folder: Path,
    *,
    plant: Mapping[str, Value] | None = None,
) -> list[PhaseData]:
    """Run all loops side by side on devices of the same seed, in lockstep; return what the bag holds of each.

    Parameters
    ----------
    device, seed : of the simulated device and its sensors' noise
    wanted_m : (n,) reference at the preset's period [m], from the first sample on
    lead : first samples that are left out of what is returned (and are in the bag)
    folder : gets `bag`, `reference.csv`, the loops' parameter files and the logs of the nodes; replaced
    plant : further parameters of every plant, such as effects

    Raises
    ------
    GraphError : a node ended or something did not happen in time.
    ValueError : samples are missing in the bag.
    """
    # ROS takes a second to load: only for who runs a scenario
    from vo2_studies.demo.conductor import Conductor
    from vo2_studies.demo.graph import Graph

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    period = preset(device).sample_period
    count = wanted_m.size
    rows = "\n".join(f"{k * period:.9g},{value:.12g}" for k, value in enumerate(wanted_m))
    (folder / "reference.csv").write_text(f"time_s,tip_deflection\n{rows}\n", encoding="utf-8")
    # a domain of its own, so that nothing else on this host is disturbed or disturbs
    graph = Graph(free_domain(), folder / "logs")
    end_s = _FIRST_STAMP_S + count * period
    with patch.dict(os.environ, graph.environment()):
        conductor = Conductor(graph)
        try:
            topics = [f"{loop.namespace}/{name}" for loop in loops for name in _SAMPLES]
            recorder = graph.start(
                "record", arguments=["--output", str(folder / "bag"), "--topics", *topics, "/clock"]
            )
            for loop in loops:
                _start(graph, loop, device, seed, count, folder, plant or {}, clock=loop is loops[0])
            names = [f"{loop.namespace}/{node}" for loop in loops for node in loop.nodes]
            conductor.wait_for_nodes(names)
            expected: dict[tuple[str, str], int] = {}
            for loop in loops:
                expected |= _listeners(loop)
            conductor.wait_for_listeners(expected)
            conductor.wait_for_recorder(recorder, topics)
            for loop in loops:
                space = loop.namespace
                conductor.set(
                    f"{space}/reference", {"csv.file": str(folder / "reference.csv"), "signal": "csv"}
                )
                conductor.set(f"{space}/controller", {"enabled": True})
            # last, so that nothing is set in the course of time, at another sample in every run
            for loop in loops:
                conductor.set(f"{loop.namespace}/plant", {"run_until_s": end_s})

            def stand_still() -> bool:
                stamps = [
                    conductor.value(f"{loop.namespace.strip('/')}/plant: time", "stamp_s") for loop in loops
                ]
                return all(float(stamp or "-1") >= end_s - 1e-6 for stamp in stamps)

            conductor.wait_for("the end of the reference", stand_still, 60.0 + count * _SECONDS_PER_SAMPLE)
            conductor.pause(0.5)
            graph.check()
        finally:
            graph.end()
            conductor.close()
    start_s = _FIRST_STAMP_S + (lead - 1) * period if lead else _FIRST_STAMP_S
    return [
        phase_data(
            loop_recordings(folder / "bag", loop.namespace),
            Phase("scenario", loop.namespace, start_s, end_s - period if lead else end_s),
        )
        for loop in loops
    ]


def _start(
    graph: Graph,
    loop: GraphLoop,
    device: str,
    seed: int,
    count: int,
    folder: Path,
    plant: Mapping[str, Value],
    *,
    clock: bool,
) -> None:
    space = loop.namespace
    parameters: dict[str, Mapping[str, Value]] = {
        "plant": {
            "seed": seed,
            "true_channels": True,
            "clock": clock,
            "run_until_s": _FIRST_STAMP_S,
            **plant,
        },
        "estimator": loop.estimator,
        "controller": {**loop.controller, "enabled": False},
        "reference": {"signal": "none"},
    }
    tree: dict[str, object] = {
        f"{space}/{node}": {"ros__parameters": {"preset": device, **_plain(values)}}
        for node, values in parameters.items()
    }
    file = folder / f"{space.strip('/')}.yaml"
    file.write_text(yaml.safe_dump(tree, width=100), encoding="utf-8")
    remap = {} if loop.disturbance_seed is None else {"controller:command": "undisturbed"}
    graph.start("loop", namespace=space, parameter_file=file, remap=remap, arguments=["--with-reference"])
    if loop.disturbance_seed is not None:
        noise: dict[str, Value] = {"preset": device, "seed": loop.disturbance_seed, "count": count}
        graph.start("disturbance", namespace=space, parameters=noise)


def _plain(values: Mapping[str, Value]) -> dict[str, object]:
    return {name: np.asarray(value).tolist() for name, value in values.items()}


def _listeners(loop: GraphLoop) -> dict[tuple[str, str], int]:
    space = loop.namespace
    found = {
        (f"{space}/plant", f"{space}/measurement"): 3,
        (f"{space}/estimator", f"{space}/estimate"): 2,
        (f"{space}/reference", f"{space}/reference"): 2,
    }
    if loop.disturbance_seed is None:
        return found | {(f"{space}/controller", f"{space}/command"): 2}
    return found | {
        (f"{space}/controller", f"{space}/undisturbed"): 1,
        (f"{space}/disturbance", f"{space}/command"): 2,
    }
