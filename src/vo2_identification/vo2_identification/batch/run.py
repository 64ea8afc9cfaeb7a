"""Bags in parallel: finished ones are kept as they finish, so that the same command goes on where it was interrupted."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Self

from vo2_models.command_line import Progress
from vo2_models.io import InputError, one_line, read_bytes, write_whole

from vo2_identification.batch.work import Outcome, Row, Task, work

__all__ = ["RESULT", "Batch", "run_batch", "task_key"]

RESULT = "result.json"
"""File in the folder of a finished bag: the row of the table, and what it was made from."""
_SCHEMA = "vo2-batch/1"
_PART = ".vo2-part-"
_MOST_BYTES = 1 << 24
_SAY_S = 10.0
_LOOK_S = 0.5
_AHEAD = 2
"""Bags in the queue of each worker, so that none waits for this process."""


class Batch(NamedTuple):
    """What a batch came to.

    Attributes
    ----------
    rows : of all bags that are finished, by name
    kept : how many of them had been finished before
    failed : bag -> what broke down, which the next call tries again
    interrupted : whether bags are left over
    """

    rows: dict[str, Row]
    kept: int
    failed: dict[str, str]
    interrupted: bool


def task_key(task: Task, signature: object) -> str:
    """Return what a result holds for: another key means that it must be found anew.

    Parameters
    ----------
    task : the bag and what to do with it
    signature : of the bag's files
    """
    about = [
        task.command,
        task.device,
        dict(task.parameters),
        task.calibration,
        dict(task.options),
        task.effects,
    ]
    return hashlib.sha256(json.dumps([*about, signature], sort_keys=True, default=str).encode()).hexdigest()


def run_batch(
    tasks: Mapping[str, tuple[Task, str]],
    output: Path,
    *,
    jobs: int = 1,
    dask: str = "",
    quiet: bool = False,
) -> Batch:
    """Work on all bags that are not finished yet, and write what belongs to each into `output`/NAME.

    Parameters
    ----------
    tasks : name -> task and its key
    output : folder of the results, a folder each
    jobs : processes on this machine
    dask : address of the scheduler of a Dask cluster, whose workers are taken instead
    quiet : no progress

    Returns
    -------
    Batch : rows of the finished bags, and what failed

    Raises
    ------
    InputError : a folder that somebody else made stands where a result must go; no such cluster.
    OSError : a result cannot be written.
    """
    rows, waiting = _finished(tasks, output)
    kept, failed = len(rows), {}
    told = _Told(len(tasks), kept, quiet=quiet)
    with told.progress, _interruptible():
        try:
            with _Dask(dask) if dask else _Local(jobs) as workers:
                for task, found in _outcomes(workers, waiting):
                    if isinstance(found, Outcome):
                        _keep(output / task.name, tasks[task.name][1], found)
                        rows[task.name] = found.row
                    else:
                        failed[task.name] = found
                    told.tell(len(rows), len(failed))
        except KeyboardInterrupt:
            return Batch(rows, kept, failed, interrupted=True)
    return Batch(rows, kept, failed, interrupted=False)


# --- what is finished --------------------------------------------------------------------------------------


def _finished(tasks: Mapping[str, tuple[Task, str]], output: Path) -> tuple[dict[str, Row], list[Task]]:
    """Rows of the bags that need no work, and the tasks of the others; refuse folders of somebody else."""
    rows, waiting = {}, []
    for name, (task, key) in tasks.items():
        place = output / name
        if not place.exists():
            waiting.append(task)
            continue
        found = _result(place)
        if found["key"] == key:
            rows[name] = found["row"]
        else:
            waiting.append(task)
    for left in output.rglob(f"{_PART}*"):  # of a process that was killed
        shutil.rmtree(left, ignore_errors=True)
    return rows, waiting


def _result(place: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_bytes(place / RESULT, _MOST_BYTES))
        if content["schema"] == _SCHEMA and isinstance(content["row"], dict):
            return {"key": str(content["key"]), "row": content["row"]}
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise InputError(
        f"{place}: is not a result of this command and would be replaced; move it away or choose another output folder"
    )


def _keep(place: Path, key: str, found: Outcome) -> None:
    """Put the folder of a finished bag into its place, whole or not at all."""
    place.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=_PART, dir=place.parent))
    try:
        for name, content in found.files.items():
            write_whole(part / name, content)
        about = {"schema": _SCHEMA, "key": key, "seconds": round(found.seconds, 3), "row": found.row}
        write_whole(part / RESULT, json.dumps(about, indent=1) + "\n")
        part.chmod(0o755)
        if place.exists():
            _result(place)  # ours, or an error
            shutil.rmtree(place)
        part.rename(place)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


# --- workers -----------------------------------------------------------------------------------------------


class _Local:
    """Processes on this machine; one that dies takes nobody along."""

    names_the_killer = False

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def __enter__(self) -> Self:
        self.renew()
        return self

    def __exit__(self, *_error: object) -> None:
        self.executor.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()

    def renew(self) -> None:
        """Make a new pool in place of one that broke."""
        self.executor: Executor = ProcessPoolExecutor(
            self.jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_begin_worker
        )

    @property
    def room(self) -> int:
        """How many bags may be in hand."""
        return _AHEAD * self.jobs

    def has_died(self, error: BaseException) -> bool:
        """Whether the process that worked on the bag is gone."""
        return isinstance(error, BrokenExecutor)


class _Dask:
    """The workers of a Dask cluster, which see the same files and have this project installed."""

    names_the_killer = True

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError as error:
            raise InputError(
                "--dask: found no dask.distributed here, need it: pip install 'distributed==2026.8.0'"
            ) from error
        try:
            self.client = distributed.Client(address, timeout=10, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(f"--dask {address}: cannot be reached ({one_line(error, 200)})") from error
        self.killed: type[BaseException] = distributed.scheduler.KilledWorker

    def __enter__(self) -> Self:
        self.executor: Executor = self.client.get_executor(pure=False)
        return self

    def __exit__(self, *_error: object) -> None:
        self.executor.shutdown(wait=False)
        self.client.close()

    def renew(self) -> None:
        """Do nothing: the cluster starts its workers anew by itself."""

    @property
    def room(self) -> int:
        """How many bags may be in hand."""
        return _AHEAD * max(1, sum(self.client.nthreads().values()))

    def has_died(self, error: BaseException) -> bool:
        """Whether the process that worked on the bag is gone."""
        return isinstance(error, self.killed)


def _begin_worker() -> None:
    """Leave Ctrl-C to the process that has the whole in hand, and end with it even where it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _outcomes(workers: _Local | _Dask, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome | str]]:
    """Yield each task with its outcome, or with what broke down, as they come.

    Where a process dies, the whole pool is gone and nobody knows of which bag: those in hand are taken one at a time.
    """
    waiting, suspects = deque(tasks), deque[Task]()
    running: dict[Future[Outcome], Task] = {}
    while waiting or running or suspects:
        source, room = (suspects, 1) if suspects else (waiting, workers.room)
        alone = source is suspects
        while source and len(running) < room:
            try:
                running[workers.executor.submit(work, source[0])] = source[0]
            except BrokenExecutor:
                if running:
                    break
                workers.renew()
                continue
            source.popleft()
        died: list[Task] = []
        enough = False
        while running and not enough:
            done, _ = wait(running, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            enough = bool(done)
            for future in done:
                task = running.pop(future)
                error = future.exception()
                if error is None:
                    yield task, future.result()
                elif not workers.has_died(error):
                    yield task, one_line(f"{type(error).__name__}: {error}", 300)
                elif alone or workers.names_the_killer:
                    yield task, "the process that worked on it was killed; is there enough memory?"
                    workers.renew()
                else:
                    died.append(task)
        if died:
            suspects.extend([*died, *running.values()])
            running.clear()
            workers.renew()


@contextmanager
def _interruptible() -> Iterator[None]:
    """Take SIGTERM as Ctrl-C, so that what is finished is told and the workers end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class _Told:
    """How far the batch is; the bags of earlier calls are no news."""

    def __init__(self, total: int, kept: int, *, quiet: bool) -> None:
        self.total, self.kept = total, kept
        self.began = time.monotonic()
        self.progress = Progress("batch", quiet=quiet, every_s=_SAY_S)
        if kept and not quiet:
            print(f"{kept} of {total} bags were finished before", file=sys.stderr, flush=True)

    def tell(self, finished: int, failed: int) -> None:
        """Show that so many bags are finished by now."""
        new = finished - self.kept
        rate = new / max(time.monotonic() - self.began, 1e-9)
        text = f"{finished} of {self.total} bags, {rate:.3g} per s"
        text += f", {failed} broke down" if failed else ""
        self.progress((new + failed) / (self.total - self.kept), text)
