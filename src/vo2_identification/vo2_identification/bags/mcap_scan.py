"""MCAP files read from front to back, whole or cut short, one chunk in memory at a time.

The index at the end of an MCAP file is not used: a recorder that was killed never wrote it. One way of
reading serves both, so the salvaging path runs on every file. Format: https://mcap.dev/spec .
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.decompression import expand
from vo2_identification.bags.problems import BagError, Problem

__all__ = ["MAGIC", "scan_mcap"]

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_HEAD = struct.Struct("<BQ")
_LENGTH = struct.Struct("<Q")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MOST_BYTES = 1 << 28
"""Of one record, and of one chunk when it is decompressed."""


def scan_mcap(
    path: Path, problems: list[Problem], wanted: Callable[[Channel], bool]
) -> Iterator[tuple[Channel, int, bytes]]:
    """Yield (channel, log time [ns], serialized message) of wanted channels in file order.

    What is wrong is appended to `problems`. A record of more than 256 MB is left out.

    Parameters
    ----------
    path : of the storage file
    problems : list that is appended to

    Raises
    ------
    BagError : not an MCAP file, or not one with ROS 2 messages.
    """
    size = path.stat().st_size
    if size < len(MAGIC):
        problems.append(Problem("truncated", path.name, "the file is empty", index=0))
        return
    # not by a memory map: where the file shrinks meanwhile, that ends the process
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise BagError(f"{path}: found no MCAP magic bytes at its start, need an .mcap file of rosbag2")
        yield from _Scan(path.name, file, size, problems, wanted).messages()


class _Scan:
    """State of one front-to-back pass: the schemas and channels met so far."""

    def __init__(
        self,
        name: str,
        file: BinaryIO,
        size: int,
        problems: list[Problem],
        wanted: Callable[[Channel], bool],
    ) -> None:
        self.name = name
        self.file = file
        self.size = size
        self.problems = problems
        self.wanted = wanted
        self.types: dict[int, str] = {0: ""}
        self.channels: dict[int, Channel | None] = {}  # None for one that nobody wants
        self.count = 0

    def messages(self) -> Iterator[tuple[Channel, int, bytes]]:
        file, end = self.file, self.size
        position, summary, footer = len(MAGIC), False, False
        while position + 9 <= end:
            head = file.read(9)
            if len(head) < 9:  # the file shrinks while it is read
                break
            opcode, length = _HEAD.unpack(head)
            start = position + 9
            stop = start + length
            if opcode == 0 or (stop > end and opcode != _CHUNK):
                break
            if opcode == _FOOTER:
                file.seek(stop)
                position, footer = stop, file.read(len(MAGIC)) == MAGIC
                break
            if opcode == _DATA_END:
                summary = True
            if summary or min(stop, end) - start > _MOST_BYTES:
                if not summary:
                    self._corrupt(
                        f"a record of {length / 1e6:.4g} MB is left out, need at most 268 MB", start
                    )
                file.seek(stop)
            elif opcode == _CHUNK:
                yield from self._chunk(file.read(min(stop, end) - start), start, whole=stop <= end)
            else:
                yield from self._record(opcode, file.read(length))
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

    def _chunk(self, content: bytes, start: int, *, whole: bool) -> Iterator[tuple[Channel, int, bytes]]:
        try:
            _, _, size, checksum = _CHUNK_HEAD.unpack_from(content, 0)
            compression, offset = _text(content, _CHUNK_HEAD.size)
            (length,) = _LENGTH.unpack_from(content, offset)
            records, wrong = expand(content[offset + 8 : offset + 8 + length], compression)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            if whole:
                self._corrupt(f"a chunk cannot be read ({error}), its messages are lost", start)
            return
        if whole and wrong:
            self._corrupt(f"a chunk is damaged, its messages are read up to the damage ({wrong})", start)
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
                channel = Channel(
                    topic,
                    self.types.get(schema, ""),
                    metadata.get("offered_qos_profiles", ""),
                    metadata.get("topic_type_hash", ""),
                )
                self.channels[number] = channel if self.wanted(channel) else None
            elif opcode == _MESSAGE:
                number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(content, 0)
                known = self.channels.get(number)
                if known is not None:
                    self.count += 1
                    yield known, log_time, content[_MESSAGE_HEAD.size :]
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
