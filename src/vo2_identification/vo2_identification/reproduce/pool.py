"""Many devices on several processes, with progress; the result does not depend on how many processes there are."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

__all__ = ["run_many"]

Job = TypeVar("Job")
Found = TypeVar("Found")


def run_many(
    work: Callable[[Job], Found], jobs: Sequence[Job], workers: int, progress: Callable[[int], None]
) -> list[Found]:
    """Return `work(job)` for every job, in order; `progress` gets the number done.

    Parameters
    ----------
    work : a function of a module, so that other processes find it
    workers : processes; 1 runs here
    """
    found: list[Found] = []
    if workers == 1:
        for job in jobs:
            found.append(work(job))
            progress(len(found))
        return found
    # spawn: a fork of a process whose libraries run threads may hang
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for result in pool.map(work, jobs, chunksize=max(1, min(8, len(jobs) // (4 * workers)))):
            found.append(result)
            progress(len(found))
    return found
