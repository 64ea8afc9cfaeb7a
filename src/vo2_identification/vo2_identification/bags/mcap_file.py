"""An MCAP file that is whole after every flush.

The index that every reader wants stands at the end of an MCAP file. Here each flush writes the new chunk over
the old index and the new index behind it, in one write: killed at any time, the file is complete up to its
last flush for every tool. When the disk is full the old index goes back to its place, which needs no new space.
Format: https://mcap.dev/spec ; profile and metadata keys as rosbag2_storage_mcap writes them.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from pathlib import Path
from zlib import crc32

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.decompression import compress
from vo2_identification.bags.mcap_scan import MAGIC

__all__ = ["McapFile"]

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_CONTENT = 22
_INDEX_ENTRY = 16
_FULL_CHUNK = 1 << 20


class McapFile:
    """Storage of one bag file.

    Parameters
    ----------
    path : of the new file
    compression : of every chunk: "", "zstd" or "lz4"

    Attributes
    ----------
    path : the file
    counts : channel id -> messages that are on disk
    first_ns, last_ns : log times [ns] of the earliest and latest message on disk, 0 where there is none
    """

    def __init__(self, path: Path, compression: str = "") -> None:
        self.path = path
        self._compression = compression
        self.counts: dict[int, int] = {}
        self.first_ns = 0
        self.last_ns = 0
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        self._schema_ids: dict[str, int] = {}
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._chunk = bytearray()
        self._index: dict[int, list[int]] = {}
        self._index_size = 0
        self._sequence: dict[int, int] = {}
        self._end = 0
        self._tail = b""
        head = MAGIC + _record(0x01, _text("ros2") + _text("vo2_identification"))
        self._replace_tail(head, _tail_records(len(head), "", [], [], [], (0, 0, 0, {})))

    def add_channel(self, number: int, channel: Channel, definition: str) -> None:
        """Announce topic `number` (from 1) with the text of its message definition (.msg)."""
        if channel.msgtype not in self._schema_ids:
            self._schema_ids[channel.msgtype] = len(self._schema_ids) + 1
            schema = struct.pack("<H", self._schema_ids[channel.msgtype])
            schema += _text(channel.msgtype) + _text("ros2msg") + _text(definition)
            self._schemas.append(_record(0x03, schema))
            self._chunk += self._schemas[-1]
        content = struct.pack("<HH", number, self._schema_ids[channel.msgtype])
        content += _text(channel.topic) + _text("cdr")
        content += _text_map({"offered_qos_profiles": channel.qos, "topic_type_hash": channel.type_hash})
        self._channels.append(_record(0x04, content))
        self._chunk += self._channels[-1]
        self.counts[number] = 0
        self._sequence[number] = 0

    def write(self, number: int, log_time_ns: int, data: bytes) -> bool:
        """Add a message to the chunk in memory; return whether the chunk should be flushed."""
        chunk = self._chunk
        places = self._index.get(number)
        if places is None:
            places = self._index[number] = []
        places += (log_time_ns, len(chunk))
        self._index_size += _INDEX_ENTRY
        sequence = self._sequence[number] = self._sequence[number] + 1
        chunk += _MESSAGE.pack(
            0x05, _MESSAGE_CONTENT + len(data), number, sequence & 0xFFFFFFFF, log_time_ns, log_time_ns
        )
        chunk += data
        return len(chunk) > _FULL_CHUNK

    @property
    def size(self) -> int:
        """Bytes of the file, with what waits to be written as it is."""
        return self._end + len(self._tail) + len(self._chunk) + self._index_size

    @property
    def pending(self) -> int:
        """Number of messages in memory that no flush has written yet."""
        return sum(len(places) // 2 for places in self._index.values())

    def pending_totals(self) -> tuple[dict[int, int], int, int]:
        """Return what `counts`, `first_ns` and `last_ns` will be once the pending messages are on disk."""
        counts = dict(self.counts)
        times: list[int] = []
        for number, places in self._index.items():
            counts[number] += len(places) // 2
            times += (min(places[::2]), max(places[::2]))
        if sum(self.counts.values()):
            times += (self.first_ns, self.last_ns)
        return counts, min(times, default=0), max(times, default=0)

    def flush(self, metadata: str) -> None:
        """Write the chunk and the index behind it; `metadata` is the bag's, as YAML text.

        Raises
        ------
        OSError : the disk is full or gone. The file stays whole as of the last flush, the pending messages
            are given up.
        """
        counts, first, last = self.pending_totals()
        chunk, index = bytes(self._chunk), self._index
        self._chunk, self._index, self._index_size = bytearray(), {}, 0
        body, chunk_indexes = b"", self._chunk_indexes
        if chunk:
            times = [time for places in index.values() for time in places[::2]]
            span = (min(times, default=0), max(times, default=0))
            head = struct.pack("<QQQI", *span, len(chunk), crc32(chunk)) + _text(self._compression)
            packed = compress(chunk, self._compression)
            body = _record(0x06, head + struct.pack("<Q", len(packed)) + packed)
            chunk_length, offsets = len(body), []
            for number, places in index.items():
                offsets.append((number, self._end + len(body)))
                listed = struct.pack(f"<{len(places)}Q", *places)
                body += _record(0x07, struct.pack("<HI", number, len(listed)) + listed)
            entry = struct.pack("<QQQQ", *span, self._end, chunk_length)
            entry += struct.pack("<I", 10 * len(offsets))
            entry += b"".join(struct.pack("<HQ", *offset) for offset in offsets)
            entry += struct.pack("<Q", len(body) - chunk_length) + _text(self._compression)
            entry += struct.pack("<QQ", len(packed), len(chunk))
            chunk_indexes = [*chunk_indexes, _record(0x08, entry)]
        tail = _tail_records(
            self._end + len(body),
            metadata,
            self._schemas,
            self._channels,
            chunk_indexes,
            (len(chunk_indexes), first, last, counts),
        )
        self._replace_tail(body, tail)
        self._chunk_indexes = chunk_indexes
        self.counts, self.first_ns, self.last_ns = counts, first, last

    def close(self) -> None:
        """Close the file, which is whole since its last flush; pending messages are given up."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _replace_tail(self, body: bytes, tail: bytes) -> None:
        try:
            _write_all(self._file, body + tail, self._end)
        except OSError:
            _write_all(self._file, self._tail, self._end)
            os.ftruncate(self._file, self._end + len(self._tail))
            raise
        self._end += len(body)
        self._tail = tail


def _write_all(file: int, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:
        written = os.pwrite(file, view, offset)
        view, offset = view[written:], offset + written


def _tail_records(
    start: int,
    metadata: str,
    schemas: list[bytes],
    channels: list[bytes],
    chunk_indexes: list[bytes],
    statistics: tuple[int, int, int, Mapping[int, int]],
) -> bytes:
    """Return everything from the bag's metadata to the closing magic, for a tail that begins at `start`."""
    chunks, first, last, counts = statistics
    described = _record(0x0C, _text("rosbag2") + _text_map({"serialized_metadata": metadata}))
    data_end = _record(0x0F, struct.pack("<I", 0))
    summary_start = start + len(described) + len(data_end)
    per_channel = b"".join(struct.pack("<HQ", *item) for item in sorted(counts.items()))
    total = sum(counts.values())
    numbers = struct.pack(
        "<QHIIIIQQI", total, len(schemas), len(channels), 0, 1, chunks, first, last, len(per_channel)
    )
    groups = [
        (0x03, b"".join(schemas)),
        (0x04, b"".join(channels)),
        (0x08, b"".join(chunk_indexes)),
        (0x0D, _record(0x0D, struct.pack("<QQ", start, len(described)) + _text("rosbag2"))),
        (0x0B, _record(0x0B, numbers + per_channel)),
    ]
    summary, offsets = b"", b""
    for opcode, records in groups:
        if records:
            place = summary_start + len(summary)
            offsets += _record(0x0E, struct.pack("<BQQ", opcode, place, len(records)))
            summary += records
    footer = _record(0x02, struct.pack("<QQI", summary_start, summary_start + len(summary), 0))
    return described + data_end + summary + offsets + footer + MAGIC


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _text_map(entries: Mapping[str, str]) -> bytes:
    content = b"".join(_text(key) + _text(value) for key, value in entries.items())
    return struct.pack("<I", len(content)) + content
