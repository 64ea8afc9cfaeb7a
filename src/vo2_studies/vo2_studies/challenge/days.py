"""Several recordings, each of its own day: `python -m vo2_studies.challenge.days`.

A device is fitted to its calibration and recorded three times later, each with its own path, from the second on with
another room, zero and time constant each. By turns nothing changes, an effect acts on all days, or on the first only.
Devices, recordings and effects are those of `challenge`; each case is fitted and diagnosed by separate processes that see
the bags only.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vo2_models.io import InputError, OutputFolder

from vo2_studies.challenge.draw import Case, day_recording
from vo2_studies.challenge.figures import rate
from vo2_studies.challenge.plan import CasePlan, Choice, plan_case
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

__all__ = ["KINDS", "DaySettings", "judged", "main"]

KINDS = ("none", "all", "first")
"""On which days an effect acts."""
DAYS = 3


@dataclass(frozen=True)
class DaySettings(Settings):
    """Cases of several days; the kinds take turns."""

    def plan(self, index: int) -> CasePlan:
        """Return the plan of case `index`."""
        kind = "none" if KINDS[index % len(KINDS)] == "none" else "one"
        return plan_case(self.seed, index, replace(self.choice, kinds=(kind,)))

    def case(self, plan: CasePlan) -> Case:
        """Draw the case of `plan`: its test is the first day."""
        case = super().case(plan)
        days = KINDS[plan.index % len(KINDS)]
        acting = case.answer if days == "all" else {**case.answer, "effects": []}
        others, what = [], []
        for day in range(1, DAYS):
            recorded, other = day_recording(self.seed, plan, acting, day, misfit=self.misfit)
            others.append((f"day_{day}", recorded))
            what.append(other)
        return replace(case, answer={**case.answer, "acts": days, "days": what}, others=tuple(others))


def judged(answer: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> tuple[str, list[list[str]]]:
    """Return right, set (one that holds the truth), unknown, missed or wrong, and what was named on each day.

    A name on a day on which nothing acts is wrong, however right it is on another.

    Parameters
    ----------
    answer, diagnosis : of a case, as the files hold them
    """
    by_day = diagnosis.get("recordings") or [{"effects": diagnosis["effects"]}] * DAYS
    named = [[name for e in day["effects"] for name in (e.get("siblings") or [e["id"]])] for day in by_day]
    true = {name for e in answer["effects"] for name in (e["id"], *e["siblings"])}
    acts = [answer["acts"] == "all" or (answer["acts"] == "first" and day == 0) for day in range(DAYS)]
    found = []
    for names, acting in zip(named, acts, strict=True):
        if not names:
            found.append("missed" if acting else "right")
        elif names == ["unknown"]:
            found.append("unknown")
        elif acting and true & set(names):
            found.append("right" if len(names) == 1 else "set")
        else:
            found.append("wrong")
    order = ("wrong", "missed", "unknown", "set", "right")
    return min(found, key=order.index), named


def _line(runner: CaseRunner, plan: CasePlan, result: Mapping[str, Any]) -> dict[str, Any]:
    """What was found in a finished case."""
    answer = load_json(runner.paths.answer(plan.index))
    found, named = ("failed", []) if result["failure"] else judged(answer, result["diagnosis"])
    return {
        "index": plan.index,
        "acts": answer["acts"],
        "true": ", ".join(effect["id"] for effect in answer["effects"]),
        "found": found,
        "named": named,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not finished yet and print one line a case, and the counts of each kind; 130 after Ctrl-C."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:  # while cases are drawn
        print(INTERRUPTED, file=sys.stderr)
        return 130


def _run(arguments: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(prog="days", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=24, help="a third of each kind (24)")
    parser.add_argument("--seed", type=int, default=1, help="decides devices, effects and noise (1)")
    parser.add_argument("--family", default="all", help="of the hysteresis (all)")
    parser.add_argument("--samples", type=int, help="of each later recording (what its path takes)")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time (1)")
    parser.add_argument("--output", type=Path, required=True, help="folder; finished cases in it are kept")
    options = parser.parse_args(arguments)
    if min(options.cases, options.jobs) < 1:
        print("days: --cases, --jobs: need at least 1", file=sys.stderr)
        return 2
    samples = (options.samples, options.samples) if options.samples else None
    settings = DaySettings(options.seed, choice=Choice(family=options.family, samples=samples))
    outputs = OutputFolder(options.output, ("days.json",))
    runner = CaseRunner(
        settings, Paths(options.output), timeout_s=600.0, threads=1 if options.jobs > 1 else 0
    )
    try:
        outputs.check()
        settings.choice.check()
        plans = [settings.plan(k) for k in range(options.cases)]
    except (InputError, ValueError) as error:
        print(f"days: {error}", file=sys.stderr)
        return 2
    with interrupt_on_sigterm():
        done = run_all(plans, runner, options.jobs, lambda plan, result: _line(runner, plan, result)["found"])
    lines = []
    for plan in (plan for plan in plans if finished(runner.paths, plan.index)):
        result = load_json(runner.paths.result(plan.index))
        line = _line(runner, plan, result)
        said = result["failure"] or " | ".join(", ".join(day) or "-" for day in line["named"])
        print(
            f"case {plan.index:3d}  {plan.device:11s}{plan.family:16s}{line['acts']:6s}{line['true']:26s}"
            f"{line['found']:8s}{said}"
        )
        lines.append(line)
    save_json(options.output / "days.json", lines)
    outputs.remember()
    for kind in KINDS:
        own = [line["found"] for line in lines if line["acts"] == kind]
        low, high = rate(found == "right" for found in own)[1] or (0.0, 1.0)
        counts = ", ".join(
            f"{own.count(found)} {found}"
            for found in ("right", "set", "unknown", "missed", "wrong", "failed")
        )
        print(f"{kind:6s}{len(own):3d} cases: {counts} (right: {100 * low:.0f} to {100 * high:.0f} %)")
    print(f"results in {options.output / 'days.json'}")
    return 0 if done else 130


if __name__ == "__main__":
    sys.exit(main())
