"""Where things lie in a serialized `sensor_msgs/msg/JointState`; needs no ROS, since bags are read without it.

The common data representation (CDR) aligns every member to its own size, counted from the end of the four-byte
encapsulation header, which tells the byte order: stamp, frame_id, names, positions, velocities, efforts.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "FRAME_AT",
    "LITTLE_ENDIAN",
    "STAMP_AT",
    "CdrError",
    "CountError",
    "Layout",
    "blank_sample",
    "read_layout",
]

LITTLE_ENDIAN = b"\x00\x01"
_BIG_ENDIAN = b"\x00\x00"
_ENCAPSULATION = 4
STAMP_AT = _ENCAPSULATION
"""Here are the seconds (4 bytes) and nanoseconds (4 bytes) of the stamp."""
FRAME_AT = STAMP_AT + 8
"""Here begins what messages of one device have in common."""
_MOST_NAMES = 10_000


class CdrError(ValueError):
    """Bytes that are no JointState; the text says why."""


class CountError(CdrError):
    """A whole JointState with another number of names than of positions."""


@dataclass(frozen=True)
class Layout:
    """What is equal in all messages of a device.

    Attributes
    ----------
    names : of the channels, in the order of the values
    frame : `header.frame_id`
    values_at : where the first value (8 bytes each) begins in the message
    little_endian : byte order of stamp and values
    """

    names: tuple[str, ...]
    frame: str
    values_at: int
    little_endian: bool = True


def read_layout(data: bytes) -> Layout:
    """Return the layout of a serialized message.

    Parameters
    ----------
    data : a serialised message

    Raises
    ------
    CdrError : no such message, one cut short, or one with another number of names than of positions (CountError).
    """
    if data[:2] not in (LITTLE_ENDIAN, _BIG_ENDIAN):
        raise CdrError("not CDR of either byte order")
    count_of = struct.Struct("<I" if data[:2] == LITTLE_ENDIAN else ">I")

    def count(at: int) -> tuple[int, int]:
        at = _align(at, 4)
        return count_of.unpack_from(data, at)[0], at + 4

    def text(at: int) -> tuple[str, int]:
        length, at = count(at)
        if at + length > len(data):
            raise struct.error(f"a text of {length} bytes ends outside the message")
        return data[at : at + length].rstrip(b"\0").decode(), at + length

    try:
        frame, at = text(FRAME_AT)
        expected, at = count(at)
        if expected > _MOST_NAMES:
            raise CdrError(f"the message announces {expected} names, need at most {_MOST_NAMES}")
        names = []
        for _ in range(expected):
            name, at = text(at)
            names.append(name)
        values, at = count(at)
    except (struct.error, UnicodeDecodeError) as error:
        raise CdrError(f"the message is cut short or damaged ({error})") from None
    at = _align(at, 8) if values else at
    if at + 8 * values > len(data):
        raise CdrError(f"the message announces {values} values, but ends before them")
    if values != expected:
        raise CountError(f"the message has {expected} names for {values} values")
    return Layout(tuple(names), frame, at, data[:2] == LITTLE_ENDIAN)


def blank_sample(channels: Sequence[str], device: str) -> tuple[bytearray, int]:
    """Return a little-endian JointState of zeros and where its positions begin.

    Written here, not by the message class, which leaves whatever memory held in the padding between members:
    the same run must give the same bytes.

    Parameters
    ----------
    channels : names
    device : id in the header
    """
    buffer = bytearray(LITTLE_ENDIAN + bytes(FRAME_AT - len(LITTLE_ENDIAN)))

    def align(size: int) -> None:
        buffer.extend(bytes(_align(len(buffer), size) - len(buffer)))

    def add_count(count: int) -> None:
        align(4)
        buffer.extend(count.to_bytes(4, "little"))

    def add_string(text: str) -> None:
        raw = text.encode() + b"\0"
        add_count(len(raw))
        buffer.extend(raw)

    add_string(device)
    add_count(len(channels))
    for name in channels:
        add_string(name)
    add_count(len(channels))
    if channels:
        align(8)
    values_at = len(buffer)
    buffer.extend(bytes(8 * len(channels)))
    add_count(0)  # velocity
    add_count(0)  # effort
    return buffer, values_at


def _align(at: int, size: int) -> int:
    return _ENCAPSULATION + -(-(at - _ENCAPSULATION) // size) * size
