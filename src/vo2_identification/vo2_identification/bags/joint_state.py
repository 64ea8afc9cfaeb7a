"""sensor_msgs/msg/JointState in CDR, taken apart and put together by the thousand.

A recording repeats one message layout: same device, same channel names, other stamp and other values. Its
messages are therefore decoded as one array of bytes, at some million messages a second; what differs in
layout starts an array of its own.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo2_identification.bags.channels import JOINT_STATE

__all__ = ["JointStates", "Samples", "encode", "typestore"]

_LITTLE_ENDIAN = b"\x00\x01"
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_BODY = 4  # CDR aligns from here, after the encapsulation header
_FRAME = 12  # frame_id begins here, after the stamp
_BATCH = 1 << 16


@dataclass(frozen=True)
class Samples:
    """All samples of one topic in the order they were stored.

    Attributes
    ----------
    stamp_ns : (n,) header stamps [ns]
    values : channel -> (n,), NaN where the message had no such channel
    present : channel -> (n,) whether the message had the channel
    frames : frame_id -> number of messages
    malformed : positions in the topic (0 is its first message) that could not be decoded, with the reason
    """

    stamp_ns: NDArray[np.int64]
    values: dict[str, NDArray[np.float64]]
    present: dict[str, NDArray[np.bool_]]
    frames: dict[str, int]
    malformed: list[tuple[int, str]]


@dataclass(frozen=True)
class _Layout:
    names: tuple[str, ...]
    frame: str
    offset: int
    """where the values begin in the message"""
    count: int
    """number of values"""


class JointStates:
    """Collects serialized messages of one topic; `samples()` gives them as arrays."""

    def __init__(self) -> None:
        self._waiting: list[bytes] = []
        self._first = 0
        self._parts: list[tuple[NDArray[np.int64], NDArray[np.int64], _Layout, NDArray[np.float64]]] = []
        self._malformed: list[tuple[int, str]] = []

    def add(self, data: bytes) -> None:
        """Append one serialized message."""
        self._waiting.append(data)
        if len(self._waiting) >= _BATCH:
            self._decode()

    def samples(self) -> Samples:
        """Return everything added so far."""
        self._decode()
        good = sum(part[0].size for part in self._parts)
        where = np.concatenate([part[0] for part in self._parts]) if good else np.empty(0, np.int64)
        # malformed messages leave no sample behind: the others move up
        order = np.argsort(where, kind="stable")
        rank = np.empty(good, np.int64)
        rank[order] = np.arange(good)
        stamps = np.empty(good, np.int64)
        values: dict[str, NDArray[np.float64]] = {}
        present: dict[str, NDArray[np.bool_]] = {}
        frames: dict[str, int] = {}
        done = 0
        for index, stamp, layout, matrix in self._parts:
            place = rank[done : done + index.size]
            done += index.size
            stamps[place] = stamp
            frames[layout.frame] = frames.get(layout.frame, 0) + index.size
            for column in reversed(range(layout.count)):  # of a name that occurs twice the first one counts
                name = layout.names[column]
                if name not in values:
                    values[name] = np.full(good, np.nan)
                    present[name] = np.zeros(good, np.bool_)
                values[name][place] = matrix[:, column]
                present[name][place] = True
        names = dict.fromkeys(name for part in self._parts for name in part[2].names[: part[2].count])
        return Samples(
            stamps,
            {name: values[name] for name in names},
            {name: present[name] for name in names},
            frames,
            sorted(self._malformed),
        )

    def _decode(self) -> None:
        waiting, first = self._waiting, self._first
        self._waiting, self._first = [], first + len(waiting)
        by_length: dict[int, list[int]] = {}
        for k, data in enumerate(waiting):
            by_length.setdefault(len(data), []).append(k)
        for length, members in by_length.items():
            joined = b"".join([waiting[k] for k in members])
            block = np.frombuffer(joined, np.uint8).reshape(len(members), length)
            index = np.array(members, np.int64)
            while index.size:
                sample = block[0].tobytes()
                layout, reason = _parse(sample)
                if layout is None:
                    same = np.zeros(index.size, np.bool_)
                    same[0] = True
                    message = _by_rosbags(sample)
                    if message is None:
                        self._malformed.append((first + int(index[0]), reason))
                    else:
                        single, layout, row = message
                        self._parts.append((index[:1] + first, np.array([single]), layout, row))
                else:
                    alike = block[:, _FRAME : layout.offset] == block[0, _FRAME : layout.offset]
                    same = alike.all(axis=1) & (block[:, :4] == block[0, :4]).all(axis=1)
                    chosen = np.ascontiguousarray(block[same])
                    stamp = np.ascontiguousarray(chosen[:, _BODY:_FRAME])
                    seconds = stamp[:, :4].copy().view("<i4").astype(np.int64).ravel()
                    nanoseconds = stamp[:, 4:].copy().view("<u4").astype(np.int64).ravel()
                    stop = layout.offset + 8 * layout.count
                    matrix = chosen[:, layout.offset : stop].copy().view("<f8").astype(np.float64)
                    self._parts.append(
                        (index[same] + first, seconds * 1_000_000_000 + nanoseconds, layout, matrix)
                    )
                block, index = block[~same], index[~same]


def encode(
    stamp_ns: NDArray[np.int64], names: Sequence[str], values: NDArray[np.float64], frame_id: str
) -> list[bytes]:
    """Return one serialized message per row.

    Parameters
    ----------
    stamp_ns : (n,) stamps [ns]
    names : m channel names
    values : (n, m) positions
    frame_id : device preset
    """
    template = bytearray(_serialize(names, frame_id))
    layout, reason = _parse(bytes(template))
    if layout is None:
        raise ValueError(f"names: found {list(names)!r} that cannot be written ({reason})")
    block = np.tile(np.frombuffer(bytes(template), np.uint8), (len(stamp_ns), 1))
    seconds, nanoseconds = np.divmod(stamp_ns, 1_000_000_000)
    block[:, _BODY : _BODY + 4] = seconds.astype("<i4").reshape(-1, 1).view(np.uint8)
    block[:, _BODY + 4 : _FRAME] = nanoseconds.astype("<u4").reshape(-1, 1).view(np.uint8)
    stop = layout.offset + 8 * layout.count
    block[:, layout.offset : stop] = (
        np.ascontiguousarray(values, "<f8").view(np.uint8).reshape(len(block), -1)
    )
    joined, length = block.tobytes(), block.shape[1]
    return [joined[k : k + length] for k in range(0, len(joined), length)]


def _parse(data: bytes) -> tuple[_Layout | None, str]:
    """Return the layout of a little-endian message, or None and the reason."""
    if data[:2] != _LITTLE_ENDIAN:
        return None, "not little-endian CDR"
    try:
        frame, position = _string(data, _FRAME)
        (names,), position = _LENGTH.unpack_from(data, position), position + 4
        found = []
        for _ in range(names):
            name, position = _string(data, position)
            found.append(name)
        (count,), position = _LENGTH.unpack_from(data, position), position + 4
    except (struct.error, UnicodeDecodeError) as error:
        return None, f"the message is cut short or damaged ({error})"
    if count:
        position += -(position - _BODY) % 8
    if position + 8 * count > len(data):
        return None, f"the message announces {count} values, but ends before them"
    if count != names:
        return None, f"the message has {names} names for {count} values"
    return _Layout(tuple(found), frame, position, count), ""


def _string(data: bytes, position: int) -> tuple[str, int]:
    position += -(position - _BODY) % 4
    (length,) = _LENGTH.unpack_from(data, position)
    stop = position + 4 + length
    if stop > len(data):
        raise struct.error(f"a text of {length} bytes ends outside the message")
    text = data[position + 4 : stop].rstrip(b"\0").decode()
    return text, stop + (-(stop - _BODY) % 4)


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Return the ROS 2 Jazzy message types of rosbags."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def _by_rosbags(data: bytes) -> tuple[int, _Layout, NDArray[np.float64]] | None:
    """Decode what is not little-endian, which no current middleware writes, at leisure."""
    if data[:2] != b"\x00\x00":
        return None
    try:
        message = typestore().deserialize_cdr(data, JOINT_STATE)
    except Exception:  # rosbags does not say what it raises on damaged data: reported as malformed
        return None
    count = len(message.position)
    if count != len(message.name):
        return None
    stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    layout = _Layout(tuple(message.name), message.header.frame_id, 0, count)
    return stamp, layout, np.asarray(message.position, np.float64).reshape(1, count)


def _serialize(names: Sequence[str], frame_id: str) -> bytes:
    store = typestore()
    time = store.types["builtin_interfaces/msg/Time"]
    header = store.types["std_msgs/msg/Header"]
    message = store.types[JOINT_STATE](
        header=header(stamp=time(sec=0, nanosec=0), frame_id=frame_id),
        name=list(names),
        position=np.zeros(len(names)),
        velocity=np.empty(0),
        effort=np.empty(0),
    )
    return bytes(store.serialize_cdr(message, JOINT_STATE))
