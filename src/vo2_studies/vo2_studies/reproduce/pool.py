"""Many devices on several processes, with progress; the result does not depend on how many processes there are.

What is finished may be kept in a file, so that hours of devices survive an interruption.
"""

from __future__ import annotations

import json
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Generic, TypeVar

__all__ = ["Finished", "hear_the_end", "interrupt_is_ours", "run_many"]

Job = TypeVar("Job")
Found = TypeVar("Found")


@dataclass(frozen=True)
class Finished(Generic[Found]):
    """A file of what is finished, one line of JSON each in the order of the jobs, below a line that says what it is of.

    Attributes
    ----------
    place : the file
    identity : all that the results depend on; a file of another identity is begun anew
    encode, decode : a result as what JSON takes, and back
    """

    place: Path
    identity: str
    encode: Callable[[Found], Any]
    decode: Callable[[Any], Found]

    def read(self) -> list[Found]:
        """Return what is finished; a line that was not written to its end and what follows it do not count."""
        head = json.dumps({"of": self.identity}) + "\n"
        text = self.place.read_text(encoding="utf-8") if self.place.is_file() else ""
        if not text.startswith(head):
            self.place.parent.mkdir(parents=True, exist_ok=True)
            self.place.write_text(head, encoding="utf-8")
            return []
        lines = text.splitlines(keepends=True)
        whole = [line for line in lines if line.endswith("\n")]
        if len(whole) < len(lines):
            self.place.write_text("".join(whole), encoding="utf-8")
        return [self.decode(json.loads(line)) for line in whole[1:]]

    def add(self, found: Sequence[Found]) -> None:
        """Append results."""
        with self.place.open("a", encoding="utf-8") as file:
            file.write("".join(json.dumps(self.encode(one)) + "\n" for one in found))


def run_many(
    work: Callable[[Job], Found],
    jobs: Sequence[Job],
    workers: int,
    progress: Callable[[int], None],
    finished: Finished[Found] | None = None,
) -> list[Found]:
    """Return `work(job)` for every job, in order; `progress` gets the number done.

    Parameters
    ----------
    work : a function of a module, so that other processes find it
    workers : processes; 1 runs here
    finished : results of an earlier run of the same jobs, which are not computed again, and where to add others
    """
    found: list[Found] = finished.read() if finished else []

    def add(more: Sequence[Found]) -> None:
        found.extend(more)
        if finished:
            finished.add(more)
        progress(len(found))

    jobs = jobs[len(found) :]
    if workers == 1:
        for job in jobs:
            add([work(job)])
        return found
    before = set(multiprocessing.active_children())
    size = max(1, min(8, len(jobs) // (4 * workers)))
    # spawn: a fork of a process whose libraries run threads may hang
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=hear_the_end) as pool:
        try:
            with interrupt_is_ours():
                chunks = [pool.submit(_several, work, jobs[k : k + size]) for k in range(0, len(jobs), size)]
            for chunk in chunks:
                add(chunk.result())
        except KeyboardInterrupt:
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()
            raise
    return found


def _several(work: Callable[[Job], Found], jobs: Sequence[Job]) -> list[Found]:
    return [work(job) for job in jobs]


def hear_the_end() -> None:
    """Let a process that was started within `interrupt_is_ours` be ended: it has what is blocked there from its parent."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})


@contextmanager
def interrupt_is_ours() -> Iterator[None]:
    """Processes started inside do not see Ctrl-C: this process ends them, without one traceback from each.

    One that is pressed meanwhile, or a SIGTERM, is not lost, as it would be if it were ignored here or came while a process
    is made: it waits, or comes by another thread. The processes begin with `hear_the_end`.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # to start it within would let Ctrl-C through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
