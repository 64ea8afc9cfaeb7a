"""Subscriptions to samples: whatever quality of service is offered, whatever bytes arrive, and what got lost."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from copy import copy
from statistics import median_low

from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.samples import MalformedSampleError, message_stamp_ns
from vo2_interface.topics import LATCHED_QOS, OVERRIDABLE_INPUT, READ_QOS

__all__ = ["SampleInput"]

_STEPS = 20
"""Steps between stamps after which the usual one is known."""


class SampleInput:
    """One input of a node.

    It asks for reliable delivery, so that nothing is lost where the other side offers that; once a publisher offers
    less it takes best effort, tells so, and counts what gaps in the stamps show. The parameters
    `qos_overrides./TOPIC.subscription.reliability`, `.depth`, `.history` and `.durability` override what it asks for.
    A message that cannot be read is dropped, counted, and told once per cause.

    Parameters
    ----------
    node : that listens
    topic : relative name
    receive : is called with each serialized sample; may raise `MalformedSampleError` before it changes anything
    diagnostics : where faults are told, as `input NAME`
    latched : whether samples from before the start are wanted
    steady : whether samples come all the time, so that their absence is told; those of a latched topic need not
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        receive: Callable[[bytes], None],
        diagnostics: Diagnostics,
        *,
        latched: bool = False,
        steady: bool = True,
    ) -> None:
        self._node, self._topic, self._receive, self._diagnostics = node, topic, receive, diagnostics
        self._refused: Counter[str] = Counter()
        self._arrived = 0
        self._last_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_STEPS)
        self._steps = 0
        self._lost = 0
        self._qos = copy(LATCHED_QOS if latched else READ_QOS)
        self._subscription = self._subscribe(OVERRIDABLE_INPUT)
        self._qos = self._subscription.qos_profile
        if steady and not latched:
            diagnostics.watch_input(topic, lambda: self._arrived)

    def _subscribe(self, options: QoSOverridingOptions | None = None) -> Subscription:
        events = SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible)
        return self._node.create_subscription(
            JointState,
            self._topic,
            self._on_message,
            self._qos,
            raw=True,
            event_callbacks=events,
            qos_overriding_options=options,
        )

    def _on_message(self, data: bytes) -> None:
        self._arrived += 1
        try:
            self._receive(data)
            self._diagnostics.note_sample(data)
            if self._qos.reliability == ReliabilityPolicy.BEST_EFFORT:
                self._look_for_gap(message_stamp_ns(data))
        except MalformedSampleError as error:
            self._refuse(str(error))

    def _look_for_gap(self, stamp_ns: int) -> None:
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or stamp_ns <= last_ns:
            return
        step = stamp_ns - last_ns
        self._recent.append(step)
        self._steps += 1
        if self._steps <= _STEPS:
            return
        # the median of the last steps is the period: a lost sample makes one longer, and a timer that catches up one shorter
        lost = round(step / median_low(self._recent)) - 1
        if lost > 0:
            before, self._lost = self._lost, self._lost + lost
            if (
                before.bit_length() != self._lost.bit_length()
            ):  # at 1, 2, 4, 8 ...: a flood must not cause another
                self._tell(
                    f"{self._lost} samples of {self._steps + self._lost} are missing by their stamps so far"
                )

    def _refuse(self, cause: str) -> None:
        self._refused[cause] += 1
        if self._refused[cause] == 1:
            self._tell(
                f"a message cannot be used and is dropped, with all others of its kind: {'; '.join(self._refused)}"
            )

    def _on_incompatible(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        """Take what a publisher offers: less than this would not be heard at all."""
        if event.last_policy_kind == QoSPolicyKind.RELIABILITY:
            self._qos.reliability = ReliabilityPolicy.BEST_EFFORT
            self._tell("a publisher offers best effort only: heard so, what is lost on the way stays lost")
        elif event.last_policy_kind == QoSPolicyKind.DURABILITY:
            self._qos.durability = DurabilityPolicy.VOLATILE
        else:
            name = QoSPolicyKind(event.last_policy_kind).name.lower()
            self._tell(f"a publisher offers another {name} and is not heard: change it, or override it here")
            return
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._subscribe()

    def _tell(self, text: str) -> None:
        self._diagnostics.report(f"input {self._topic}", "warn", f"{self._subscription.topic_name}: {text}")
