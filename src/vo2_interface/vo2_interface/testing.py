"""For tests: nodes of this process on a ROS domain of their own, driven step by step."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from vo2_interface.executable import fastest_executor, join_graph, leave_graph
from vo2_interface.one_host import free_domain, one_host_environment
from vo2_interface.samples import SampleReader, SampleWriter
from vo2_interface.topics import DIAGNOSTICS, LATCHED_QOS, READ_QOS, REFERENCE, SAMPLE_QOS

__all__ = ["Bench", "bench", "hear_ctrl_c"]

_TIMEOUT_S = 60.0


def hear_ctrl_c() -> None:
    """Take Ctrl-C again where the runner was started deaf to it, as a shell without job control starts what runs behind.

    The processes that tests start inherit it: without this they would not hear the Ctrl-C that they are tested with.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


class Bench:
    """A node that stands in for the rest of the graph: it publishes and hears samples, and spins everything."""

    def __init__(self) -> None:
        self.node = Node("bench", namespace="/vo2")
        self.executor = fastest_executor()
        self.executor.add_node(self.node)
        self._closing: list[Any] = []
        self.heard: dict[str, list[tuple[int, tuple[float, ...]]]] = {}
        self.statuses: list[tuple[str, str, dict[str, str]]] = []
        self._writers: dict[str, tuple[SampleWriter, Any]] = {}
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, READ_QOS)

    def add(self, make: Callable[[], Node]) -> Node:
        """Add a node under test."""
        node = make()
        self._closing.append(node)
        self.executor.add_node(node)
        return node

    def hear(self, topic: str, channels: Sequence[str], qos: QoSProfile = READ_QOS) -> None:
        """Collect the samples of a topic in `heard`."""
        reader, heard = SampleReader(channels), self.heard.setdefault(topic, [])

        def collect(data: bytes) -> None:
            heard.append(reader.read(data))

        self.node.create_subscription(JointState, topic, collect, qos, raw=True)

    def say(self, topic: str, stamp_ns: int, values: Mapping[str, float], *, listeners: int = 1) -> None:
        """Publish a sample, once somebody listens."""
        if topic not in self._writers:
            qos = LATCHED_QOS if topic.endswith(REFERENCE) else SAMPLE_QOS
            publisher = self.node.create_publisher(JointState, topic, qos)
            self._writers[topic] = (SampleWriter((), ""), publisher)
            self.until(lambda: publisher.get_subscription_count() >= listeners)
        publisher = self._writers[topic][1]
        publisher.publish(SampleWriter(tuple(values), "integrated").write(stamp_ns, tuple(values.values())))

    def until(self, condition: Callable[[], bool], timeout_s: float = _TIMEOUT_S) -> None:
        """Spin until the condition holds; fail after the time limit."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise AssertionError(
                    f"not within {timeout_s:g} s; heard {self.counts()}, statuses {self.statuses[-5:]}"
                )
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, seconds: float) -> None:
        """Spin for a fixed time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def counts(self) -> dict[str, int]:
        """Return how many samples were heard on each topic."""
        return {topic: len(samples) for topic, samples in self.heard.items()}

    def status(self, name_end: str) -> tuple[str, dict[str, str]]:
        """Return (text, values) of the last status whose name ends so, empty if none was heard."""
        for name, text, values in reversed(self.statuses):
            if name.endswith(name_end):
                return text, values
        return "", {}

    def close(self) -> None:
        """Destroy all nodes, and let the executor go, which would keep their links alive."""
        leave_graph(self.executor, [*self._closing, self.node])

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.statuses.append(
                (status.name, status.message, {pair.key: pair.value for pair in status.values})
            )


@contextmanager
def bench(arguments: Sequence[str] = ()) -> Iterator[Bench]:
    """Give a bench on a domain of its own; `arguments` are ROS arguments for all nodes of the process.

    Yields
    ------
    Bench : closed at the end of the `with`
    """
    with patch.dict(os.environ, one_host_environment(free_domain())):
        join_graph(["test", *arguments])
        found = Bench()
        try:
            yield found
        finally:
            found.close()
