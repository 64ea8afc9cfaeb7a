"""sensor_msgs/msg/JointState in CDR, taken apart and put together by the thousand.

A recording repeats one message layout: same device, same channel names, other stamp and other values. Its
messages are therefore decoded as one array of bytes, at some million messages a second; what differs in
layout starts an array of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_interface.joint_state_cdr import FRAME_AT, STAMP_AT, CdrError, blank_sample, read_layout

__all__ = ["JointStates", "Samples", "encode", "typestore"]

_BATCH = 1 << 16
_BATCH_BYTES = 1 << 24
_LAYOUTS = 16
_MOST_FRAMES = 100
_MOST_MALFORMED = 100


@dataclass(frozen=True)
class Samples:
    """All samples of one topic in the order they were stored.

    Attributes
    ----------
    stamp_ns : (n,) header stamps [ns]
    values : channel -> (n,), NaN where the message had no such channel
    present : channel -> (n,) whether the message had the channel
    frames : frame_id -> number of messages, of the first hundred
    malformed : positions in the topic (0 is its first message) of the first hundred messages that could not be decoded,
        with the reason
    malformed_count : number of all of these
    """

    stamp_ns: NDArray[np.int64]
    values: dict[str, NDArray[np.float64]]
    present: dict[str, NDArray[np.bool_]]
    frames: dict[str, int]
    malformed: list[tuple[int, str]]
    malformed_count: int = 0


@dataclass(frozen=True)
class _Part:
    """Messages of one layout: places in the topic, stamps [ns], frame, wanted names and their values (n, m)."""

    index: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    frame: str
    names: tuple[str, ...]
    values: NDArray[np.float64]


class JointStates:
    """Collects serialized messages of one topic; `samples()` gives them as arrays.

    Memory: 8 bytes for the stamp and each wanted channel of a message, three times that while `samples` works.

    Parameters
    ----------
    channels : names that are kept, None for all
    """

    def __init__(self, channels: Collection[str] | None) -> None:
        self._channels = None if channels is None else frozenset(channels)
        self._waiting: list[bytes] = []
        self._waiting_bytes = 0
        self._first = 0
        self._parts: list[_Part] = []
        self._malformed: list[tuple[int, str]] = []
        self._malformed_count = 0
        self._held = 0

    @property
    def held(self) -> int:
        """Stamps and values that are held; of messages that wait to be decoded, their length in such."""
        return self._held + self._waiting_bytes // 8

    def add(self, data: bytes) -> None:
        """Append one serialized message."""
        self._waiting.append(data)
        self._waiting_bytes += len(data)
        if len(self._waiting) >= _BATCH or self._waiting_bytes >= _BATCH_BYTES:
            self._decode()

    def samples(self) -> Samples:
        """Return everything added so far."""
        self._decode()
        parts = self._parts
        good = sum(part.index.size for part in parts)
        where = np.concatenate([part.index for part in parts]) if good else np.empty(0, np.int64)
        # malformed messages leave no sample behind: the others move up
        rank = np.empty(good, np.int64)
        rank[np.argsort(where, kind="stable")] = np.arange(good)
        del where
        stamps = np.empty(good, np.int64)
        names = dict.fromkeys(name for part in parts for name in part.names)
        values = {name: np.full(good, np.nan) for name in names}
        present = {name: np.zeros(good, np.bool_) for name in names}
        frames: dict[str, int] = {}
        done = 0
        for part in parts:
            place = rank[done : done + part.index.size]
            done += part.index.size
            stamps[place] = part.stamp_ns
            if part.frame in frames or len(frames) < _MOST_FRAMES:
                frames[part.frame] = frames.get(part.frame, 0) + part.index.size
            for column, name in enumerate(part.names):
                values[name][place] = part.values[:, column]
                present[name][place] = True
        return Samples(stamps, values, present, frames, sorted(self._malformed), self._malformed_count)

    def _decode(self) -> None:
        waiting, first = self._waiting, self._first
        self._waiting, self._waiting_bytes, self._first = [], 0, first + len(waiting)
        by_length: dict[int, list[int]] = {}
        for k, data in enumerate(waiting):
            by_length.setdefault(len(data), []).append(k)
        for length, members in by_length.items():
            block = np.frombuffer(b"".join([waiting[k] for k in members]), np.uint8).reshape(-1, length)
            index = np.array(members, np.int64) + first
            for _ in range(_LAYOUTS):
                if not index.size:
                    break
                same = self._take(block, index)
                block, index = block[~same], index[~same]
            # so many layouts are nobody's recording: one by one, since each look through the block takes its length
            for k in range(index.size):
                self._take(block[k : k + 1], index[k : k + 1])

    def _take(self, block: NDArray[np.uint8], index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Decode the first message of a block and all others of its layout; return which they are."""
        try:
            layout = read_layout(block[0].tobytes())
        except CdrError as error:
            self._malformed_count += 1
            if len(self._malformed) < _MOST_MALFORMED:
                self._malformed.append((int(index[0]), str(error)))
            return np.arange(index.size) == 0
        alike = block[:, FRAME_AT : layout.values_at] == block[0, FRAME_AT : layout.values_at]
        same = alike.all(axis=1) & (block[:, :STAMP_AT] == block[0, :STAMP_AT]).all(axis=1)
        chosen = block[same]
        order = "<" if layout.little_endian else ">"
        seconds = _column(chosen, STAMP_AT, f"{order}i4").astype(np.int64)
        nanoseconds = _column(chosen, STAMP_AT + 4, f"{order}u4").astype(np.int64)
        # of a name that occurs twice the first one counts
        columns = {
            name: k
            for k, name in reversed(list(enumerate(layout.names)))
            if self._channels is None or name in self._channels
        }
        names = tuple(sorted(columns, key=columns.__getitem__))
        values = np.empty((index[same].size, len(names)))
        for column, name in enumerate(names):
            values[:, column] = _column(chosen, layout.values_at + 8 * columns[name], f"{order}f8")
        self._held += (1 + len(names)) * int(np.count_nonzero(same))
        self._parts.append(
            _Part(index[same], seconds * 1_000_000_000 + nanoseconds, layout.frame, names, values)
        )
        return same


def _column(block: NDArray[np.uint8], at: int, kind: str) -> NDArray[Any]:
    """Return what each row of bytes holds from `at` on."""
    return np.ascontiguousarray(block[:, at : at + np.dtype(kind).itemsize]).view(kind).ravel()


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
    template, values_at = blank_sample(names, frame_id)
    block = np.tile(np.frombuffer(bytes(template), np.uint8), (len(stamp_ns), 1))
    seconds, nanoseconds = np.divmod(stamp_ns, 1_000_000_000)
    block[:, STAMP_AT : STAMP_AT + 4] = seconds.astype("<i4").reshape(-1, 1).view(np.uint8)
    block[:, STAMP_AT + 4 : FRAME_AT] = nanoseconds.astype("<u4").reshape(-1, 1).view(np.uint8)
    raw = np.ascontiguousarray(values, "<f8").view(np.uint8).reshape(len(block), -1)
    block[:, values_at : values_at + raw.shape[1]] = raw
    joined, length = block.tobytes(), block.shape[1]
    return [joined[k : k + length] for k in range(0, len(joined), length)]


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Return the ROS 2 Jazzy message types of rosbags."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)
