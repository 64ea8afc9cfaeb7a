"""How far a diagnosis has come, in shares of the expected number of simulations."""

from __future__ import annotations

import threading
from collections.abc import Callable

__all__ = ["Clock", "Progress"]

Progress = Callable[[float, str], None]
"""Called with the share done, 0 to 1, and what is being done."""

EVERY = 16
"""Simulations from one report to the next."""


class Clock:
    """Counts simulations, reports one in `EVERY`.

    Attributes
    ----------
    report : called with the share done and what is being done
    expected : number of simulations
    """

    def __init__(self, report: Progress, expected: int) -> None:
        self.report, self.expected, self.done, self.text = report, expected, 0, ""
        self.lock = threading.Lock()

    def say(self, text: str) -> None:
        """Report what is being done from now on."""
        self.text = text
        self.report(min(self.done / self.expected, 0.99), text)

    def tick(self) -> None:
        """Count one simulation."""
        with self.lock:  # fits run in parallel
            self.done += 1
            if self.done % EVERY == 0:
                self.report(min(self.done / self.expected, 0.99), self.text)
