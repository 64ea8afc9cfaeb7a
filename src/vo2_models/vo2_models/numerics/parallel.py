"""Work that does not depend on each other, on all cores: the compiled simulation and numpy's products hold no lock."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["parallel_map", "use_cores"]

Item = TypeVar("Item")
Result = TypeVar("Result")
_VARIABLE = "VO2_CORES"


def _cores() -> int:
    """Cores of a process at its start: those it may run on, eight at most, or as many as the environment says."""
    own = min(len(os.sched_getaffinity(0)), 8)
    given = os.environ.get(_VARIABLE, "")
    if given.isdecimal() and int(given):
        return int(given)
    if given:
        warnings.warn(f"{_VARIABLE}: found {given!r}, need a whole number from 1; taking {own}", stacklevel=2)
    return own


CORES = _cores()


def use_cores(count: int) -> None:
    """Let this process take at most so many cores from now on: one of several that share the machine.

    Parameters
    ----------
    count : 1 or more
    """
    global CORES
    CORES = max(1, count)


def parallel_map(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the results of a function for several items, in the items' order; calls may be nested.

    Parameters
    ----------
    function : called once per item, in a thread
    items : any number

    Raises
    ------
    what the function raises for the first item that fails; items not begun by then are left out.
    """
    several = list(items)
    if len(several) < 2 or CORES == 1:
        return [function(item) for item in several]
    with ThreadPoolExecutor(max_workers=min(len(several), CORES)) as pool:
        return list(pool.map(function, several))
