"""`compress`: a model file with fewer plays, or coarser Preisach grids."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vo2_models.command_line import INTERRUPTED, refuse

__all__ = ["main"]

_MARK = "compressed by `compress`"
"""Begins the first line of a model file that this command may replace."""
_DESCRIPTION = """
Compress the hysteresis laws of a model file, so that a small processor can follow them: --plays merges the plays of
every bank that has more (chapter 3), --levels the cells of every Preisach grid that is finer (chapter 2). The result
loads into estimator, plant and controller like any other model file; its error bounds are wider by what was changed.
"""
_LEVELS = (
    "levels to keep in each Preisach grid; all choices of walls are compared, so that of a grid of 40 levels N is 1 to 11 or "
    "30 to 39, and a grid for which N is none of these stays as it is"
)


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C.

    Parameters
    ----------
    args : command line, None for that of the process
    """
    options = _parser().parse_args(args)
    try:
        from vo2_models.hysteresis.compress_model import compress_levels, compress_plays_of
        from vo2_models.model_file import check_model_place, load_model_parameters, save_model_parameters
        from vo2_models.self_sensing.compressed import bounds_after

        check_model_place(options.output, _MARK)
        values = load_model_parameters(options.model)
        if options.plays is not None:
            what = "plays"
            found, changes = compress_plays_of(values, options.plays)
        else:
            what = "levels"
            found, changes = compress_levels(values, options.levels)
        lines = [
            f"{c.section}: stays at {c.before} {what}: {c.kept}"
            if c.kept
            else f"{c.section}: {c.before} {what} to {c.after}, output changed by at most {100 * c.error:.2g} % of its range "
            f"on a damped oscillation over {c.over}"
            for c in changes
        ]
        found |= bounds_after(values, found)
        save_model_parameters(options.output, found, comment="\n".join([_MARK, *lines]))
    except ValueError as error:
        return refuse("compress", error)
    except KeyboardInterrupt:
        print("compress: interrupted; nothing is written", file=sys.stderr)
        return INTERRUPTED
    except OSError as error:
        print(
            f"compress: {options.output}: cannot be written ({error.strerror or error}); name another",
            file=sys.stderr,
        )
        return 2
    print("\n".join(lines))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="compress", description=_DESCRIPTION)
    parser.add_argument("--model", required=True, type=Path, metavar="MODEL.yaml", help="model file of `fit`")
    parser.add_argument(
        "--output", required=True, type=Path, metavar="MODEL.yaml", help="model file to write"
    )
    size = parser.add_mutually_exclusive_group(required=True)
    size.add_argument("--plays", type=int, metavar="N", help="plays to keep in each bank")
    size.add_argument("--levels", type=int, metavar="N", help=_LEVELS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
