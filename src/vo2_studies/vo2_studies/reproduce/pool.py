"""Many devices on several processes, with progress; the result does not depend on how many processes there are."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

__all__ = ["interrupt_is_ours", "run_many"]

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
    before = set(multiprocessing.active_children())
    size = max(1, min(8, len(jobs) // (4 * workers)))
    # spawn: a fork of a process whose libraries run threads may hang
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            with interrupt_is_ours():
                chunks = [pool.submit(_several, work, jobs[k : k + size]) for k in range(0, len(jobs), size)]
            for chunk in chunks:
                found.extend(chunk.result())
                progress(len(found))
        except KeyboardInterrupt:
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()
            raise
    return found


def _several(work: Callable[[Job], Found], jobs: Sequence[Job]) -> list[Found]:
    return [work(job) for job in jobs]


@contextmanager
def interrupt_is_ours() -> Iterator[None]:
    """Processes started inside ignore Ctrl-C: this process ends them, without one traceback from each."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
