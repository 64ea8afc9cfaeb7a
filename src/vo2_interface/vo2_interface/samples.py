"""Stamped vectors of named channels: `sensor_msgs/msg/JointState` on the wire, floats in fixed order inside.

A loop exchanges some thousand samples a second, always with the same names. So the names are laid out
once: writing a sample packs a stamp and a few doubles between prepared bytes, reading one compares these
with the layout seen last and unpacks.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from vo2_interface.joint_state_cdr import (
    FRAME_AT,
    LITTLE_ENDIAN,
    STAMP_AT,
    CdrError,
    CountError,
    blank_sample,
    read_layout,
)

__all__ = [
    "ClockWriter",
    "MalformedSampleError",
    "SampleReader",
    "SampleWriter",
    "message_stamp_ns",
    "stamp_message",
]

_NAN = float("nan")
_STAMP = struct.Struct("<iI")
_NS = 1_000_000_000
_DAMAGED = "it is cut short or no sensor_msgs/msg/JointState"


class MalformedSampleError(ValueError):
    """Bytes that are no sample; the text is the same for all with the same cause."""


def message_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns] that a serialized message begins with.

    Parameters
    ----------
    data : the message as it came, in CDR

    Raises
    ------
    MalformedSampleError : the message ends before it, it is negative, or it has more nanoseconds than a second.
    """
    if len(data) < FRAME_AT:
        raise MalformedSampleError("it ends within its stamp")
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, STAMP_AT)
    return _checked_stamp_ns(seconds, nanoseconds)


def _checked_stamp_ns(seconds: int, nanoseconds: int) -> int:
    if seconds < 0 or nanoseconds >= _NS:
        raise MalformedSampleError(
            "its stamp is negative" if seconds < 0 else "its stamp has more nanoseconds than a second"
        )
    return seconds * _NS + nanoseconds


def stamp_message(stamp_ns: int) -> Time:
    """Return whole nanoseconds as a message stamp.

    Parameters
    ----------
    stamp_ns : [ns]
    """
    return Time(sec=stamp_ns // _NS, nanosec=stamp_ns % _NS)


class SampleWriter:
    """Writes samples of fixed channels.

    Parameters
    ----------
    channels : names in the order of the values
    device : preset id for `header.frame_id`
    """

    def __init__(self, channels: Sequence[str], device: str = "") -> None:
        self.channels = tuple(channels)
        count = len(self.channels)
        buffer, values_at = blank_sample(self.channels, device)
        self._head = bytes(buffer[:STAMP_AT])
        self._body = bytes(buffer[FRAME_AT:values_at])
        self._tail = bytes(buffer[values_at + 8 * count :])
        self._pack = struct.Struct(f"<{STAMP_AT}siI{len(self._body)}s{count}d{len(self._tail)}s").pack

    def write(self, stamp_ns: int, values: Sequence[float]) -> bytes:
        """Return the serialized sample; `values` in the order of the channels, SI units."""
        return self._pack(self._head, stamp_ns // _NS, stamp_ns % _NS, self._body, *values, self._tail)


class ClockWriter:
    """Writes `rosgraph_msgs/msg/Clock`."""

    def __init__(self) -> None:
        self._buffer = bytearray(serialize_message(Clock()))

    def write(self, stamp_ns: int) -> bytes:
        """Return the serialized clock."""
        _STAMP.pack_into(self._buffer, STAMP_AT, *divmod(stamp_ns, _NS))
        return bytes(self._buffer)


class SampleReader:
    """Reads samples into fixed channel order; absent channels become NaN, unknown ones are left out.

    Parameters
    ----------
    channels : the names wanted, in the order wanted
    """

    def __init__(self, channels: Sequence[str]) -> None:
        self.channels = tuple(channels)
        self.names: tuple[str, ...] = ()
        self.device = ""
        self._body = b""
        self._body_end = FRAME_AT
        self._size = -1
        self._unpack: Callable[[bytes], tuple[Any, ...]] = struct.Struct("").unpack_from
        self._pick: Callable[[tuple[Any, ...]], tuple[float, ...]] = tuple

    def read(self, data: bytes) -> tuple[int, tuple[float, ...]]:
        """Return (stamp in ns, values in the order of `channels`) of a serialized JointState.

        Raises
        ------
        MalformedSampleError : it is cut short, is no JointState, or has a stamp that is no time.
        """
        if (
            len(data) != self._size
            or data[FRAME_AT : self._body_end] != self._body
            or data[:2] != LITTLE_ENDIAN
        ):
            return self._read_new_layout(data)
        found = self._unpack(data)
        return _checked_stamp_ns(found[0], found[1]), self._pick(found)

    def has(self, channel: str) -> bool:
        """Whether the last sample carried `channel`."""
        return channel in self.names

    def _read_new_layout(self, data: bytes) -> tuple[int, tuple[float, ...]]:
        try:
            layout = read_layout(data)
        except CountError:
            return self._read_by_names(data)
        except CdrError as error:
            raise MalformedSampleError(_DAMAGED) from error
        order = "<" if layout.little_endian else ">"
        body = layout.values_at - FRAME_AT
        unpack = struct.Struct(f"{order}{STAMP_AT}xiI{body}x{len(layout.names)}d").unpack_from
        found = unpack(data)
        stamp_ns = _checked_stamp_ns(found[0], found[1])
        self.names, self.device = layout.names, layout.frame
        self._pick = _picker(self.names, self.channels)
        self._unpack = unpack
        self._body, self._body_end = bytes(data[FRAME_AT : layout.values_at]), layout.values_at
        # a message of the other byte order never compares equal, and comes here every time
        self._size = len(data)
        return stamp_ns, self._pick(found)

    def _read_by_names(self, data: bytes) -> tuple[int, tuple[float, ...]]:
        """Read a message with fewer or more values than names: a channel without a value becomes NaN."""
        try:
            message = deserialize_message(data, JointState)
        except Exception as error:  # rclpy raises what its C layer and its text decoder say
            raise MalformedSampleError(_DAMAGED) from error
        self.names, self.device = tuple(message.name), message.header.frame_id
        positions = dict(zip(message.name, message.position, strict=False))
        stamp_ns = _checked_stamp_ns(message.header.stamp.sec, message.header.stamp.nanosec)
        return stamp_ns, tuple(float(positions.get(name, _NAN)) for name in self.channels)


def _picker(names: Sequence[str], wanted: Sequence[str]) -> Callable[[tuple[Any, ...]], tuple[float, ...]]:
    """Return what takes the values of the channels `wanted` from (seconds, nanoseconds, *values of `names`)."""
    places = [2 + names.index(name) if name in names else None for name in wanted]
    if len(places) == 1 and places[0] is not None:
        return itemgetter(slice(places[0], places[0] + 1))
    if len(places) > 1 and None not in places:
        return itemgetter(*places)
    return lambda found: tuple([_NAN if at is None else found[at] for at in places])
