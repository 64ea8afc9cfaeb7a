"""Health of a node on `/diagnostics`: said when it changes and again at a slow beat."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.impl import rcutils_logger
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.publisher import Publisher

from vo2_interface.samples import message_stamp_ns, stamp_message
from vo2_interface.timers import create_steady_timer
from vo2_interface.topics import DIAGNOSTICS, SAMPLE_QOS

__all__ = ["Diagnostics"]

_LEVELS = {
    "ok": DiagnosticStatus.OK,
    "warn": DiagnosticStatus.WARN,
    "error": DiagnosticStatus.ERROR,
}
# a log line names the file that reports, not this one
rcutils_logger._internal_callers.append(os.path.realpath(__file__))
_WATCH_S = 0.5
_LINKS = "links"
_OFTEN = 8
"""Changes of a status to the same words after which only the 16th, 32nd, 64th ... is told at once and logged."""
_MOST_WORDS = 200
"""Different words that are counted at a time."""
_FORGOTTEN_S = 10.0
"""Time after which such a change is a new one [s]."""
_QUIET_LOOKS = 2
"""Looks in a row, `_WATCH_S` apart, at which an input has brought nothing before that is told."""


class Diagnostics:
    """Publishes one status per topic of concern (`input`, `model`, `progress`, ...).

    A message is sent when a status changes; `beat` repeats the present ones for late listeners. What
    goes wrong, and that it is well again, is also logged once per change. Where it goes on changing to and fro, the eighth time
    and more, only every doubling is logged, and who listens gets the newest twice a second.

    What is told without a stamp has that of the last sample that was noted. Before the first it has the node's time where
    that is the samples' too, else 0, which is no time in ROS: in lockstep nobody knows it yet, and the time of day would be
    read as decades later.

    Parameters
    ----------
    node : that tells
    hardware_id : of its device
    wall_time : whether samples carry the time of day
    """

    def __init__(self, node: Node, *, hardware_id: str = "", wall_time: bool = False) -> None:
        self._node = node
        self._own_time = wall_time or node.get_parameter("use_sim_time").value
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, SAMPLE_QOS)
        self._present: dict[str, tuple[str, str, dict[str, str]]] = {}
        self._watched: list[Publisher] = []
        self._sole: dict[str, str] = {}
        self._heard = b""
        self._inputs: dict[str, tuple[Callable[[], int], deque[int]]] = {}
        self._counts: dict[str, int] = {}
        self._changes: dict[tuple[str, str], tuple[int, float]] = {}
        self._waiting: set[str] = set()
        # one for each level: a logger wants the same severity of a place in the code every time
        self._loggers = {level: get_logger(node.get_logger().name) for level in _LEVELS}
        self._name = node.get_fully_qualified_name().lstrip("/")
        self.hardware_id = hardware_id

    def report(
        self,
        topic: str,
        level: str,
        text: str,
        values: Mapping[str, object] | None = None,
        *,
        stamp_ns: int | None = None,
    ) -> None:
        """Set the status `topic` to `level` (ok, warn, error) with `text`; publish it if it changed."""
        told = {key: str(value) for key, value in (values or {}).items()}
        before = self._present.get(topic)
        if before == (level, text, told):
            return
        self._present[topic] = (level, text, told)
        changed = before is None or before[:2] != (level, text)
        number = self._times(topic, text) if changed and topic != _LINKS else 1
        often = number > _OFTEN
        if often and number & (number - 1) and self._watched:
            self._waiting.add(topic)  # two states that alternate at every sample must not flood who listens
            return
        if topic != _LINKS:
            self._send([topic], stamp_ns)
        if changed and not (often and number & (number - 1)):
            self._log(topic, level, f"{text} ({number} times)" if often else text, first=before is None)

    def _times(self, topic: str, text: str) -> int:
        """How often a status has come to say this, since it last was silent about it for `_FORGOTTEN_S`."""
        now = time.monotonic()
        number, last = self._changes.get((topic, text), (0, now))
        number = 1 if now - last > _FORGOTTEN_S else number + 1
        if len(self._changes) > _MOST_WORDS:  # words with numbers in them are new every time
            self._changes.clear()
        self._changes[topic, text] = (number, now)
        return number

    def note_sample(self, data: bytes) -> None:
        """Take the stamp of a serialized sample as the present time, for all that is told without a stamp.

        In simulated time nobody else knows it: no status is on another clock than the samples around it.
        """
        self._heard = data

    def count(self, topic: str, text: str, *, stamp_ns: int | None = None) -> None:
        """Count one more of what `text` says as a warning; told at 1, 2, 4, 8 ...: a flood must not cause another."""
        number = self._counts[text] = self._counts.get(text, 0) + 1
        if number & (number - 1) == 0:
            self.report(topic, "warn", text, {"count": number}, stamp_ns=stamp_ns)

    def watch_input(self, topic: str, count: Callable[[], int]) -> None:
        """Report on `bonds` when samples of a topic, once there, stay away for a second; and when they are back.

        `count` returns how many have come so far.
        """
        if not self._inputs:
            create_steady_timer(self._node, _WATCH_S, self._look_at_inputs)
        self._inputs[topic] = (count, deque(maxlen=1 + _QUIET_LOOKS))

    def _look_at_inputs(self) -> None:
        silent = []
        for topic, (count, seen) in self._inputs.items():
            seen.append(count())
            if seen[-1] and len(seen) == seen.maxlen and seen[0] == seen[-1]:
                silent.append(topic)
        if silent:
            text = (
                f"nothing on {' and '.join(silent)} for {_QUIET_LOOKS * _WATCH_S:g} s: is its node running?"
            )
            self.report("bonds", "warn", text)
        elif self.level("bonds") != "ok":
            self.report("bonds", "ok", "samples arrive on every topic again")

    def watch_listeners(self, publisher: Publisher, alone: Mapping[str, str] = MappingProxyType({})) -> None:
        """Report on `links` how many listeners the publisher has, again and again for who comes late.

        `alone` holds topics on which this node alone is to publish, and what to do where it does not: told as a warning.
        """
        self._sole.update(alone)
        if not self._watched:
            create_steady_timer(self._node, _WATCH_S, self._report_listeners)
        self._watched.append(publisher)

    def _report_listeners(self) -> None:
        counts = {publisher.topic_name: publisher.get_subscription_count() for publisher in self._watched}
        self.report(_LINKS, "ok", "listeners of each topic", counts)
        self._send([_LINKS, *sorted(self._waiting)], None)
        self._waiting.clear()
        for topic, advice in self._sole.items():
            others = self._node.count_publishers(topic) - 1
            if others > 0:
                self.report(topic.strip("/"), "warn", f"{others} more on {topic}: {advice}")
            elif self.level(topic.strip("/")) != "ok":
                self.report(topic.strip("/"), "ok", f"alone on {topic} again")

    def beat(self, stamp_ns: int | None = None) -> None:
        """Publish all present statuses again."""
        if self._present:
            self._send(list(self._present), stamp_ns)

    def level(self, topic: str) -> str:
        """Return the present level of `topic`, `ok` if never reported."""
        return self._present[topic][0] if topic in self._present else "ok"

    def _send(self, topics: list[str], stamp_ns: int | None) -> None:
        message = DiagnosticArray()
        if stamp_ns is None and self._heard:
            stamp_ns = message_stamp_ns(self._heard)
        elif stamp_ns is None:
            stamp_ns = self._node.get_clock().now().nanoseconds if self._own_time else 0
        message.header.stamp = stamp_message(stamp_ns)
        for topic in topics:
            level, text, values = self._present[topic]
            message.status.append(
                DiagnosticStatus(
                    level=_LEVELS[level],
                    name=f"{self._name}: {topic}",
                    message=text,
                    hardware_id=self.hardware_id,
                    values=[KeyValue(key=key, value=value) for key, value in values.items()],
                )
            )
        self._publisher.publish(message)

    def _log(self, topic: str, level: str, text: str, *, first: bool) -> None:
        if level == "error":
            self._loggers[level].error(f"{topic}: {text}")
        elif level == "warn":
            self._loggers[level].warning(f"{topic}: {text}")
        elif not first or topic not in ("input", _LINKS):
            self._loggers[level].info(f"{topic}: {text}")
