"""The demo's own node: calls services, sets parameters, listens to `/diagnostics`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from vo2_identification.record import HEARS
from vo2_interface.executable import fastest_executor, leave_graph
from vo2_interface.parameters import ros_parameters
from vo2_interface.samples import SampleReader
from vo2_interface.topics import DIAGNOSTICS, READ_QOS
from vo2_models.parameters import Value

from vo2_studies.demo.graph import Graph, GraphError, NodeProcess

__all__ = ["Conductor"]

_SPIN_S = 0.05
_CHECK_S = 0.5
_SETTLE_S = 0.5
_ASK_AGAIN_S = 3.0


class Conductor:
    """Talks to a running graph; every wait has a time limit and notices a process that died.

    Parameters
    ----------
    graph : the processes
    on_progress : called with (status name, text, values) of every diagnostic status that arrives

    Attributes
    ----------
    node : the node itself, for more than this class offers
    statuses : what each diagnostic status said last: (level, text, values)
    """

    def __init__(
        self, graph: Graph, on_progress: Callable[[str, str, Mapping[str, str]], None] | None = None
    ) -> None:
        self._graph = graph
        self.on_progress = on_progress
        self.statuses: dict[str, tuple[bytes, str, dict[str, str]]] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=graph.domain, args=[])
        self.node = Node("conductor", namespace="/vo2_demo", context=self._context)
        self._executor = fastest_executor(self._context)
        self._executor.add_node(self.node)
        self._clients: dict[tuple[str, type], Any] = {}
        self._met_s: dict[str, float] = {}
        self._checked = 0.0
        self._health = self._listen_to_health()

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self._executor, [self.node], self._context)

    def forget(self) -> None:
        """Forget what nodes have said, also what still waits to be read: call it between two runs, once nodes have ended.

        What a node of the first run said last must not count for the node of the same name in the second.
        """
        self.node.destroy_subscription(self._health)
        self.statuses.clear()
        self._health = self._listen_to_health()

    def wait_for(self, what: str, condition: Callable[[], bool], timeout_s: float) -> None:
        """Spin until `condition`; raise a `GraphError` naming `what` after `timeout_s`."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            self._executor.spin_once(timeout_sec=_SPIN_S)
            now = time.monotonic()
            if now - self._checked > _CHECK_S:
                self._checked = now
                self._graph.check()
            if now > deadline:
                raise GraphError(
                    f"waited {timeout_s:g} s for {what}; see the logs in {self._graph.log_folder}"
                )

    def pause(self, seconds: float) -> None:
        """Spin for a fixed time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=_SPIN_S)

    def wait_for_nodes(self, names: list[str], timeout_s: float = 60.0) -> None:
        """Wait until the parameter services of all nodes (full names) can be called."""
        for name in names:
            service = f"{name}/set_parameters_atomically"
            client = self._client(service, SetParametersAtomically)
            self.wait_for(f"the node {name}", client.service_is_ready, timeout_s)
            self._met_s.setdefault(service, time.monotonic())

    def wait_for_listeners(self, expected: Mapping[tuple[str, str], int], timeout_s: float = 60.0) -> None:
        """Wait until publishers have met their listeners: (node, topic), by full names, -> how many at least.

        The nodes tell it on `/diagnostics`; without it the first samples of a run would find nobody.
        """

        def missing() -> list[str]:
            return [
                f"{node} has {found or 'no'} of {count} listeners of {topic}"
                for (node, topic), count in expected.items()
                if int(found := self.value(f"{node.lstrip('/')}: links", topic) or "0") < count
            ]

        try:
            self.wait_for("publishers and listeners", lambda: not missing(), timeout_s)
        except GraphError as error:
            raise GraphError(f"{error}; {'; '.join(missing())}") from error
        # the listener may learn of the publisher a moment later than the other way round
        self.pause(_SETTLE_S)

    def wait_for_recorder(
        self, recorder: NodeProcess, topics: Sequence[str], timeout_s: float = 60.0
    ) -> None:
        """Wait until a `record` process has met the publishers of topics: of what comes before it loses some.

        Raises
        ------
        GraphError : not within `timeout_s`; names the topics.
        """

        def missing() -> set[str]:
            lines = recorder.log.read_text(errors="replace").splitlines()
            met = [line.removeprefix(HEARS) for line in lines if line.startswith(HEARS)]
            return set(topics) - {topic.strip() for line in met for topic in line.split(",")}

        try:
            self.wait_for(f"{recorder.name} to meet publishers", lambda: not missing(), timeout_s)
        except GraphError as error:
            raise GraphError(f"{error}; it hears nobody on {', '.join(sorted(missing()))}") from error

    def wait_for_sample(self, topic: str, stamp_s: float, timeout_s: float = 60.0) -> None:
        """Wait until a sample of this stamp or a later one comes on a topic."""
        with self.listen(topic) as newest_s:
            self.wait_for(
                f"the sample of {stamp_s:.3f} s on {topic}", lambda: newest_s() >= stamp_s - 1e-9, timeout_s
            )

    @contextmanager
    def listen(self, topic: str) -> Iterator[Callable[[], float]]:
        """Listen to samples on a topic from now on; yield a function that tells the newest stamp [s], -inf for none."""
        reader, newest = SampleReader(()), [float("-inf")]

        def note(data: bytes) -> None:
            newest[0] = max(newest[0], reader.read(data)[0] * 1e-9)

        subscription = self.node.create_subscription(JointState, topic, note, READ_QOS, raw=True)
        try:
            yield lambda: newest[0]
        finally:
            self.node.destroy_subscription(subscription)

    def set(self, node: str, values: Mapping[str, Value], timeout_s: float = 20.0) -> None:
        """Set parameters of a node (full name), all or none."""
        request = SetParametersAtomically.Request()
        request.parameters = [parameter.to_parameter_msg() for parameter in ros_parameters(values)]
        service = f"{node}/set_parameters_atomically"
        result = self.call(service, SetParametersAtomically, request, timeout_s, again_s=_ASK_AGAIN_S).result
        if not result.successful:
            raise GraphError(f"{node} refused {', '.join(values)}: {result.reason}")

    def trigger(self, service: str, timeout_s: float = 20.0) -> str:
        """Call a Trigger service (full name); return its message."""
        response = self.call(service, Trigger, Trigger.Request(), timeout_s)
        if not response.success:
            raise GraphError(f"{service}: {response.message}")
        return str(response.message)

    def value(self, status: str, key: str) -> str:
        """Return a value of a diagnostic status (full name, as `vo2/plant: time`), empty if not heard."""
        return self.statuses[status][2].get(key, "") if status in self.statuses else ""

    def call(
        self, name: str, kind: type, request: Any, timeout_s: float = 20.0, *, again_s: float | None = None
    ) -> Any:
        """Call a service (full name) and return its answer; ask again every `again_s` where that does no harm."""
        client = self._client(name, kind)
        self.wait_for(f"the service {name}", client.service_is_ready, timeout_s)
        # a server drops an answer to a client that it has not met yet
        met_s = self._met_s.setdefault(name, time.monotonic()) + _SETTLE_S
        self.wait_for(f"the service {name}", lambda: time.monotonic() > met_s, timeout_s)
        asked: list[tuple[float, Future]] = []

        def answered() -> bool:
            now = time.monotonic()
            if not asked or (again_s is not None and now - asked[-1][0] > again_s):
                asked.append((now, client.call_async(request)))
            return any(future.done() for _, future in asked)

        self.wait_for(f"an answer of {name}", answered, timeout_s)
        return next(future.result() for _, future in asked if future.done())

    def _listen_to_health(self) -> Subscription:
        return self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, READ_QOS)

    def _client(self, name: str, kind: type) -> Any:
        if (name, kind) not in self._clients:
            self._clients[name, kind] = self.node.create_client(kind, name)
        return self._clients[name, kind]

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.statuses[status.name] = (status.level, status.message, values)
            if self.on_progress is not None:
                self.on_progress(status.name, status.message, values)
