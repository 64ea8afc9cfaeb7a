"""From parameters to everything that a controller runs; for wall time in a process beside the loop.

A design takes seconds of a processor and of the interpreter's lock. A thread would share that lock with the loop,
which then waits for it thousands of times; so the work is done in a process that is there before the loop starts.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from vo2_models.device.description import preset
from vo2_models.parameters import Value

from vo2_control.controller import Controller
from vo2_control.designs import design_controller, design_feedforward, reach

if TYPE_CHECKING:
    from vo2_control.feedforward import InverseFeedforward

__all__ = ["Design", "Designer", "Task", "make_design"]

_NICENESS = 5
BEYOND = 0.05
"""Share of the response's range by which a set-point may lie outside of it, where no inverse tells what is reachable."""


@dataclass(frozen=True)
class Task:
    """What is to be designed: kind of law, preset, sample period [s], given parameters, whether with feedforward."""

    kind: str
    preset: str
    sample_period_s: float
    values: Mapping[str, Value]
    feedforward: bool


@dataclass(frozen=True)
class Design:
    """What parameters lead to: a law, the inverse of the model if there is one, its reach [m], why there is none."""

    law: Controller
    ahead: InverseFeedforward | None
    reach_m: tuple[float, float]
    without: str


def make_design(task: Task) -> Design:
    """Design the law and, where there is a model, its inverse.

    Parameters
    ----------
    task : what to design for

    Returns
    -------
    Design : the law, and the inverse if asked for

    Raises
    ------
    ValueError : no law for these parameters; that the model has no inverse is told in `without`.
    """
    where = {"preset": task.preset, "sample_period_s": task.sample_period_s, "values": task.values}
    law = design_controller(task.kind, **where)  # type: ignore[arg-type]
    ahead, reach_m, without = None, (-math.inf, math.inf), ""
    if task.values.get("model.device") or task.feedforward:
        try:
            ahead = design_feedforward(**where)  # type: ignore[arg-type]
            reach_m = reach(ahead)
        except ValueError as error:
            without = str(error)
            if model := str(task.values.get("model.device") or ""):
                low, high = preset(model).deflection_extent
                reach_m = low - BEYOND * (high - low), high + BEYOND * (high - low)
    return Design(law, ahead if task.feedforward else None, reach_m, without)


class Designer:
    """A process that designs; only the newest task counts. It ends with its owner."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._asked = self._answered = 0

    @property
    def busy(self) -> bool:
        """Whether an answer is outstanding."""
        return self._answered < self._asked

    def ask(self, task: Task) -> None:
        """Hand a task over, without waiting; that the process has died is told by `answer`."""
        self._asked += 1
        with suppress(OSError):  # `answer` finds the end of the pipe, and says so
            self._ours.send((self._asked, task))

    def answer(self) -> Design | None:
        """Return the design of the newest task once, None while there is none.

        Raises
        ------
        ValueError : the task has no design, or its process died; the message says why.
        """
        try:
            while self.busy and self._ours.poll():
                self._answered, found = self._ours.recv()
                if self.busy:  # a newer task makes this answer void
                    continue
                if isinstance(found, str):
                    raise ValueError(found)
                return found
        except (EOFError, OSError) as error:
            self._answered = self._asked
            raise ValueError(f"the process that designs has died ({error!r}): restart the node") from error
        return None

    def close(self) -> None:
        """End the process, whatever it does."""
        self._ours.close()
        self._process.kill()
        self._process.join()


def _work(connection: Connection) -> None:
    # Ctrl-C reaches the whole group: the owner decides when this one ends
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICENESS)
    while True:
        try:
            number, task = connection.recv()
        except (EOFError, OSError):  # the owner has gone
            return
        try:
            found: Design | str = make_design(task)
        except ValueError as error:
            found = str(error)
        except Exception as error:  # nobody is above this loop: what it dies of must reach the operator
            traceback.print_exc()
            found = f"the design broke down: {error!r}; the log has the traceback"
        try:
            connection.send((number, found))
        except OSError:  # the owner has gone
            return
