"""sqlite3 bags (.db3) read in the order they were written, whole or damaged."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.problems import BagError, Problem

__all__ = ["scan_sqlite"]

_MOST_BYTES = 1 << 28


def scan_sqlite(
    path: Path, problems: list[Problem], wanted: Callable[[Channel], bool]
) -> Iterator[tuple[Channel, int, bytes]]:
    """Yield (channel, log time [ns], serialized message) of wanted channels in writing order.

    What is wrong is appended to `problems`. A message of more than 256 MB is not read, nor what comes after it.

    Parameters
    ----------
    path : of the storage file
    problems : list that is appended to

    Raises
    ------
    BagError : not an sqlite3 file, or one without the tables of rosbag2.
    """
    if path.stat().st_size == 0:
        problems.append(Problem("truncated", path.name, "the file is empty", index=0))
        return
    with path.open("rb") as file:
        header = file.read(100)
    if header[:16] != b"SQLite format 3\0":
        raise BagError(f"{path}: found no sqlite3 header at its start, need a .db3 file of rosbag2")
    torn = path.stat().st_size % _page_size(header)
    siblings = [path.with_name(path.name + ending) for ending in ("-wal", "-journal")]
    pending = [one for one in siblings if one.exists() and one.stat().st_size > 0]
    if not pending and not torn:
        yield from _rows(f"file:{quote(str(path))}?mode=ro&immutable=1", path.name, problems, wanted)
        return
    if pending:
        text = f"the recorder was stopped hard and left {pending[0].name}"
        problems.append(Problem("truncated", path.name, text))
    # sqlite3 completes or rolls back the last transaction by writing: on a copy, not on the bag
    with TemporaryDirectory(prefix="vo2_bag_") as folder:
        copy = Path(folder, path.name)
        for one in (path, *pending):
            shutil.copyfile(one, copy.with_name(one.name))
        if torn:
            # sqlite3 would fill up the page that was cut through with zeros, and rows with them
            os.truncate(copy, path.stat().st_size - torn)
        yield from _rows(f"file:{quote(str(copy))}", path.name, problems, wanted)


def _page_size(header: bytes) -> int:
    size = int.from_bytes(header[16:18], "big")
    return 65536 if size == 1 else max(size, 1)


def _rows(
    address: str, name: str, problems: list[Problem], wanted: Callable[[Channel], bool]
) -> Iterator[tuple[Channel, int, bytes]]:
    count = odd = 0
    with closing(sqlite3.connect(address, uri=True)) as database:
        try:
            # without this sqlite3 reads nothing at all from a file shorter than its header says
            database.execute("PRAGMA writable_schema=ON")
            database.execute("PRAGMA trusted_schema=OFF")
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_BYTES)
            columns = _columns(database, "topics", name)
            if not {"id", "name", "type"} <= columns:
                raise BagError(f"{name}: found no table of topics, need a .db3 file of rosbag2")
            if not {"topic_id", "timestamp", "data"} <= _columns(database, "messages", name):
                raise BagError(f"{name}: found no table of messages, need a .db3 file of rosbag2")
            qos, digest = (
                column if column in columns else "''"
                for column in ("offered_qos_profiles", "type_description_hash")
            )
            channels = {}
            for number, *texts in database.execute(f"SELECT id, name, type, {qos}, {digest} FROM topics"):
                channel = Channel(*("" if text is None else str(text) for text in texts))
                if isinstance(number, int) and wanted(channel):
                    channels[number] = channel
            # the data of other topics is not even read from disk
            listed = ", ".join(map(str, channels))
            rows = database.execute(
                "SELECT topic_id, timestamp, data FROM messages NOT INDEXED "
                f"WHERE topic_id IN ({listed}) ORDER BY id"
            )
            for topic, log_time, data in rows:
                if not (isinstance(log_time, int) and isinstance(data, bytes)):
                    odd += 1
                    continue
                count += 1
                yield channels[topic], log_time, data
            if odd:
                text = f"{odd} rows are no messages with a time and are left out"
                problems.append(Problem("corrupt", name, text))
        except sqlite3.Error as error:
            problems.append(
                Problem("truncated", name, f"the database is damaged ({error}); {count} messages were read")
            )


def _columns(database: sqlite3.Connection, table: str, name: str) -> set[str]:
    """Return the stored columns of a table; a view or computed column in its place could run for ever."""
    kinds = database.execute("SELECT type, sql FROM sqlite_master WHERE name = ?", (table,)).fetchall()
    if any(kind != "table" or "VIRTUAL" in str(sql).upper()[:30] for kind, sql in kinds):
        raise BagError(f"{name}: {table} is no plain table, need a .db3 file of rosbag2")
    return {row[1] for row in database.execute(f"PRAGMA table_xinfo({table})") if row[6] == 0}
