"""Pause, resume and step of a replay: by service, and by keys where it runs in a terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from types import TracebackType
from typing import Any, Self

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

__all__ = ["KEYS", "ReplayControl"]

KEYS = "space pauses and resumes, the right arrow or s plays one message"
_LOOK_S = 0.05
_STEPS = (b"s", b"\x1b[C")


class ReplayControl:
    """Whether the replay stands, and what is to be played meanwhile.

    Services: `~/pause` (`std_srvs/srv/SetBool`, false resumes) and `~/step` (`std_srvs/srv/Trigger`, one message).

    Parameters
    ----------
    node : of the replay
    paused : how it begins

    Attributes
    ----------
    paused : whether the replay stands
    """

    def __init__(self, node: Node, *, paused: bool = False) -> None:
        self.paused = paused
        self._steps = 0
        self._looked_s = 0.0
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        node.create_service(SetBool, "~/pause", self._on_pause)
        node.create_service(Trigger, "~/step", self._on_step)
        self._terminal: list[Any] | None = None

    def __enter__(self) -> Self:
        # a process in the background must not touch the terminal of another
        if sys.stdin.isatty() and os.getpgrp() == os.tcgetpgrp(sys.stdin.fileno()):
            self._terminal = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._terminal is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)
        self._executor.shutdown()

    @property
    def keys(self) -> bool:
        """Whether keys are heard."""
        return self._terminal is not None

    def look(self) -> None:
        """Hear services and keys; costs nothing more often than twenty times a second."""
        now = time.monotonic()
        if now - self._looked_s < _LOOK_S:
            return
        self._looked_s = now
        self._executor.spin_once(timeout_sec=0.0)
        if self._terminal is not None and select.select([sys.stdin], [], [], 0.0)[0]:
            self._press(os.read(sys.stdin.fileno(), 64))

    def take_step(self) -> bool:
        """Return whether one message is to be played though the replay stands, and count it as played."""
        if not self._steps:
            return False
        self._steps -= 1
        return True

    def _press(self, pressed: bytes) -> None:
        if pressed.count(b" ") % 2:
            self._set(not self.paused)
        if self.paused:
            self._steps += sum(pressed.count(key) for key in _STEPS)

    def _set(self, paused: bool) -> None:
        self.paused, self._steps = paused, 0

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._set(request.data)
        response.success, response.message = True, "paused" if request.data else "playing"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.paused
        response.message = (
            "one message" if self.paused else "the replay is not paused: call ~/pause with true"
        )
        self._steps += self.paused
        return response
