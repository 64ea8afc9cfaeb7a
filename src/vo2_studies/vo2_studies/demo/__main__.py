"""`./vo2 demo`: the main job from start to report."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from vo2_interface.one_host import free_domain
from vo2_models.io import OutputFolder, write_whole

from vo2_studies.demo.acts import ACTS, act
from vo2_studies.demo.concealed import check_choice
from vo2_studies.demo.conductor import Conductor
from vo2_studies.demo.graph import Graph, GraphError
from vo2_studies.demo.stage import Stage

__all__ = ["main"]

_OWN = (
    "bag",
    "bag_replayed",
    "bag_concealed",
    "measured",
    "diagnosis",
    "logs",
    "report.html",
    "metrics.json",
    "model.yaml",
)
"""What the demo writes into its folder, and replaces when it runs again."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the acts; return 0, 1 if the graph or the diagnosis failed, 2 on bad input."""
    options = _parser().parse_args(args)
    folder = Path(options.output)
    if problem := _unusable(folder):
        print(f"demo: {problem}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        if options.seeds:
            from vo2_studies.demo.seeds import run_seeds

            with OutputFolder(folder, ("seeds.json",)).replaced():
                run_seeds(options.preset, range(options.seed, options.seed + options.seeds), folder, print)
            return 0
        check_choice(options.effect, options.preset)
        with OutputFolder(folder, _OWN).replaced():
            return _run(options, folder)
    except (ValueError, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2


def _run(options: argparse.Namespace, folder: Path) -> int:
    seed = options.seed
    print(f"seed {seed}; ./vo2 demo --seed {seed} --effect {options.effect} repeats this run", flush=True)
    # a domain of its own, so that nothing else on this host is disturbed or disturbs
    graph = Graph(options.domain or free_domain(), folder / "logs")
    os.environ.update(graph.environment())
    conductor = Conductor(graph)
    stage = Stage(folder, options.preset, seed, options.effect, graph, conductor)
    conductor.on_progress = _show_progress(stage)
    try:
        for name in options.acts or ACTS:
            began = time.monotonic()
            act(name)(stage)
            stage.metrics.setdefault("acts_s", {})[name] = round(time.monotonic() - began, 1)
        _finish(stage)
        for failure in stage.failures:
            print(f"demo: {failure}", file=sys.stderr)
        return 1 if stage.failures else 0
    except (GraphError, RuntimeError, ValueError) as error:
        stage.hush()
        print(f"demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        stage.hush()
        print("demo: interrupted; ending the nodes", file=sys.stderr)
        return 130
    finally:
        if stage.diagnosing is not None:
            stage.diagnosing.end()
        graph.end()
        conductor.close()


def _finish(stage: Stage) -> None:
    from vo2_studies.demo.report import write_report

    stage.metrics["setup_s"] = float(os.environ.get("VO2_SETUP_S", "0"))
    stage.graph.check()
    stage.metrics["cpu_s"] = {name: round(seconds, 1) for name, seconds in stage.graph.cpu_s.items()}
    stage.metrics["peak_memory_mb"] = round(max(stage.graph.peak_kb, _own_peak_kb()) / 1024.0, 1)
    stage.metrics["run_s"] = round(time.monotonic() - stage.started, 1)
    report = write_report(stage)
    # with the report itself
    stage.metrics["run_s"] = round(time.monotonic() - stage.started, 1)
    metrics = stage.folder / "metrics.json"
    write_whole(metrics, json.dumps(stage.metrics, indent=2) + "\n")
    stage.say(f"done; peak memory of a process {stage.metrics['peak_memory_mb']:g} MB")
    for line in stage.closing_lines():
        print(line)
    print(f"report:  {report}\nbag:     {stage.bag}\nmetrics: {metrics}")


def _own_peak_kb() -> int:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _show_progress(stage: Stage) -> Callable[[str, str, object], None]:
    def show(name: str, text: str, _values: object) -> None:
        if name.endswith((": progress", ": time")):
            stage.show(f"{name.split(':')[0]}: {text}")

    return show


def _unusable(folder: Path) -> str:
    """Return why nothing can be written into `folder`, empty if it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        return f"{folder}: cannot be written ({error.strerror}); choose another folder with --output"
    return ""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="./vo2 demo", description=__doc__)
    parser.add_argument(
        "--output", default="output/demo", help="Folder of the results. Default: output/demo."
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=1,
        help="Seed of the device, its noise, the random levels and the concealed effect. Default: 1.",
    )
    parser.add_argument(
        "--effect", default="random", help="Effect to conceal in the last act: an id, random, or none."
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=0,
        metavar="N",
        help="Instead: the same experiments on N devices without the graph; prints mean and spread.",
    )
    parser.add_argument("--preset", default="integrated", help=argparse.SUPPRESS)
    parser.add_argument("--domain", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--acts", nargs="+", choices=ACTS, help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
