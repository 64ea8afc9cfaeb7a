"""What to publish when: a bag as a schedule, with offset, length, topics and passes."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.problems import BagError, Problem
from vo2_identification.bags.storage import raw_messages

__all__ = ["STAMPED", "Due", "Outline", "outline", "schedule"]

_STAMP = struct.Struct("<iI")
_NS = 1_000_000_000
STAMPED = frozenset(
    {
        "sensor_msgs/msg/JointState",
        "diagnostic_msgs/msg/DiagnosticArray",
        "rosgraph_msgs/msg/Clock",
    }
)
"""Types of the contract, all of which begin with a stamp: a later pass moves it on."""
_LONGEST_NS = 10**16
"""No recording is longer (116 days): stamps of a topic further apart come from two clocks."""


@dataclass
class Outline:
    """What a bag holds.

    Attributes
    ----------
    channels : topic -> its description
    counts : topic -> number of messages
    first_ns, last_ns : earliest and latest log time [ns]
    pass_ns : by how much a second pass must move stamps and log times so that they go on increasing [ns]
    problems : what is wrong with the bag
    """

    channels: dict[str, Channel] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    first_ns: int = 0
    last_ns: int = 0
    pass_ns: int = 0
    problems: list[Problem] = field(default_factory=list)


@dataclass(frozen=True)
class Due:
    """One message to publish `due_s` after the start of the replay at rate 1, at bag time `time_ns`."""

    topic: str
    due_s: float
    time_ns: int
    data: bytes


def outline(path: str | Path, topics: Collection[str] | None = None) -> Outline:
    """Return what a bag holds, after one pass through it.

    Parameters
    ----------
    path : bag
    topics : those wanted, None for all

    Raises
    ------
    BagError : no bag, no message in it, or a wanted topic is not there.
    """
    found = Outline()
    present: set[str] = set()
    times: list[int] = []
    stamps: dict[
        str, list[int]
    ] = {}  # of each topic the earliest and latest; their clock need not be that of the log

    def wanted(channel: Channel) -> bool:
        present.add(channel.topic)
        return topics is None or channel.topic in topics

    for channel, log_time, data in raw_messages(path, found.problems, wanted):
        topic = channel.topic
        if topic not in found.channels:
            found.channels[topic] = channel
            found.counts[topic] = 0
            times += (log_time, log_time)
        found.counts[topic] += 1
        times[0] = min(times[0], log_time)
        times[1] = max(times[1], log_time)
        if channel.msgtype in STAMPED and (stamp := _stamp_ns(data)) is not None:
            span = stamps.setdefault(topic, [stamp, stamp])
            span[0] = min(span[0], stamp)
            span[1] = max(span[1], stamp)
    for topic in topics or ():
        if topic not in found.channels:
            raise BagError(
                f"{path}: found no topic {topic}, the bag has {', '.join(sorted(present)) or 'none'}"
            )
    if not found.channels:
        reason = "; ".join(map(str, found.problems[:2])) or "it is empty"
        raise BagError(f"{path}: found no message in the bag ({reason})")
    found.first_ns, found.last_ns = times[0], times[1]
    busiest = max(found.counts, key=lambda topic: found.counts[topic])
    period = (times[1] - times[0]) // max(found.counts[busiest] - 1, 1) or _NS
    lengths = [last - first for first, last in stamps.values() if last - first < _LONGEST_NS]
    found.pass_ns = max(times[1] - times[0], *lengths, 0) + period
    return found


def schedule(
    path: str | Path,
    bag: Outline,
    *,
    offset_s: float = 0.0,
    duration_s: float | None = None,
    passes: int | None = 1,
    latched: Collection[str] = (),
) -> Iterator[Due]:
    """Yield the messages in the order and at the times to publish them.

    Parameters
    ----------
    bag : outline of the topics to play
    offset_s : part of the bag to leave out at its start [s]
    duration_s : length to play [s], None for all
    passes : number of passes, None for no end. A later pass has its stamps moved on by the length of the bag.
    latched : topics whose last message before the offset is published at the start
    path : of the bag

    Raises
    ------
    BagError : a later pass would move a stamp beyond the 32 bits of its seconds.
    """
    begin = bag.first_ns + round(offset_s * _NS)
    end = None if duration_s is None else begin + round(duration_s * _NS)
    done = 0
    while passes is None or done < passes:
        shift = done * bag.pass_ns
        earlier: dict[str, Due] = {}
        latest = begin
        lead = done * (bag.pass_ns - (begin - bag.first_ns)) / _NS
        for channel, log_time, data in raw_messages(path, [], lambda each: each.topic in bag.channels):
            if end is not None and log_time >= end:
                continue
            moved = _moved(data, shift) if shift and channel.msgtype in STAMPED else data
            if log_time < begin:
                if channel.topic in latched and not done:
                    earlier[channel.topic] = Due(channel.topic, 0.0, begin, moved)
                continue
            if earlier:
                yield from earlier.values()
                earlier = {}
            # log times may step back a little between topics: the order of writing is the order of playing
            latest = max(latest, log_time)
            yield Due(channel.topic, lead + (latest - begin) / _NS, latest + shift, moved)
        yield from earlier.values()
        done += 1


def _stamp_ns(data: bytes) -> int | None:
    """Return the stamp of a little-endian message that begins with one, None where it cannot have one."""
    if data[:2] != b"\x00\x01" or len(data) < 4 + _STAMP.size:
        return None
    seconds, nanoseconds = _STAMP.unpack_from(data, 4)
    return int(seconds) * _NS + int(nanoseconds)


def _moved(data: bytes, shift_ns: int) -> bytes:
    """Return a little-endian message that begins with a stamp, its stamp moved on."""
    stamp = _stamp_ns(data)
    if stamp is None:
        return data
    try:
        return data[:4] + _STAMP.pack(*divmod(stamp + shift_ns, _NS)) + data[12:]
    except struct.error:
        raise BagError(
            f"a stamp of {stamp / _NS:.9g} s cannot be moved on by {shift_ns / _NS:.6g} s, its seconds have 32 bits; "
            "play the bag fewer times"
        ) from None
