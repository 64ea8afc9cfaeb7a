"""A node that puts the messages of some topics into a bag, untouched and in the order of publication."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Mapping
from functools import lru_cache
from operator import itemgetter
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos, QosDurability, QosReliability
from vo2_interface.samples import MalformedSampleError, SampleReader, message_stamp_ns
from vo2_interface.topics import DEFAULT_NAMESPACE, LATCHED_QOS, OVERRIDABLE_INPUT, READ_QOS, SAMPLE_QOS

from vo2_identification.bags.channels import JOINT_STATE, message_class
from vo2_identification.bags.qos import contract_qos
from vo2_identification.bags.writing import BagWriter, message_definition
from vo2_identification.stream_check import StreamCheck, compare_beginnings

__all__ = ["Recorder", "contract_topics"]

_CLOCK = "rosgraph_msgs/msg/Clock"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_SAMPLES = (JOINT_STATE, _CLOCK)
_ANOTHER_CLOCK_NS = 86_400_000_000_000
_MOST_WAITING = 1000
_PAUSING = ("command", "reference")
"""Roles that stop and go by design: a gap in their stamps says nothing."""
_OF_ONE_PERIOD = ("command", "measurement", "estimate")
"""Roles that have a sample of every period; a reference is latched, and may be older than the recorder."""


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
    A message that begins with no stamp although its type does is left out and counted. The parameters
    `qos_overrides./TOPIC.subscription.*` override what it asks for of a topic, and what it would take from the publishers.

    No executor spins it: `take` is to be called some fifty times a second, since to be woken for every message would
    take time from the loop beside it, and since only so each message comes with its publisher's number.

    Parameters
    ----------
    bag : open bag
    topics : topic -> message type, "" to take it from the graph when the topic appears there; None for the topics of
        the loop in the node's namespace
    wanted : pattern of further topics to take as they appear on the graph, None for none

    Attributes
    ----------
    count, repeats : messages written, and left out as repeats
    refused : topic and cause -> messages that were left out since they cannot be read
    checks : topic -> what is missing of it
    failure : why the bag cannot be written any more, None while it can; further messages are ignored
    """

    def __init__(
        self, bag: BagWriter, topics: Mapping[str, str] | None = None, wanted: re.Pattern[str] | None = None
    ) -> None:
        super().__init__("recorder", start_parameter_services=False)
        if topics is None:
            space = self.get_namespace()
            topics = contract_topics(DEFAULT_NAMESPACE if space == "/" else space)
        self.bag = bag
        self._wanted = wanted
        self._passed_by: dict[str, str] = {}
        self.refused: Counter[tuple[str, str]] = Counter()
        self.checks: dict[str, StreamCheck] = {}
        self._readers: dict[str, SampleReader] = {}
        self._publisher_counts: dict[str, int] = {}
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
    def topics(self) -> list[str]:
        """Topics that are recorded as soon as something comes on them."""
        return list(self._types)

    @property
    def lost(self) -> int:
        """Messages of all topics that were sent and did not arrive."""
        return sum(check.lost for check in self.checks.values())

    @property
    def without_sample(self) -> int:
        """Sample periods of all topics in which their sources sent nothing."""
        return sum(check.missing for check in self.checks.values())

    @property
    def most_missing(self) -> float:
        """The same as a share of its periods, of the topic that lacks most."""
        return max((check.missing_share for check in self.checks.values()), default=0.0)

    def missing(self) -> list[str]:
        """Return a line for each topic of which something is missing or unreadable."""
        told = [(topic, check.words()) for topic, check in self.checks.items() if check.words()]
        told += self._passed_by.items()
        told += [(topic, f"{count} left out: {cause}") for (topic, cause), count in self.refused.items()]
        return [f"{topic}: {words}" for topic, words in told]

    @property
    def open_topics(self) -> list[str]:
        """Topics from which nothing has come yet."""
        return [topic for topic in self._types if topic not in self._numbers]

    @property
    def met(self) -> set[str]:
        """Topics whose publisher this node has met: a publisher that has met it only sends into the void until then."""
        return {topic for topic, each in self._subscriptions_by_topic.items() if each.get_publisher_count()}

    def idle(self) -> None:
        """Do what is due twice a second: bring waiting messages to disk, look for topics still silent or new."""
        try:
            self.bag.flush_if_due()
        except OSError as error:
            self.failure = error
        if self._wanted is not None:
            self._look_for_more(self._wanted)
        if self.open_topics:
            self._look_around()

    def _look_for_more(self, wanted: re.Pattern[str]) -> None:
        for topic, types in self.get_topic_names_and_types():
            # names that begin with an underscore are hidden, as for `ros2 topic list`
            if topic in self._types or topic in self._passed_by or "/_" in topic or not wanted.search(topic):
                continue
            try:
                message_definition(types[0])
                message_class(types[0])
                self._types[topic] = types[0]
            except ValueError as error:
                self._passed_by[topic] = f"not recorded: {error}"

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

    def take(self, *, before_ns: int | None = None, most: int | None = None) -> bool:
        """Write everything that waits, in the order in which it was published.

        Parameters
        ----------
        before_ns : system time [ns]
        most : stop once so many messages are written, None for no end

        Returns
        -------
        bool : whether any of them was published before `before_ns`; where it was not, nothing due by then is missing.
        """
        waiting: list[tuple[int, str, bytes, int | None]] = []
        # asked anew: the first message of a new publisher would be taken for a gap in another's numbers
        self._publisher_counts.clear()
        for topic, subscription in self._subscriptions_by_topic.items():
            with subscription.handle:
                for _ in range(READ_QOS.depth):
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                    if taken is None:
                        break
                    data, about = taken
                    waiting.append(
                        (about["source_timestamp"], topic, data, about["publication_sequence_number"])
                    )
        waiting.sort(key=itemgetter(0))
        for _, topic, data, number in waiting:
            if most is not None and self.count >= most:
                break
            check = self.checks.setdefault(topic, StreamCheck())
            if number is not None:
                check.hear_number(number, self._publisher_count(topic))
            try:
                self._receive(topic, data)
            except MalformedSampleError as error:
                self.refused[topic, str(error)] += 1
        return before_ns is not None and any(published <= before_ns for published, *_ in waiting)

    def _publisher_count(self, topic: str) -> int:
        if topic not in self._publisher_counts:
            self._publisher_counts[topic] = self.count_publishers(topic)
        return self._publisher_counts[topic]

    def _receive(self, topic: str, data: bytes) -> None:
        if self._types[topic] in _SAMPLES:
            self._sample(topic, data)
        else:
            self._other(topic, data)

    def finish(self) -> None:
        """Write what still waits for a first sample to tell the time, and see what began later than the rest of its loop."""
        self._write_waiting()
        loops: dict[str, dict[str, StreamCheck]] = {}
        for topic, check in self.checks.items():
            space, _, role = topic.rpartition("/")
            if role in _OF_ONE_PERIOD:
                loops.setdefault(space, {})[topic] = check
        for loop in loops.values():
            compare_beginnings(loop, time.time_ns())

    def _write_waiting(self) -> None:
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
            # what the command line says stands, whatever is offered
            if any(name.startswith(f"qos_overrides.{topic}.") for name in self._parameter_overrides) or (
                before.qos_profile.durability == qos.durability
                and before.qos_profile.reliability == qos.reliability
            ):
                return
            self.destroy_subscription(before)
        message_definition(self._types[topic])  # refused now, not at the first message
        try:
            kind = message_class(self._types[topic])
        except ValueError as error:
            raise ValueError(f"topic {topic}: {error}; leave it out of --topics") from None
        # `take` asks for the messages: nobody calls this
        self._subscriptions_by_topic[topic] = self.create_subscription(
            kind,
            topic,
            _ignore,
            qos,
            raw=True,
            qos_overriding_options=OVERRIDABLE_INPUT if before is None else None,
        )

    def _sample(self, topic: str, data: bytes) -> None:
        if self._last.get(topic) == data:
            self.repeats += 1
            return
        if self._types[topic] == JOINT_STATE:
            # the whole layout is looked at: what other tools cannot read does not belong into a bag
            stamp_ns, _ = self._readers.setdefault(topic, SampleReader(())).read(data)
        else:
            stamp_ns = message_stamp_ns(data)
        self._last[topic] = data
        if self._types[topic] == JOINT_STATE:
            self.checks[topic].hear_stamp(stamp_ns, steady=topic.rsplit("/", 1)[-1] not in _PAUSING)
        first = self._latest_ns is None
        self._latest_ns = stamp_ns
        self._write(topic, stamp_ns, data)
        if first:
            self._release()

    def _other(self, topic: str, data: bytes) -> None:
        if _begins_with_stamp(self._types[topic]):
            message_stamp_ns(data)  # refused now, not when it is written
        self._waiting.append((topic, data))
        if self._latest_ns is not None or len(self._waiting) >= _MOST_WAITING:
            self._write_waiting()

    def _release(self) -> None:
        waiting, self._waiting = self._waiting, []
        for topic, data in waiting:
            log_time = latest = self._latest_ns or 0
            if _begins_with_stamp(self._types[topic]):
                stamp_ns = message_stamp_ns(data)
                # 0 is no time: a node on simulated time that has not heard any yet
                if stamp_ns and abs(stamp_ns - latest) < _ANOTHER_CLOCK_NS:
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


def _ignore(_data: bytes) -> None:
    """Stand for a callback where messages are asked for."""


@lru_cache(maxsize=64)
def _begins_with_stamp(msgtype: str) -> bool:
    fields = message_class(msgtype).get_fields_and_field_types()
    return next(iter(fields.values()), "") in {"std_msgs/Header", "builtin_interfaces/Time"}
