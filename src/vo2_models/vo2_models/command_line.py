"""What all commands do alike: refuse bad input in one line, and show how far they are."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

from vo2_models.io import one_line

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["BAD_INPUT", "Progress", "duration", "refuse", "until_loaded"]

BAD_INPUT, INTERRUPTED = 2, 130
"""Exit status of a command that cannot use what it was given, and of one that Ctrl-C has ended."""
_SOON = 0.05
"""Share of the work below which the rest is not estimated."""


def refuse(program: str, reason: object) -> int:
    """Say on standard error in one line why a command ends, and return its exit status.

    Parameters
    ----------
    program : name of the command
    reason : text or error
    """
    print(f"{program}: {one_line(reason)}", file=sys.stderr, flush=True)
    return BAD_INPUT


def until_loaded(program: str, left: str, run: Callable[[], int]) -> int:
    """Run a command that hears Ctrl-C itself once it has loaded, and return its exit status; 130 after Ctrl-C before.

    Parameters
    ----------
    program : name of the command
    left : what has come of it until then, such as "nothing is recorded"
    run : the command
    """
    try:
        return run()
    except KeyboardInterrupt:
        print(f"{program}: interrupted while it loaded: {left}", file=sys.stderr)
        return INTERRUPTED


def duration(seconds: float) -> str:
    """Return a time span of so many `seconds` in words, in its natural unit."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400.0 else f"{seconds / 3600:.1f} h"


class Progress:
    """How far a command is and about how long it will take: a bar on a terminal, else lines, on standard error.

    Parameters
    ----------
    program : name of the command, before each line
    quiet : whether nothing is shown
    lines : whether there is anything where standard error is no terminal
    every_s, first_s : least time between two such lines, and before the first [s]
    """

    def __init__(
        self,
        program: str,
        *,
        quiet: bool = False,
        lines: bool = True,
        every_s: float = 0.0,
        first_s: float = 0.0,
    ) -> None:
        self._program, self._every_s = program, every_s
        self._terminal = sys.stderr.isatty()
        self._silent = quiet or not (lines or self._terminal)
        self._began, self._said_at = time.monotonic(), first_s - every_s
        self._bar: tqdm | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.clear()

    def __call__(self, share: float | None, text: str) -> None:
        """Show what is being done.

        Parameters
        ----------
        share : of the work that is done, 0 to 1; None where nobody knows
        text : what is being done
        """
        if self._silent:
            return
        took = time.monotonic() - self._began
        left = ""
        if share is not None and _SOON < share < 1.0:
            left = f", about {duration(took * (1 - share) / share)} left"
        if self._terminal:
            self._draw(share, text + left)
        elif took - self._said_at >= self._every_s or share == 1.0:
            self._said_at = took
            percent = "" if share is None else f"{100 * share:3.0f} %  "
            print(f"{self._program}: {percent}{text}{left}", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take the bar away, so that something else can be printed; the next call draws it again."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def _draw(self, share: float | None, text: str) -> None:
        if self._bar is None:
            # only where there is a terminal
            from tqdm import tqdm

            tqdm.monitor_interval = 0  # its thread would redraw what has just been drawn
            # some terminals, as those of containers, say that they have no columns and no rows
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or 80
            self._bar = tqdm(
                total=1.0, file=sys.stderr, leave=False, ncols=columns, nrows=20, bar_format="{desc}"
            )
        self._bar.bar_format = "{desc}" if share is None else "{percentage:3.0f} % |{bar:20}| {desc}"
        self._bar.n = share or 0.0
        self._bar.set_description_str(text)
