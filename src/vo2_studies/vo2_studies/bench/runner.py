"""Find the entries, run them, print a table, write the JSON file."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["entries", "main", "paired", "select", "table"]

_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_FRAMEWORK = {"__main__", "entry", "runner", "timing", "wall_loops"}
PAIRS = 5
"""Rounds of a comparison with another checkout."""


def entries(package: str = "vo2_studies.bench") -> dict[str, Entry]:
    """Every entry of the modules of a package, by name; a module that cannot be imported here is named and left out.

    Raises
    ------
    ValueError : a module that offers no ENTRIES, or a name used twice.
    """
    found: dict[str, Entry] = {}
    places = importlib.import_module(package).__path__
    for name in sorted(f"{package}.{module.name}" for module in pkgutil.iter_modules(places)):
        if name.rpartition(".")[2] in _FRAMEWORK:
            continue
        try:
            module = importlib.import_module(name)
        except ImportError as error:  # what needs ROS is left out where there is none
            print(f"bench: {name} left out: {error}", file=sys.stderr)
            continue
        if not hasattr(module, "ENTRIES"):
            raise ValueError(f"{name}: found no ENTRIES, need a tuple of Entry")
        for entry in module.ENTRIES:
            if entry.name in found:
                raise ValueError(f"{name}: found the name {entry.name} twice, need different names")
            found[entry.name] = entry
    return found


def select(known: Mapping[str, Entry], names: Sequence[str]) -> list[Entry]:
    """The entries named; if none is, all but those on request; an unknown name is a `ValueError` with the known ones."""
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"--only: found {', '.join(unknown)}, need some of {', '.join(known)}")
    return [known[name] for name in names] or [entry for entry in known.values() if not entry.on_request]


def table(entry: Entry, figure: Figure) -> str:
    """One line of the table."""
    yardstick = f"{figure.yardstick:.4g}" if figure.yardstick is not None else "-"
    ratio = f"{figure.ratio:.2f}" if figure.ratio is not None else "-"
    met = entry.met(figure)
    verdict = {True: "met", False: "NOT MET", None: "-"}[met]
    target = "-"
    if entry.target is not None:
        sign = ">=" if entry.above else "<="
        target = f"{sign} {entry.target:g}" + (" x" if entry.of == "ratio" else f" {figure.unit}")
    columns = f"{entry.name:<24}{figure.value:>12.4g} {figure.unit:<10}{yardstick:>10}{ratio:>8}  {target:<20}{verdict:<9}"
    return (columns + figure.note).rstrip()


def paired(entry: Entry, checkout: Path) -> Figure:
    """Measure an entry here and in another checkout in turn, each time in a process of its own.

    Parameters
    ----------
    entry : measured
    checkout : folder with a `vo2` and an entry of this name

    Returns
    -------
    Figure : median here; the median there is its yardstick

    Raises
    ------
    ValueError : what runs there does not give the figure.
    """
    here = [sys.executable, "-m", "vo2_studies.bench"]
    there = [str(checkout / "vo2"), "bench"]
    values: tuple[list[float], list[float]] = ([], [])
    unit = ""
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder, "figures.json")
        for _ in range(PAIRS):
            for command, into in zip((here, there), values, strict=True):
                asked = [*command, "--only", entry.name, "--json", str(told)]
                run = subprocess.run(asked, capture_output=True, text=True, check=False)
                if run.returncode or not told.exists():
                    last = (run.stderr or run.stdout).strip().splitlines()[-1:]
                    raise ValueError(f"{command[0]}: measured no {entry.name}: {' '.join(last)}")
                figure = json.loads(told.read_text(encoding="utf-8"))[entry.name]
                told.unlink()
                into.append(figure["value"])
                unit = figure["unit"]
    ratios = [ours / theirs for ours, theirs in zip(*values, strict=True) if theirs]
    note = f"yardstick: {checkout}; {PAIRS} pairs"
    note += f", ratios {min(ratios):.3f} to {max(ratios):.3f}" if ratios else ""
    return Figure(median(values[0]), unit, median(values[1]), note)


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="bench", description="Speed figures against yardsticks of the same run."
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="measure these entries only")
    parser.add_argument(
        "--against", type=Path, metavar="CHECKOUT", help="measure them in another checkout as well, in turn"
    )
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks; 0 if they ran, 2 on unusable input with one line on standard error."""
    given = _options(sys.argv[1:] if arguments is None else arguments)
    target = given.json
    # the figures are for a single thread: said before any numerical library starts its pool
    os.environ.update(dict.fromkeys(_POOLS, "1"))
    try:
        chosen = select(entries(), given.only)
        if given.against is not None and not (given.against / "vo2").is_file():
            raise ValueError(f"--against: found no vo2 in {given.against}, need another checkout")
    except ValueError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    head = f"{'name':<24}{'value':>12} {'unit':<10}{'yardstick':>10}{'ratio':>8}  {'target':<20}"
    print(head.rstrip(), flush=True)
    figures: dict[str, dict[str, float | str | None]] = {}
    for entry in chosen:
        try:
            figure = entry.run() if given.against is None else paired(entry, given.against.resolve())
        except ValueError as error:
            print(f"bench: {error}", file=sys.stderr)
            return 2
        figures[entry.name] = figure.record()
        print(table(entry, figure), flush=True)
    if target is not None:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            print(
                f"bench: {target}: cannot be written ({error.strerror}); give another file", file=sys.stderr
            )
            return 2
    return 0
