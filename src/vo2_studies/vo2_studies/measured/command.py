"""The command `measured`."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING

from vo2_studies.reproduce.pool import hear_the_end, interrupt_is_ours

if TYPE_CHECKING:
    from vo2_studies.measured.report import SetReport

from vo2_models.command_line import refuse

__all__ = ["main"]

_DESCRIPTION = """
Convert other people's recordings (pulses and relaxations of a VO2 device, a piezo) to bags, fit them without and with
what may be missing, let the diagnosis look at them, and show on data that no fit saw what each explains.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 whatever was found, 2 without data or on bad input, 130 after Ctrl-C."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        print(
            "measured: interrupted; the sets named so far stand in no report, run it again", file=sys.stderr
        )
        return 130


def _run(arguments: Sequence[str] | None) -> int:
    from vo2_studies.measured.sources import SOURCES

    options = _parser(tuple(SOURCES)).parse_args(arguments)
    from vo2_studies.preisach.measured import data_folder

    data = options.data or data_folder()
    if data is None or not data.is_dir():
        where = "../shared/data beside the checkout" if data is None else str(data)
        return refuse(
            "measured", f"--data: found no folder {where}, need the measured recordings (or set VO2_DATA)"
        )
    keys = options.only or list(SOURCES)
    there = [key for key in keys if (data / SOURCES[key].file).exists()]
    missing = [SOURCES[key].file for key in keys if key not in there]
    if not there:
        return refuse("measured", f"--data: found none of {', '.join(missing)} in {data}, need at least one")
    if options.jobs < 1:
        return refuse("measured", f"--jobs: found {options.jobs}, need at least 1")
    from vo2_models.io import OutputFolder

    from vo2_studies.measured.report import write_report
    from vo2_studies.measured.words import across_sets, diagnosis_sentence, verdict

    reports = {}
    outputs = OutputFolder(options.output, ("report.html", "measured.json", "bags"))
    try:
        outputs.check()
        options.output.mkdir(parents=True, exist_ok=True)
        workers = min(len(there), options.jobs)
        for key, report in _studies(there, data, options, workers):
            reports[key] = report
            print(f"{report.source.title} ({report.seconds:.0f} s)\n  {verdict(report.study)}", flush=True)
            if report.diagnosis is not None:
                print(f"  {diagnosis_sentence(report.diagnosis)}", flush=True)
        for text in across_sets([reports[key].study for key in there]):
            print(text)
        html, answer = write_report(options.output, [reports[key] for key in there], missing)
        outputs.remember()
    except ValueError as error:
        return refuse("measured", error)
    except OSError as error:
        return refuse("measured", f"{options.output}: cannot be written ({error.strerror or error})")
    for name in missing:
        print(f"measured: {data / name} is not there: left out", file=sys.stderr)
    print(f"{html}\n{answer}")
    return 0


def _studies(
    keys: Sequence[str], data: Path, options: argparse.Namespace, workers: int
) -> Iterator[tuple[str, SetReport]]:
    """Yield set and report in the order in which the sets are done."""
    cores = (os.cpu_count() or 1) // workers
    before = set(multiprocessing.active_children())
    # spawn: a fork of a process whose libraries run threads may hang
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=hear_the_end) as pool:
        try:
            with interrupt_is_ours():
                jobs = {
                    pool.submit(
                        _study, key, data, options.output, not options.no_diagnosis, options.quiet, cores
                    ): key
                    for key in keys
                }
            for job in as_completed(jobs):
                yield jobs[job], job.result()
        except (KeyboardInterrupt, GeneratorExit):  # the latter where the caller was interrupted
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()
            raise


def _study(key: str, data: Path, output: Path, diagnose: bool, quiet: bool, cores: int) -> SetReport:
    """Do one set on so many cores; runs in a process of its own."""
    from vo2_models.numerics.parallel import use_cores

    from vo2_studies.measured.cases import cases_of
    from vo2_studies.measured.preset_diagnosis import diagnose_set
    from vo2_studies.measured.report import SetReport
    from vo2_studies.measured.sources import SOURCES, as_bags
    from vo2_studies.measured.study import study_set
    from vo2_studies.measured.where import line_of

    def say(text: str) -> None:
        if not quiet:
            print(f"measured: {text}", file=sys.stderr, flush=True)

    use_cores(cores)
    began = time.monotonic()
    bags = output / "bags" / key
    if bags.exists():  # of an earlier run: a bag is never written over
        shutil.rmtree(bags)
    traces = as_bags(SOURCES[key], data, bags)
    found = study_set(key, cases_of(key, traces), say=say)
    answer = None
    if diagnose:
        say(f"{key}: the diagnosis")
        answer = diagnose_set(found)
    line = line_of(found.best.fits[0], found.cases)
    problems = tuple(dict.fromkeys(text for trace in traces for text in trace.problems))
    return SetReport(SOURCES[key], found, answer, line, problems, time.monotonic() - began)


def _parser(keys: tuple[str, ...]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="measured", description=_DESCRIPTION)
    parser.add_argument(
        "--output", type=Path, required=True, help="folder for report.html, measured.json and the bags"
    )
    parser.add_argument(
        "--data",
        type=Path,
        help="folder of the recordings (default: $VO2_DATA, or ../shared/data of a checkout)",
    )
    parser.add_argument("--only", action="append", choices=keys, help="take only this set; may be repeated")
    parser.add_argument(
        "--no-diagnosis",
        action="store_true",
        help="leave out the diagnosis itself, which takes half of the time",
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="sets side by side (default: one a core)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    return parser
