"""The command `diagnose`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 whatever was found, 2 on unusable input."""
    parser = argparse.ArgumentParser(
        prog="diagnose",
        description="Compare recordings with a fitted simulation: where they differ, what physics was left out, "
        "a corrected model, and what to record next.",
    )
    parser.add_argument(
        "--bag", action="append", required=True, metavar="BAG", help="a recording; may be repeated"
    )
    parser.add_argument(
        "--model", required=True, metavar="MODEL.yaml", help="what `fit` wrote for this device"
    )
    parser.add_argument("--output", required=True, metavar="DIR", help="where the results go")
    parser.add_argument(
        "--next",
        action="store_true",
        help="not done yet: say that the proposed experiment is not played; play it with the identifier instead",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    # after the arguments: a wrong option must not wait for the compiler
    from vo2_models.model_file import load_model_parameters

    from vo2_identification.bags import read_recording
    from vo2_identification.diagnose.files import write_results
    from vo2_identification.diagnose.pipeline import study

    progress = _Progress(silent=options.quiet or not sys.stderr.isatty())
    try:
        parameters = load_model_parameters(options.model)
        recordings, problems = [], []
        for bag in options.bag:
            recording, found = read_recording(bag)
            recordings.append(recording)
            problems += [f"{bag}: {problem}" for problem in found]
        result = study(recordings, parameters, progress=progress)
        progress.done()
        diagnosis = write_results(
            result, Path(options.output), problems=problems, seconds=time.perf_counter() - began
        )
    except (ValueError, OSError) as error:
        progress.done()
        print(f"diagnose: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    print(diagnosis.summary)
    print(f"report: {Path(options.output) / 'report.html'}")
    if options.next:
        print(
            "diagnose: --next does not play the experiment yet; play next_experiment of diagnosis.json with the "
            "identifier, record it, and give both bags with --bag",
            file=sys.stderr,
        )
    return 0


class _Progress:
    """One line on a terminal: share done, what is being done, remaining time."""

    def __init__(self, *, silent: bool) -> None:
        self.silent, self.began, self.width = silent, time.perf_counter(), 0

    def __call__(self, share: float, text: str) -> None:
        if self.silent:
            return
        elapsed = time.perf_counter() - self.began
        rest = f", about {elapsed * (1 - share) / share:.0f} s left" if share > 0.05 else ""
        line = f"{100 * share:3.0f} %  {text}{rest}"
        print("\r" + line.ljust(self.width), end="", file=sys.stderr, flush=True)
        self.width = max(self.width, len(line))

    def done(self) -> None:
        """Clear the line."""
        if not self.silent and self.width:
            print("\r" + " " * self.width + "\r", end="", file=sys.stderr, flush=True)
