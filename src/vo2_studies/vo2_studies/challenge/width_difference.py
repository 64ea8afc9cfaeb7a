"""How often `diagnose` names `loop_width_difference`: `python -m vo2_studies.challenge.width_difference`.

Devices, recordings and the form of the effect are those of `challenge`, whose simulation shares nothing with the
catalogue; each case is fitted and diagnosed by separate processes that see the bags only. Cases are taken in the order of
their numbers; those whose difference lies outside `RANGE_K` are drawn and passed over without a diagnosis.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from vo2_models.io import InputError, OutputFolder

from vo2_studies.challenge.draw import draw_case
from vo2_studies.challenge.plan import CasePlan, Choice
from vo2_studies.challenge.runner import (
    INTERRUPTED,
    CaseRunner,
    Paths,
    Settings,
    finished,
    interrupt_on_sigterm,
    load_json,
    run_all,
    save_json,
)

__all__ = ["RANGE_K", "cases_in_range", "main"]

NAME = "loop_width_difference"
RANGE_K = (0.3, 1.5)
"""Differences that are to be named [K]."""


def cases_in_range(settings: Settings, count: int) -> Iterator[tuple[CasePlan, float]]:
    """Yield the first `count` cases whose difference [K] lies within `RANGE_K`, either sign."""
    found = 0
    for index in itertools.count():
        if found == count:
            return
        plan = settings.plan(index)
        (effect,) = draw_case(settings.seed, plan, misfit=settings.misfit).answer["effects"]
        difference = effect["parameters"]["width"]["value"]
        if RANGE_K[0] <= abs(difference) <= RANGE_K[1]:
            found += 1
            yield plan, difference


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not finished yet and print one line a case, and the two counts; 130 after Ctrl-C."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:  # while cases are drawn
        print(INTERRUPTED, file=sys.stderr)
        return 130


def _run(arguments: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(prog="width_difference", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20, help="with the effect, and as many without (20)")
    parser.add_argument("--seed", type=int, default=1, help="decides devices, effects and noise (1)")
    parser.add_argument("--output", type=Path, required=True, help="folder; finished cases in it are kept")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time (1)")
    parser.add_argument(
        "--timeout", type=float, default=300.0, help="seconds for each fit and each diagnosis"
    )
    options = parser.parse_args(arguments)
    if min(options.cases, options.jobs) < 1 or options.timeout <= 0:
        print("width_difference: --cases, --jobs, --timeout: need at least 1", file=sys.stderr)
        return 2
    outputs = OutputFolder(options.output, ("width_difference.json",))
    try:
        outputs.check()
    except InputError as error:
        print(f"width_difference: --output: {error}", file=sys.stderr)
        return 2
    named: dict[str, list[bool]] = {"with": [], "without": []}
    lines, done = [], True
    for kind, choice in (("with", Choice(only_effects=(NAME,))), ("without", Choice(kinds=("none",)))):
        settings = Settings(options.seed, choice=choice)
        runner = CaseRunner(
            settings,
            Paths(options.output / kind),
            timeout_s=options.timeout,
            threads=1 if options.jobs > 1 else 0,
        )
        plans = (
            list(cases_in_range(settings, options.cases))
            if kind == "with"
            else [(settings.plan(k), 0.0) for k in range(options.cases)]
        )
        with interrupt_on_sigterm():
            done = done and run_all([plan for plan, _ in plans], runner, options.jobs)
        for plan, difference in plans:
            if finished(runner.paths, plan.index):
                line = _case(runner, plan, difference)
                lines.append({"kind": kind, **line})
                named[kind].append(line["named"][:1] == [NAME])
                print(_words(kind, line), flush=True)
    save_json(options.output / "width_difference.json", lines)
    outputs.remember()
    count = {kind: f"{sum(hits)} of {len(hits)}" for kind, hits in named.items()}
    print(f"{NAME} named first: {count['with']} recordings with it, {count['without']} without")
    others = Counter(
        line["named"][0] if line["named"] else "nothing" for line in lines if line["kind"] == "with"
    )
    print("named first where it acts: " + ", ".join(f"{name} {n}" for name, n in others.most_common()))
    return 0 if done else 130


def _case(runner: CaseRunner, plan: CasePlan, difference: float) -> dict:
    """What was named in a finished case."""
    result = load_json(runner.paths.result(plan.index))
    diagnosis = result["diagnosis"]
    return {
        "index": plan.index,
        "device": plan.device,
        "family": plan.family,
        "difference_K": difference,
        "failure": result["failure"],
        "verdict": diagnosis["verdict"] if diagnosis else None,
        "named": [effect["id"] for effect in diagnosis["effects"]] if diagnosis else [],
        "seconds": result["seconds"],
    }


def _words(kind: str, line: dict) -> str:
    said = ", ".join(line["named"]) or line["failure"] or line["verdict"]
    return (
        f"{kind:8s}case {line['index']:3d}  {line['device']:11s}{line['family']:16s}"
        f"{line['difference_K']:+6.2f} K  {said}"
    )


if __name__ == "__main__":
    sys.exit(main())
