"""`fit --bags` and `diagnose --bags`: from options to tasks, from results to the table and the page."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from vo2_models.io import InputError, OutputFolder, check_place, write_whole
from vo2_models.parameters import Value

__all__ = ["BATCH_HELP", "add_batch_options", "diagnose_folder", "fit_folder"]

BATCH_HELP = (
    "folder with bags, each worked on by itself; --output is then a folder: table.parquet, table.csv, report.html and a "
    "folder for each bag. The same command goes on where it was interrupted"
)
_TABLES = ("table.csv", "table.parquet", "report.html")
_BAGS = "bags"
_MOST_JOBS = 256


def add_batch_options(parser: argparse.ArgumentParser) -> None:
    """Give the `parser` of a command the options of work over a folder."""
    parser.add_argument("--bags", type=Path, metavar="FOLDER", help=BATCH_HELP)
    parser.add_argument(
        "--jobs",
        type=_jobs,
        metavar="N",
        help="with --bags: bags at a time on this machine (default: one for each processor)",
    )
    parser.add_argument(
        "--dask",
        default="",
        metavar="ADDRESS",
        help="with --bags: scheduler of a Dask cluster, such as tcp://10.0.0.1:8786, whose workers see the same files",
    )


def fit_folder(options: argparse.Namespace) -> int:
    """Fit every bag of a folder; return the exit status of the command.

    Parameters
    ----------
    options : of `fit`, with `bags`

    Raises
    ------
    ValueError, OSError : what cannot be used or written, in one line.
    """
    from vo2_models.device.description import preset

    common = {
        "command": "fit",
        "device": preset(options.device).key,
        "options": {"plays": options.plays, "simulation_only": options.simulation_only},
    }
    return _run("fit", options, common)


def diagnose_folder(options: argparse.Namespace, parameters: Mapping[str, Value]) -> int:
    """Diagnose every bag of a folder against one model; return the exit status of the command.

    Parameters
    ----------
    options : of `diagnose`, with `bags`
    parameters : of the model

    Raises
    ------
    ValueError, OSError : what cannot be used or written, in one line.
    """
    calibration = tuple(str(Path(bag).resolve()) for bag in options.calibration)
    return _run(
        "diagnose",
        options,
        {"command": "diagnose", "parameters": dict(parameters), "calibration": calibration},
    )


def _run(command: str, options: argparse.Namespace, common: Mapping[str, Any]) -> int:
    from vo2_models.effects.catalogue import VARIABLE

    from vo2_identification.batch.folder import bag_signature, find_bags
    from vo2_identification.batch.run import run_batch, task_key
    from vo2_identification.batch.work import Task

    output = Path(options.output)
    outputs = OutputFolder(output, _TABLES)
    outputs.check()
    check_place(output / _BAGS / "any")
    bags = find_bags(options.bags)
    processors = os.cpu_count() or 1
    jobs = min(options.jobs or processors, len(bags))
    cores = 1 if options.dask else max(1, processors // jobs)
    tasks = {}
    for name, path in bags.items():
        task = Task(
            name=name,
            bag=str(path.resolve()),
            effects=os.environ.get(VARIABLE, ""),
            cores=cores,
            **common,
        )
        tasks[name] = (
            task,
            task_key(task, [bag_signature(each) for each in (path, *map(Path, task.calibration))]),
        )
    batch = run_batch(tasks, output / _BAGS, jobs=jobs, dask=options.dask, quiet=options.quiet)
    left = len(bags) - len(batch.rows) - len(batch.failed)
    rows = [batch.rows[name] for name in sorted(batch.rows)]
    _write(command, output, rows, batch.failed, left)
    outputs.remember()
    refused = sum(row["status"] != "done" for row in rows)
    for name, reason in list(batch.failed.items())[:5]:
        print(f"{command}: {name}: broke down ({reason}); the next call tries again", file=sys.stderr)
    print(
        f"{len(rows) - refused} bags done, {refused} refused, {len(batch.failed)} broken down; {batch.kept} of them were "
        "finished before"
    )
    print(f"table: {output / 'table.csv'}, report: {output / 'report.html'}", flush=True)
    if batch.interrupted:
        print(f"{command}: interrupted, {left} bags are left; the same command goes on", file=sys.stderr)
        return 130
    if refused == len(bags):
        first = rows[0]
        raise InputError(
            f"{options.bags}: none of {len(bags)} bags can be used; {first['bag']}: {first['reason']}"
        )
    return 1 if batch.failed else 0


def _write(
    command: str, output: Path, rows: Sequence[Mapping[str, Any]], failed: Mapping[str, str], left: int
) -> None:
    from vo2_identification.batch.page import batch_page
    from vo2_identification.batch.table import csv_text, parquet_bytes

    write_whole(output / "table.csv", csv_text(rows))
    try:
        write_whole(output / "table.parquet", parquet_bytes(rows))
    except InputError as error:
        print(f"{command}: table.parquet is not written: {error}", file=sys.stderr)
    write_whole(output / "report.html", batch_page(command, rows, failed, left))


def _jobs(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= _MOST_JOBS:
        raise argparse.ArgumentTypeError(f"found {text!r}, need a whole number from 1 to {_MOST_JOBS}")
    return int(text)
