"""The command `challenge`: draw, diagnose blindly, score; resumable."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from vo2_models.io import OutputFolder, write_whole

from vo2_studies.challenge.conditions import CONDITIONS
from vo2_studies.challenge.excitation import EXCITATIONS
from vo2_studies.challenge.families import ALL, FAMILIES
from vo2_studies.challenge.plan import (
    BODYLESS,
    CLEAN,
    INFORMATIVE,
    KINDS,
    PRESET,
    RANGE,
    ROUND,
    VARIED,
    CasePlan,
    Choice,
)
from vo2_studies.challenge.recordings.bodyless import BodylessSettings
from vo2_studies.challenge.recordings.draw import MeasuredSettings
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
    write_case,
)

__all__ = ["main"]

_REPORTS = ("challenge.json", "challenge.html")
QUICK_SAMPLES = 3000
"""Of each recording to be diagnosed with --quick."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="challenge",
        description="Proof on concealed data: random devices and effects, recorded by an independent simulation, "
        "diagnosed by separate processes that get only the bags, then scored.",
    )
    parser.add_argument("--cases", type=int, help="number of cases; a longer run continues a shorter")
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"one round of all kinds, {len(ROUND)} cases of {QUICK_SAMPLES} samples: minutes, for continuous integration",
    )
    parser.add_argument("--seed", type=int, required=True, help="decides devices, effects and noise")
    parser.add_argument("--output", type=Path, required=True, help="folder; finished cases in it are kept")
    parser.add_argument("--jobs", type=int, default=1, help="cases at the same time")
    parser.add_argument(
        "--only-effects", default="", help="comma-separated ids: one-effect cases of these only"
    )
    parser.add_argument("--kinds", default="", help=f"comma-separated, of {', '.join(KINDS)}")
    parser.add_argument("--device", help="one preset only")
    parser.add_argument("--misfit", type=float, default=0.1, help="scatter of the concealed hysteresis")
    parser.add_argument(
        "--family", default=ALL, help=f"concealed hysteresis: {ALL} (in turn) or one of {', '.join(FAMILIES)}"
    )
    parser.add_argument("--leave-out", default="", help="with --family all: all but this one")
    parser.add_argument(
        "--excitation",
        default=INFORMATIVE,
        help=f"what is recorded: {VARIED} (in turn) or one of {', '.join(EXCITATIONS)}; on slow major loops, and more so "
        "on a single one, many effects look alike",
    )
    parser.add_argument(
        "--condition",
        default=CLEAN,
        help=f"how it is recorded: {VARIED} (in turn) or one of {', '.join(CONDITIONS)}",
    )
    parser.add_argument(
        "--samples",
        default="",
        help="of the recording, N or N-M (drawn log-uniformly); default: the excitation's",
    )
    parser.add_argument(
        "--rigs",
        default=PRESET,
        help=f"{PRESET}; {RANGE}: currents, times and ranges over factors of 3 about it, told by a device file; "
        f"{BODYLESS}: a drive, one law of hysteresis, a lag, one response, and no heated body",
    )
    parser.add_argument(
        "--timeout", type=float, default=300.0, help="seconds for each fit and each diagnosis"
    )
    parser.add_argument(
        "--follow-up", action="store_true", help="play proposed excitations and diagnose again"
    )
    parser.add_argument(
        "--recordings",
        type=Path,
        help="conceal known changes in the measurements of this data folder, in place of drawn devices",
    )
    parser.add_argument("--sets", default="", help="with --recordings: comma-separated, these devices only")
    parser.add_argument("--keep-bags", action="store_true", help="leave all bags in the output folder")
    parser.add_argument("--retry-failed", action="store_true", help="run cases without diagnosis again")
    parser.add_argument("--bags-only", action="store_true", help="write bags and answers, diagnose nothing")
    return parser


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _samples(text: str) -> tuple[int, int] | None:
    if not text:
        return None
    low, _, high = text.partition("-")
    if not low.isdecimal() or not (high or low).isdecimal():
        raise ValueError(f"samples: found {text!r}, need N or N-M")
    return int(low), int(high or low)


def _choice(arguments: argparse.Namespace) -> Choice:
    return Choice(
        family=arguments.family,
        leave_out=arguments.leave_out,
        device=arguments.device,
        only_effects=_words(arguments.only_effects),
        kinds=_words(arguments.kinds),
        condition=arguments.condition,
        excitation=arguments.excitation,
        samples=_samples(arguments.samples),
        rigs=arguments.rigs,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, 2 on unusable arguments, 130 when interrupted."""
    arguments = _parser().parse_args(argv)
    try:
        return _run(arguments, argv)
    except KeyboardInterrupt:  # while cases are drawn or scored, or the second one
        print(INTERRUPTED, file=sys.stderr)
        return 130


def _run(arguments: argparse.Namespace, argv: Sequence[str] | None) -> int:
    try:
        if arguments.quick:
            arguments.cases = arguments.cases or len(ROUND)
            arguments.samples = arguments.samples or str(QUICK_SAMPLES)
        if arguments.cases is None:
            raise ValueError("cases: found none, need --cases N or --quick")
        if arguments.cases < 1 or arguments.jobs < 1 or arguments.seed < 0:
            raise ValueError(
                "cases, jobs, seed: found a number too small, need cases and jobs >= 1, seed >= 0"
            )
        if not 0 <= arguments.misfit <= 0.3:
            raise ValueError(f"misfit: found {arguments.misfit}, need 0 to 0.3")
        settings: Settings | MeasuredSettings | BodylessSettings
        if arguments.rigs == BODYLESS:
            settings = BodylessSettings(arguments.seed, arguments.family, _words(arguments.kinds))
        else:
            settings = Settings(arguments.seed, arguments.misfit, _choice(arguments))
        if arguments.recordings is not None:
            settings = MeasuredSettings(
                arguments.seed, str(arguments.recordings.resolve()), _words(arguments.sets)
            )
        plans = [settings.plan(index) for index in range(arguments.cases)]
        paths = Paths(arguments.output.resolve())
        _claim(paths, settings)
    except (ValueError, OSError) as error:
        print(f"challenge: {error}", file=sys.stderr)
        return 2
    if arguments.bags_only:
        return _write_bags(plans, paths, settings)
    if arguments.retry_failed:
        for plan in plans:
            if finished(paths, plan.index) and load_json(paths.result(plan.index))["diagnosis"] is None:
                paths.result(plan.index).unlink()
    runner = CaseRunner(
        settings,
        paths,
        timeout_s=arguments.timeout,
        keep_bags=arguments.keep_bags,
        follow_up=arguments.follow_up,
        threads=1 if arguments.jobs > 1 else 0,
    )
    try:
        with interrupt_on_sigterm():
            done = run_all(plans, runner, arguments.jobs)
        _report(plans, paths, argv)
    except OSError as error:
        print(f"challenge: {error}; finished cases are kept", file=sys.stderr)
        return 2
    return 0 if done else 130


def _claim(paths: Paths, settings: Settings | MeasuredSettings | BodylessSettings) -> None:
    """Record the settings in the output folder, or check that they are those it was begun with."""
    wanted = json.loads(json.dumps(asdict(settings)))
    file = paths.root / "settings.json"
    if file.exists():
        # a setting that is younger than the folder had its default
        found = _flat(
            json.loads(json.dumps(asdict(Settings(0)))) if isinstance(settings, Settings) else {}
        ) | _flat(load_json(file))
        if different := [key for key, value in _flat(wanted).items() if found.get(key) != value]:
            raise ValueError(
                f"output: {paths.root} was begun with another {', '.join(different)}, need another folder"
            )
        return
    # without its settings nothing in it is ours
    OutputFolder(paths.root, ("answers", "cases", "models", "results", *_REPORTS)).check()
    save_json(file, wanted)


def _flat(settings: dict) -> dict:
    """Return settings with what they choose from beside them."""
    return {key: value for key, value in settings.items() if key != "choice"} | settings.get("choice", {})


def _write_bags(
    plans: Sequence[CasePlan], paths: Paths, settings: Settings | MeasuredSettings | BodylessSettings
) -> int:
    for plan in plans:
        if paths.answer(plan.index).exists() and (paths.case(plan.index) / "test" / "metadata.yaml").exists():
            continue
        write_case(settings.case(plan), paths)
        print(f"[{plan.index + 1}/{len(plans)}] {paths.case(plan.index)}", file=sys.stderr)
    return 0


def _report(plans: Sequence[CasePlan], paths: Paths, argv: Sequence[str] | None) -> None:
    """Score what is finished; write challenge.json and challenge.html; print the scores."""
    from vo2_studies.challenge.confusion import confusion_text
    from vo2_studies.challenge.judging import judge
    from vo2_studies.challenge.page import challenge_page, score_lines
    from vo2_studies.challenge.scoring import score

    indices = [plan.index for plan in plans if finished(paths, plan.index)]
    if not indices:
        return
    judgements = [judge(load_json(paths.answer(k)), load_json(paths.result(k))) for k in indices]
    scores = score(judgements) | {"drawn": load_json(paths.root / "settings.json")}
    save_json(paths.root / "challenge.json", scores)
    command = "./vo2 run vo2_identification challenge " + " ".join(sys.argv[1:] if argv is None else argv)
    write_whole(paths.root / "challenge.html", challenge_page(scores, judgements, command))
    print(confusion_text(judgements))
    print()
    for words, _, value, spread, count, wanted, verdict in score_lines(scores):
        print(f"{words:56s}{value:>8s}  {spread:14s}{'n ' + count if count else '':8s}{wanted:15s}{verdict}")
    print(f"\n{paths.root / 'challenge.json'}\n{paths.root / 'challenge.html'}")
