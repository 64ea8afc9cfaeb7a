"""`./vo2 bench --wall`: closed loops in wall time, what they miss and how long an answer takes.

First the nodes composed in one process at 1 kHz (`loop` with the reference beside it, a sinusoid), then plant,
estimator and controller as three processes at 500 Hz on a set-point that holds. The plant counts by its own
monotonic clock, from two seconds after the first command on: periods without a sample in time, samples without a
command before the next one, and the time from each measurement to its command. It tells them on `/diagnostics`,
where this command reads them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from vo2_interface.one_host import free_domain
from vo2_interface.samples import SampleWriter
from vo2_interface.topics import LATCHED_QOS, REFERENCE_CHANNELS
from vo2_models.parameters import Value

from vo2_studies.bench.lockstep import save_small_model
from vo2_studies.demo.conductor import Conductor
from vo2_studies.demo.graph import Graph, GraphError

__all__ = ["WallResult", "main", "measure"]

_ALLOWED = 1e-3
"""Share of missed periods that a loop may have."""
_PRIORITY = 10
_SET_POINT_M = 30e-6
_PACE = "vo2/plant: pace"
_COMPOSED, _PROCESSES = "one process", "three processes"
_RATES = {_COMPOSED: 1000.0, _PROCESSES: 500.0}


@dataclass(frozen=True)
class WallResult:
    """One loop: rate [Hz], counted periods, of them skipped and unanswered, latency of the answers [ms]."""

    rate_hz: float
    periods: int
    skipped: int
    unanswered: int
    latency_p50_ms: float
    latency_p99_ms: float
    latency_p999_ms: float
    real_time: bool

    @property
    def missed_share(self) -> float:
        """Share of the periods that were skipped or went unanswered."""
        return (self.skipped + self.unanswered) / self.periods

    def line(self, name: str) -> str:
        """The result in one line."""
        verdict = "met" if self.missed_share < _ALLOWED else "NOT met"
        return (
            f"{name}, {self.rate_hz:g} Hz: {self.periods} periods, {self.skipped} skipped, {self.unanswered} "
            f"unanswered: {100 * self.missed_share:.3f} % missed (below {100 * _ALLOWED:g} %: {verdict}); measurement "
            f"to command p50 {self.latency_p50_ms:.3f}, p99 {self.latency_p99_ms:.3f}, p99.9 "
            f"{self.latency_p999_ms:.3f} ms"
        )


def measure(name: str, seconds: float, folder: Path, *, real_time: bool) -> WallResult:
    """Run one of the two loops for `seconds` of counted periods.

    Raises
    ------
    GraphError : a process died, or the loop does not close.
    """
    rate, model = _RATES[name], folder / "model.yaml"
    shared: dict[str, Value] = {"preset": "integrated", "time": "wall", "rate_hz": rate}
    graph = Graph(free_domain(), folder / name.replace(" ", "_"))
    # before the first node of this process: its threads are not to run before those of the loop
    os.environ.update(graph.environment())
    conductor = Conductor(graph)
    try:
        with _Priority(real_time) as allowed:
            if name == _COMPOSED:
                signal: dict[str, Value] = {"signal": "sine"}
                graph.start(
                    "loop",
                    arguments=["--with-reference"],
                    parameters={**shared, **signal},
                    parameter_file=model,
                )
            else:
                graph.start("plant", parameters=shared)
                graph.start("estimator", parameters={"preset": "integrated"}, parameter_file=model)
                held: Mapping[str, Value] = {**shared, "reference_hold": True}
                graph.start("controller", parameters=held, parameter_file=model)
        publisher = _set_point(conductor) if name == _PROCESSES else None
        conductor.wait_for(
            f"{seconds:g} s of the loop in {name}",
            lambda: _count(conductor) >= seconds * rate,
            60.0 + 1.5 * seconds,
        )
        told = conductor.statuses[_PACE][2]
        del publisher
    finally:
        graph.end()
        conductor.close()
    periods, skipped, unanswered = (int(told[key]) for key in ("periods", "skipped", "unanswered"))
    middle, most, nearly_all = (float(told[f"latency_{key}_ms"]) for key in ("p50", "p99", "p999"))
    return WallResult(rate, periods, skipped, unanswered, middle, most, nearly_all, allowed)


def _count(conductor: Conductor) -> int:
    return int(conductor.value(_PACE, "periods") or "0")


def _set_point(conductor: Conductor) -> Publisher:
    publisher = conductor.node.create_publisher(JointState, "/vo2/reference", LATCHED_QOS)
    publisher.publish(SampleWriter(REFERENCE_CHANNELS, "integrated").write(0, (_SET_POINT_M,)))
    return publisher


class _Priority:
    """Processes started inside inherit real-time scheduling, where the system allows it."""

    def __init__(self, wanted: bool) -> None:
        self._wanted = wanted
        self._before = os.sched_getscheduler(0)

    def __enter__(self) -> bool:
        if not self._wanted:
            return False
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        except PermissionError:
            return False
        return True

    def __exit__(self, *_: object) -> None:
        os.sched_setscheduler(0, self._before, os.sched_param(0))


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 1 if a loop could not run, 2 on bad input."""
    options = _parser().parse_args(args)
    if not options.seconds > 0:
        print(f"bench --wall: --seconds: found {options.seconds:g}, need a number above 0", file=sys.stderr)
        return 2
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        save_small_model(Path(folder) / "model.yaml")
        for name in (_COMPOSED, _PROCESSES):
            print(f"{name} at {_RATES[name]:g} Hz for {options.seconds:g} s", flush=True)
            try:
                result = measure(name, options.seconds, Path(folder), real_time=not options.ordinary)
            except GraphError as error:
                print(f"bench --wall: {error}", file=sys.stderr)
                return 1
            found[name.replace(" ", "_")] = {**asdict(result), "missed_share": result.missed_share}
            print(result.line(name), flush=True)
    allowed = all(each["real_time"] for each in found.values())
    not_allowed = (
        "not asked for" if options.ordinary else "not allowed here (it needs the right CAP_SYS_NICE)"
    )
    print(f"real-time scheduling: {f'SCHED_FIFO, priority {_PRIORITY}' if allowed else not_allowed}")
    if options.json:
        Path(options.json).write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="./vo2 bench --wall", description=__doc__)
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="Length of each of the two runs. Default: 20."
    )
    parser.add_argument("--ordinary", action="store_true", help="Do not ask for real-time scheduling.")
    parser.add_argument("--json", metavar="FILE", help="Write the figures there as well.")
    return parser


if __name__ == "__main__":
    sys.exit(main())
