"""How often `diagnose` names `loop_width_difference`: `python -m vo2_studies.challenge.width_difference`.

Devices, recordings and the form of the effect are those of `challenge`, whose simulation shares nothing with the
catalogue; each case is fitted and diagnosed by separate processes that see the bags only. Cases are taken in the order of
their numbers; those whose difference lies outside `RANGE_K` are drawn and passed over without a diagnosis.
"""

from __future__ import annotations

import argparse
import itertools
import signal
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from vo2_models.io import InputError, OutputFolder

from vo2_studies.challenge.draw import draw_case
from vo2_studies.challenge.plan import CasePlan, Choice
from vo2_studies.challenge.runner import CaseRunner, Paths, Settings, finished, load_json, save_json

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
    parser = argparse.ArgumentParser(prog="width_difference", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20, help="with the effect, and as many without (20)")
    parser.add_argument("--seed", type=int, default=1, help="decides devices, effects and noise (1)")
    parser.add_argument("--output", type=Path, required=True, help="folder; finished cases in it are kept")
    parser.add_argument(
        "--timeout", type=float, default=300.0, help="seconds for each fit and each diagnosis"
    )
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.timeout <= 0:
        print("width_difference: --cases, --timeout: need at least 1", file=sys.stderr)
        return 2
    outputs = OutputFolder(options.output, ("width_difference.json",))
    named: dict[str, list[bool]] = {"with": [], "without": []}
    lines = []
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        outputs.check()
    except InputError as error:
        print(f"width_difference: --output: {error}", file=sys.stderr)
        return 2
    try:
        for kind, choice in (("with", Choice(only_effects=(NAME,))), ("without", Choice(kinds=("none",)))):
            settings = Settings(options.seed, choice=choice)
            runner = CaseRunner(settings, Paths(options.output / kind), timeout_s=options.timeout)
            plans = (
                cases_in_range(settings, options.cases)
                if kind == "with"
                else ((settings.plan(k), 0.0) for k in range(options.cases))
            )
            for plan, difference in plans:
                line = _case(runner, plan, difference)
                lines.append({"kind": kind, **line})
                named[kind].append(line["named"][:1] == [NAME])
                print(_words(kind, line), flush=True)
                save_json(options.output / "width_difference.json", lines)
                outputs.remember()
    except KeyboardInterrupt:
        runner.stop()
        print(
            "width_difference: interrupted; finished cases are kept, the same command continues",
            file=sys.stderr,
        )
        return 130
    finally:
        signal.signal(signal.SIGTERM, before)
    count = {kind: f"{sum(hits)} of {len(hits)}" for kind, hits in named.items()}
    print(f"{NAME} named first: {count['with']} recordings with it, {count['without']} without")
    others = Counter(
        line["named"][0] if line["named"] else "nothing" for line in lines if line["kind"] == "with"
    )
    print("named first where it acts: " + ", ".join(f"{name} {n}" for name, n in others.most_common()))
    return 0


def _case(runner: CaseRunner, plan: CasePlan, difference: float) -> dict:
    """What was named in one case, from its result if it is finished already."""
    paths = runner.paths
    result = load_json(paths.result(plan.index)) if finished(paths, plan.index) else runner.run(plan)
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
