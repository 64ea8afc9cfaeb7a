"""A node that puts the messages of some topics into a bag, untouched and in the order of arrival."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos, QosDurability, QosReliability
from vo2_interface.topics import LATCHED_QOS, READ_QOS, SAMPLE_QOS

from vo2_identification.bags.channels import JOINT_STATE
from vo2_identification.bags.qos import contract_qos
from vo2_identification.bags.writing import BagWriter, message_definition

__all__ = ["Recorder", "contract_topics"]

_STAMP = struct.Struct("<iI")
_CLOCK = "rosgraph_msgs/msg/Clock"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_SAMPLES = (JOINT_STATE, _CLOCK)
_ANOTHER_CLOCK_NS = 86_400_000_000_000
_MOST_WAITING = 1000


def contract_topics(namespace: str) -> dict[str, str]:
    """Return the topics of a loop and their types: samples, diagnostics and clock.

    Parameters
    ----------
    namespace : of the loop, such as /vo2
    """
    roles = ("command", "measurement", "estimate", "reference")
    samples = {f"{namespace.rstrip('/')}/{role}": JOINT_STATE for role in roles}
    return {**samples, "/diagnostics": _DIAGNOSTICS, "/clock": _CLOCK}


class Recorder(Node):
    """Subscribes and writes.

    The log time of a sample and of a clock is its own stamp, so that a run in simulated time always makes the
    same bag. Other messages are filed under their stamp if it is on the samples' clock, else under the latest
    sample. Exact repeats of a topic's last sample (a plant in lockstep repeats itself until answered) are left out.

    Parameters
    ----------
    bag : open bag
    topics : topic -> message type, "" to take it from the graph when the topic appears there

    Attributes
    ----------
    count, repeats : messages written, and left out as repeats
    failure : why the bag cannot be written any more, None while it can; further messages are ignored
    """

    def __init__(self, bag: BagWriter, topics: Mapping[str, str]) -> None:
        super().__init__("recorder")
        self.bag = bag
        self.count = 0
        self.repeats = 0
        self.failure: OSError | None = None
        self._types = dict(topics)
        self._numbers: dict[str, int] = {}
        self._last: dict[str, bytes] = {}
        self._latest_ns: int | None = None
        self._waiting: list[tuple[str, bytes]] = []
        self._subscriptions_by_topic: dict[str, Any] = {}
        for topic, msgtype in self._types.items():
            if msgtype:
                self._subscribe(topic, latched=topic.endswith("/reference"), reliable=True)

    @property
    def open_topics(self) -> list[str]:
        """Topics from which nothing has come yet."""
        return [topic for topic in self._types if topic not in self._numbers]

    def idle(self) -> None:
        """Do what is due twice a second: bring waiting messages to disk, look for topics still silent."""
        try:
            self.bag.flush_if_due()
        except OSError as error:
            self.failure = error
        if self.open_topics:
            self._look_around()

    def _look_around(self) -> None:
        """Take the types of unknown topics from the graph, and weaken a QoS that no publisher there offers."""
        known = dict(self.get_topic_names_and_types()) if "" in self._types.values() else {}
        for topic in self.open_topics:
            if not self._types[topic]:
                if topic not in known:
                    continue
                self._types[topic] = known[topic][0]
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            if not offered and topic in self._subscriptions_by_topic:
                continue
            latched = all(one.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in offered)
            latched = latched and (bool(offered) or topic.endswith("/reference"))
            reliable = all(one.reliability == ReliabilityPolicy.RELIABLE for one in offered)
            self._subscribe(topic, latched=latched, reliable=reliable)

    def take_waiting(self, before_ns: int) -> bool:
        """Take at most one waiting message of each topic, no executor spinning.

        Returns whether one of them was published before `before_ns` (system time [ns]): a topic that only has
        younger ones to offer has nothing more that was due by then.
        """
        due = False
        for subscription in self._subscriptions_by_topic.values():
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, True)
            if taken is not None:
                data, about = taken
                subscription.callback(data)
                due = due or about["source_timestamp"] <= before_ns
        return due

    def finish(self) -> None:
        """Write what still waits for a first sample to tell the time."""
        if self._waiting and self._latest_ns is None:
            self._latest_ns = time.time_ns()
        self._release()

    def _subscribe(self, topic: str, *, latched: bool, reliable: bool) -> None:
        qos = QoSProfile(
            history=SAMPLE_QOS.history,
            depth=READ_QOS.depth,  # the publisher keeps 100; this side may have to wait for the disk
            reliability=SAMPLE_QOS.reliability if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=LATCHED_QOS.durability if latched else SAMPLE_QOS.durability,
        )
        before = self._subscriptions_by_topic.get(topic)
        if before is not None:
            if (
                before.qos_profile.durability == qos.durability
                and before.qos_profile.reliability == qos.reliability
            ):
                return
            self.destroy_subscription(before)
        message_definition(self._types[topic])  # refused now, not at the first message
        package, _, name = self._types[topic].partition("/msg/")
        try:
            kind = getattr(import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            raise ValueError(
                f"topic {topic}: its type {self._types[topic]} is not installed here; leave it out of --topics"
            ) from None
        receive = self._sample if self._types[topic] in _SAMPLES else self._other

        def callback(data: bytes, topic: str = topic) -> None:
            receive(topic, data)

        self._subscriptions_by_topic[topic] = self.create_subscription(kind, topic, callback, qos, raw=True)

    def _sample(self, topic: str, data: bytes) -> None:
        if self._last.get(topic) == data:
            self.repeats += 1
            return
        self._last[topic] = data
        stamp_ns = _stamp_ns(data)
        first = self._latest_ns is None
        self._latest_ns = stamp_ns
        self._write(topic, stamp_ns, data)
        if first:
            self._release()

    def _other(self, topic: str, data: bytes) -> None:
        self._waiting.append((topic, data))
        if self._latest_ns is not None or len(self._waiting) >= _MOST_WAITING:
            self.finish()

    def _release(self) -> None:
        waiting, self._waiting = self._waiting, []
        for topic, data in waiting:
            log_time = latest = self._latest_ns or 0
            if _begins_with_stamp(self._types[topic]):
                stamp_ns = _stamp_ns(data)
                if abs(stamp_ns - latest) < _ANOTHER_CLOCK_NS:
                    log_time = stamp_ns
            self._write(topic, log_time, data)

    def _write(self, topic: str, log_time_ns: int, data: bytes) -> None:
        if self.failure is not None:
            return
        number = self._numbers.get(topic)
        if number is None:
            number = self.bag.add_topic(topic, self._types[topic], qos=self._offered(topic))
            self._numbers[topic] = number
        try:
            self.bag.write(number, log_time_ns, data)
            self.count += 1
        except OSError as error:  # the executor logs what a callback raises as a crash: the loop asks instead
            self.failure = error

    def _offered(self, topic: str) -> Qos:
        """Return the QoS to store: what all publishers offer; depth and history do not travel with discovery."""
        qos = contract_qos(topic)
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        if not offered:
            return qos
        latched = all(one.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in offered)
        reliable = all(one.reliability == ReliabilityPolicy.RELIABLE for one in offered)
        return qos._replace(
            durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
            reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        )


def _stamp_ns(data: bytes) -> int:
    """Return the stamp that a serialized message begins with (behind the four bytes of encapsulation)."""
    order = "<" if data[1] & 1 else ">"
    seconds, nanoseconds = _STAMP.unpack_from(data, 4) if order == "<" else struct.unpack_from(">iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


@lru_cache(maxsize=64)
def _begins_with_stamp(msgtype: str) -> bool:
    package, _, name = msgtype.partition("/msg/")
    fields = getattr(import_module(f"{package}.msg"), name).get_fields_and_field_types()
    return next(iter(fields.values()), "") in {"std_msgs/Header", "builtin_interfaces/Time"}
