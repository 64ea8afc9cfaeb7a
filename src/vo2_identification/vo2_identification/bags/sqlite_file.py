"""An sqlite3 bag file whose transactions are closed at every flush."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from vo2_identification.bags.channels import Channel

__all__ = ["SqliteFile"]

_VERSION = 9


class SqliteFile:
    """Storage of one bag file, with the same interface as `McapFile`; rosbags writes the tables."""

    def __init__(self, path: Path) -> None:
        self.counts: dict[int, int] = {}
        self.first_ns = 0
        self.last_ns = 0
        try:
            # rosbags takes the bag's directory and names the file after it
            self._storage = Sqlite3Writer(path.parent, CompressionMode.NONE)
            # a killed process loses nothing by it, and waiting for the disk twice a second would stall a recorder
            self._storage.conn.execute("PRAGMA synchronous=OFF")
        except sqlite3.Error as error:
            raise OSError(str(error)) from error
        self.path = self._storage.path
        self._connections: dict[int, Connection] = {}
        self._types: set[str] = set()
        self._pending: dict[int, int] = {}
        self._totals = (0, 0)
        self._since = 0

    def add_channel(self, number: int, channel: Channel, definition: str) -> None:
        """Announce topic `number` (from 1) with the text of its message definition (.msg)."""
        connection = Connection(
            id=number,
            topic=channel.topic,
            msgtype=channel.msgtype,
            msgdef=MessageDefinition(MessageDefinitionFormat.MSG, definition),
            digest=channel.type_hash,
            msgcount=0,
            ext=ConnectionExtRosbag2("cdr", []),
            owner=self,
        )
        if channel.msgtype not in self._types:
            self._types.add(channel.msgtype)
            self._storage.add_msgtype(connection)
        self._storage.add_connection(connection, channel.qos)
        self._connections[number] = connection
        self.counts[number] = 0
        self._pending[number] = 0

    def write(self, number: int, log_time_ns: int, data: bytes) -> bool:
        """Add a message to the open transaction; return whether it should be closed."""
        try:
            self._storage.write(self._connections[number], log_time_ns, data)
        except sqlite3.Error as error:
            self._give_up()
            raise OSError(str(error)) from error
        first, last = self._totals if self._since or any(self.counts.values()) else (log_time_ns, log_time_ns)
        self._totals = (min(first, log_time_ns), max(last, log_time_ns))
        self._pending[number] += 1
        self._since += 1
        return self._since >= 10_000

    @property
    def pending(self) -> int:
        """Number of messages in the open transaction."""
        return self._since

    def pending_totals(self) -> tuple[dict[int, int], int, int]:
        """Return what `counts`, `first_ns` and `last_ns` will be once the pending messages are on disk."""
        counts = {number: count + self._pending[number] for number, count in self.counts.items()}
        return counts, *self._totals

    def flush(self, metadata: str) -> None:
        """Close the transaction; `metadata` is the bag's, as YAML text.

        Raises
        ------
        OSError : the disk is full or gone. The file stays whole as of the last flush, the pending messages
            are given up.
        """
        try:
            self._storage.cursor.execute("DELETE FROM metadata")
            self._storage.cursor.execute(
                "INSERT INTO metadata(metadata_version, metadata) VALUES(?, ?)", (_VERSION, metadata)
            )
            self._storage.conn.commit()
        except sqlite3.Error as error:
            self._give_up()
            raise OSError(str(error)) from error
        self.counts, self.first_ns, self.last_ns = self.pending_totals()
        self._pending = dict.fromkeys(self._pending, 0)
        self._since = 0

    def close(self) -> None:
        """Close the file; pending messages are given up."""
        self._storage.conn.rollback()
        self._storage.conn.close()

    def _give_up(self) -> None:
        # a full disk may have rolled the transaction back already: then this does nothing
        self._storage.conn.rollback()
        self._pending = dict.fromkeys(self._pending, 0)
        self._since = 0
        self._totals = (self.first_ns, self.last_ns)
