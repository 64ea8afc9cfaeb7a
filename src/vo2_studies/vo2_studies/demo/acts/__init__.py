"""The acts of the demo, one file each: `run(stage)` does it and adds its section to the report.

An act needs nothing of the others but what they left on the stage. To add one, write its file and name it
in `ACTS`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from vo2_studies.demo.stage import Stage

__all__ = ["ACTS", "act"]

ACTS = ("loops", "identification", "random_levels", "tracking", "bag", "change", "measured", "diagnosis")
"""In the order in which they run."""


def act(name: str) -> Callable[[Stage], None]:
    """Return the act `name`."""
    run: Callable[[Stage], None] = import_module(f"{__name__}.{name}").run
    return run
