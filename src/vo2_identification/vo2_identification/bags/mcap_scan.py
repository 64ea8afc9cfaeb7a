"""MCAP files read from front to back, whole or cut short.

The index at the end of an MCAP file is not used: a recorder that was killed never wrote it. One way of
reading serves both, so the salvaging path runs on every file. Format: https://mcap.dev/spec .
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from zlib import crc32

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.decompression import expand
from vo2_identification.bags.problems import BagError, Problem

__all__ = ["MAGIC", "scan_mcap"]

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_LENGTH = struct.Struct("<Q")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")


def scan_mcap(path: Path, problems: list[Problem]) -> Iterator[tuple[Channel, int, bytes]]:
    """Yield (channel, log time [ns], serialized message) in file order; append what is wrong to `problems`.

    Raises
    ------
    BagError : not an MCAP file, or not one with ROS 2 messages.
    """
    if path.stat().st_size < len(MAGIC):
        problems.append(Problem("truncated", path.name, "the file is empty", index=0))
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[: len(MAGIC)] != MAGIC:
            raise BagError(f"{path}: found no MCAP magic bytes at its start, need an .mcap file of rosbag2")
        yield from _Scan(path.name, data, problems).messages()


class _Scan:
    """State of one front-to-back pass: the schemas and channels met so far."""

    def __init__(self, name: str, data: mmap.mmap, problems: list[Problem]) -> None:
        self.name = name
        self.data = data
        self.problems = problems
        self.types: dict[int, str] = {0: ""}
        self.channels: dict[int, Channel] = {}
        self.count = 0

    def messages(self) -> Iterator[tuple[Channel, int, bytes]]:
        data, end = self.data, len(self.data)
        position, summary, footer = len(MAGIC), False, False
        while position + 9 <= end:
            opcode = data[position]
            start = position + 9
            stop = start + _LENGTH.unpack_from(data, position + 1)[0]
            if opcode == 0 or (stop > end and opcode != _CHUNK):
                break
            if opcode == _FOOTER:
                position, footer = stop, data[stop : stop + len(MAGIC)] == MAGIC
                break
            if opcode == _DATA_END:
                summary = True
            if not summary:
                if opcode == _CHUNK:
                    yield from self._chunk(start, min(stop, end), whole=stop <= end)
                else:
                    yield from self._record(opcode, data[start:stop])
            if stop > end:
                break
            position = stop
        if not footer:
            lost = end - position
            tail = f" and {lost} bytes of an incomplete record" if lost else ""
            what = "its index is missing" if summary else "the recorder was stopped hard"
            self.problems.append(
                Problem(
                    "truncated",
                    self.name,
                    f"the file ends without a footer{tail} ({what}); {self.count} messages were read",
                    index=position,
                )
            )

    def _chunk(self, start: int, stop: int, *, whole: bool) -> Iterator[tuple[Channel, int, bytes]]:
        head = self.data[start : min(start + 64, stop)]
        try:
            _, _, size, checksum = _CHUNK_HEAD.unpack_from(head, 0)
            compression, offset = _text(head, _CHUNK_HEAD.size)
            body = self.data[start + offset + 8 : stop]
            (length,) = _LENGTH.unpack_from(head, offset)
            records, complete = expand(body[:length], compression)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            if whole:
                self._corrupt(f"a chunk cannot be read ({error}), its messages are lost", start)
            return
        if whole and not complete:
            self._corrupt("a chunk is damaged, its messages are read up to the damage", start)
        elif whole and len(records) != size:
            self._corrupt(f"a chunk has {len(records)} bytes instead of {size}", start)
        elif whole and checksum and crc32(records) != checksum:
            self._corrupt("a chunk does not match its checksum and was left out", start)
            return
        position, end = 0, len(records)
        # the hot loop of reading: messages are taken apart here, everything else in _record
        while position + 9 <= end:
            opcode = records[position]
            begin = position + 9
            position = begin + _LENGTH.unpack_from(records, begin - 8)[0]
            if position > end or opcode == 0:
                break
            if opcode == _MESSAGE and position - begin >= _MESSAGE_HEAD.size:
                number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(records, begin)
                channel = self.channels.get(number)
                if channel is not None:
                    self.count += 1
                    yield channel, log_time, records[begin + _MESSAGE_HEAD.size : position]
            else:
                yield from self._record(opcode, records[begin:position])

    def _record(self, opcode: int, content: bytes) -> Iterator[tuple[Channel, int, bytes]]:
        try:
            if opcode == _SCHEMA:
                (number,) = struct.unpack_from("<H", content, 0)
                self.types[number] = _text(content, 2)[0]
            elif opcode == _CHANNEL:
                number, schema = struct.unpack_from("<HH", content, 0)
                topic, offset = _text(content, 4)
                _, offset = _text(content, offset)
                metadata = _text_map(content, offset)
                self.channels[number] = Channel(
                    topic,
                    self.types.get(schema, ""),
                    metadata.get("offered_qos_profiles", ""),
                    metadata.get("topic_type_hash", ""),
                )
            elif opcode == _MESSAGE:
                number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(content, 0)
                channel = self.channels.get(number)
                if channel is not None:
                    self.count += 1
                    yield channel, log_time, content[_MESSAGE_HEAD.size :]
        except (struct.error, UnicodeDecodeError) as error:
            self._corrupt(f"a record of type {opcode} cannot be read ({error})", None)

    def _corrupt(self, text: str, place: int | None) -> None:
        self.problems.append(Problem("corrupt", self.name, text, index=place))


def _text(content: bytes, offset: int) -> tuple[str, int]:
    """Return the length-prefixed string at `offset` and the offset after it."""
    (length,) = struct.unpack_from("<I", content, offset)
    stop = offset + 4 + length
    if stop > len(content):
        raise struct.error(f"a text of {length} bytes ends outside its record")
    return content[offset + 4 : stop].decode(), stop


def _text_map(content: bytes, offset: int) -> dict[str, str]:
    (length,) = struct.unpack_from("<I", content, offset)
    position, stop = offset + 4, offset + 4 + length
    result = {}
    while position < stop:
        key, position = _text(content, position)
        result[key], position = _text(content, position)
    return result
