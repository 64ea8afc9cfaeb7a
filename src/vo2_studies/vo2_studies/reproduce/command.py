"""The command line of `reproduce`: choose sections, run them with progress, write page and JSON."""

from __future__ import annotations

import argparse
import json
import os
import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from vo2_models.command_line import Progress, refuse
from vo2_models.io import InputError, OutputFolder, write_whole

from vo2_studies.reproduce import INTERRUPTED
from vo2_studies.reproduce import sections as section_folder
from vo2_studies.reproduce.claims import Claim, Context, Figure, Section, Table, tally
from vo2_studies.reproduce.kept import code_digest, keep, kept
from vo2_studies.reproduce.page import page

__all__ = ["KEPT", "run", "section_modules"]

KEPT = "sections"
"""Folder of the finished sections, inside the output folder."""


def section_modules() -> list[ModuleType]:
    """Modules of `reproduce.sections` in the order of the dissertation; each has NUMBER, TITLE and `run(context)`."""
    modules = [
        import_module(f"{section_folder.__name__}.{found.name}")
        for found in iter_modules(section_folder.__path__)
        if not found.name.startswith("_")
    ]
    return sorted(modules, key=lambda module: [int(part) for part in module.NUMBER.split(".")])


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 whatever the claims say, 2 on unusable arguments, 130 after Ctrl-C.

    Finished sections are kept in the output folder: the same command continues, as long as neither the code nor what a
    section depends on has changed.
    """
    parser = argparse.ArgumentParser(
        prog="reproduce",
        description="Published figures of the dissertation beside ours: one page, one JSON file. Finished sections are kept "
        "in the folder: after an interruption the same command continues.",
    )
    parser.add_argument(
        "--only", metavar="SECTION", action="append", help="for instance 8, 8.4 or 8.4.1; repeatable"
    )
    parser.add_argument("--output", metavar="DIR", type=Path, default=Path("reproduction"))
    parser.add_argument("--draws", type=int, default=200, help="simulated devices of the comparisons (200)")
    parser.add_argument(
        "--robust-draws", type=int, default=1000, help="devices of the robustness study (1000)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the first device (1)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (all cores)")
    parser.add_argument("--list", action="store_true", help="list the sections and stop")
    options = parser.parse_args(arguments)
    known = section_modules()
    if options.list:
        for module in known:
            print(f"{module.NUMBER:8s}{module.TITLE}")
        return 0
    wanted = [m for m in known if not options.only or any(_belongs(m.NUMBER, o) for o in options.only)]
    if not wanted:
        numbers = ", ".join(m.NUMBER for m in known)
        return refuse("reproduce", f"--only: found {', '.join(options.only)}, need one of {numbers}")
    if min(options.draws, options.robust_draws, options.workers) < 1:
        return refuse("reproduce", "--draws, --robust-draws, --workers: need at least 1")
    outputs = OutputFolder(options.output, ("reproduction.json", "reproduction.html", "scenarios", KEPT))
    try:
        outputs.check()
        options.output.mkdir(parents=True, exist_ok=True)
        return _run_sections(wanted, options, outputs)
    except InputError as error:
        return refuse("reproduce", f"--output: {error}")
    except OSError as error:
        place = error.filename or options.output
        reason = f"--output: cannot write {place} ({error.strerror}); give a writable folder"
        return refuse("reproduce", reason)


def _run_sections(wanted: Sequence[ModuleType], options: argparse.Namespace, outputs: OutputFolder) -> int:
    """Run sections one after the other; what is done is on disk at any time."""
    settings = {"draws": options.draws, "robust_draws": options.robust_draws, "seed": options.seed}
    folder = options.output / KEPT
    done: list[Section] = []
    total = 0.0
    for module in wanted:
        earlier = kept(folder, module, settings)
        begun = time.monotonic()
        progress = Progress("reproduce")
        context = Context(
            options.draws,
            options.robust_draws,
            options.seed,
            options.workers,
            options.output,
            _said_of(module.NUMBER, progress),
            code_digest(module),
        )
        try:
            section = earlier[0] if earlier else module.run(context)
            seconds = earlier[1] if earlier else time.monotonic() - begun
            if not earlier:
                keep(folder, module, section, settings, seconds)
                (context.folder / "unfinished" / f"{module.NUMBER}.jsonl").unlink(missing_ok=True)
        except KeyboardInterrupt:
            print(
                f"\nreproduce: interrupted in {module.NUMBER}; {len(done)} of {len(wanted)} sections are finished and kept, the "
                "same command continues",
                file=sys.stderr,
            )
            return INTERRUPTED
        finally:
            progress.clear()
            outputs.remember()
        done.append(section)
        total += seconds
        how = f"kept, took {seconds:.1f} s" if earlier else f"{seconds:.1f} s"
        ahead = f", {len(wanted) - len(done)} sections ahead" if len(done) < len(wanted) else ""
        print(f"{section.number:6s} {how}{ahead}  {section.title}", file=sys.stderr, flush=True)
        print(_text(section), flush=True)
        # after every section: an interrupted run leaves what it has found
        _write(options.output, done, total, wanted)
        outputs.remember()
    claims = [claim for section in done for claim in section.claims]
    print(tally(claims))
    print(f"page  {options.output / 'reproduction.html'}")
    print(f"data  {options.output / 'reproduction.json'}")
    return 0


def _text(section: Section) -> str:
    """A section for the terminal: its story without figures, then published, ours and state of every claim."""
    lines = [f"\n{section.number} {section.title}"]
    for part in section.story:
        if isinstance(part, Table):
            cells = [part.head, *part.rows]
            widths = [max(len(row[k]) for row in cells) for k in range(len(part.head))]
            lines += ["", part.caption]
            lines += ["  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in cells]
        elif not isinstance(part, Figure):
            lines += ["", textwrap.fill(part, 110)]
    for remark in section.remarks:
        lines += ["", textwrap.fill(remark, 110)]
    lines += ["", f"  {'published':>10s} {'ours':>10s}  {'unit':10s} {'state':13s}claim"]
    lines += [_claim_text(claim) for claim in section.claims]
    return "\n".join([*lines, f"  {tally(section.claims)}"])


def _claim_text(claim: Claim) -> str:
    published = "-" if claim.published is None else f"{claim.published:.4g}"
    return f"  {published:>10s} {claim.ours:10.4g}  {claim.unit:10s} {claim.state:13s}{claim.claim}"


def _write(folder: Path, done: Sequence[Section], seconds: float, wanted: Sequence[ModuleType]) -> None:
    only = "".join(f" --only {module.NUMBER}" for module in wanted)
    command = "./vo2 run vo2_identification reproduce" + (
        only if len(wanted) < len(section_modules()) else ""
    )
    records = [claim.record() for section in done for claim in section.claims]
    write_whole(folder / "reproduction.json", json.dumps(records, indent=1) + "\n")
    write_whole(folder / "reproduction.html", page(done, command=command, seconds=seconds))


def _belongs(number: str, wanted: str) -> bool:
    return number == wanted or number.startswith(wanted + ".") or wanted.startswith(number + ".")


def _said_of(number: str, progress: Progress) -> Callable[[str, float], None]:
    return lambda text, share: progress(share, f"{number:6s} {text}")
