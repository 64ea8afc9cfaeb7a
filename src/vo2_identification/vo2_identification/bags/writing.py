"""Bags that every rosbag2 tool reads: metadata, QoS, message definitions and type hashes included."""

from __future__ import annotations

import math
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import yaml
from rosbags.interfaces import Qos
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, Recording

from vo2_identification.bags.channels import JOINT_STATE, Channel
from vo2_identification.bags.decompression import COMPRESSIONS
from vo2_identification.bags.joint_state import encode, typestore
from vo2_identification.bags.mcap_file import McapFile
from vo2_identification.bags.problems import BagError
from vo2_identification.bags.qos import contract_qos, profiles, profiles_text
from vo2_identification.bags.sqlite_file import SqliteFile

__all__ = ["STORAGES", "BagWriter", "message_definition", "write_bag"]

STORAGES = {"mcap": (McapFile, ".mcap"), "sqlite3": (SqliteFile, ".db3")}
"""Storage identifier of rosbag2 -> class that writes it, file ending."""

_ORDER = ("reference", "measurement", "estimate", "command")
"""Order of messages with equal stamps: a command answers the measurement of its stamp."""


class BagWriter:
    """Writes one bag, which is whole on disk at any time up to its last flush.

    >>> with BagWriter("bag") as bag:  # doctest: +SKIP
    ...     topic = bag.add_topic("/vo2/measurement", "sensor_msgs/msg/JointState")
    ...     bag.write(topic, stamp_ns, serialized)

    Parameters
    ----------
    path : directory to create; must not exist
    storage : "mcap" or "sqlite3"
    flush_period_s : a message written longer ago than this is on disk [s]; checked at `write`
    compression : of the chunks of an mcap file: "none", "zstd" or "lz4"
    split_bytes : size at which another mcap file begins, None for never
    split_s : span of log times at which another mcap file begins [s], None for never

    Raises
    ------
    BagError : unknown storage, one that cannot do what is asked, the path exists, or cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        storage: str = "mcap",
        flush_period_s: float = 0.5,
        compression: str = "none",
        split_bytes: int | None = None,
        split_s: float | None = None,
    ) -> None:
        if storage not in STORAGES:
            raise BagError(f"storage: found {storage!r}, need {' or '.join(STORAGES)}")
        if compression not in COMPRESSIONS:
            raise BagError(f"compression: found {compression!r}, need one of {', '.join(COMPRESSIONS)}")
        if storage != "mcap" and (compression != "none" or split_bytes or split_s):
            raise BagError(f"storage: found {storage}, need mcap for a bag that is compressed or split")
        self.path = Path(path)
        self.flush_period_s = flush_period_s
        self._storage_id = storage
        self._compression = "" if compression == "none" else compression
        self._split_bytes = split_bytes or math.inf
        self._split_ns = math.inf if split_s is None else split_s * 1e9
        self._file_first_ns: int | None = None
        self._finished: list[_File] = []
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f"{path}: exists already, need the name of a new bag") from None
        except OSError as error:
            raise BagError(f"{path}: cannot be created ({error.strerror}), need a writable folder") from error
        self._topics: list[tuple[Channel, Qos]] = []
        self._closed = False
        self._due = time.monotonic() + flush_period_s
        try:
            self._storage = self._new_file()
            self._write_metadata(self._metadata())
        except OSError as error:
            self.discard()
            raise BagError(f"{path}: cannot be written ({error.strerror or error})") from error

    @property
    def count(self) -> int:
        """Number of messages on disk."""
        return sum(self.counts.values())

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages on disk of each topic."""
        return {
            channel.topic: self._storage.counts[number]
            + sum(file.counts.get(number, 0) for file in self._finished)
            for number, (channel, _) in enumerate(self._topics, start=1)
        }

    def add_topic(self, topic: str, msgtype: str, *, qos: Qos | None = None) -> int:
        """Announce a topic and return its number for `write`; the QoS is the contract's unless given.

        Raises
        ------
        ValueError : a message type that the ROS 2 Jazzy interfaces do not have.
        """
        definition, digest = message_definition(msgtype)
        qos = qos or contract_qos(topic)
        channel = Channel(topic, msgtype, profiles_text(qos), digest)
        self._topics.append((channel, qos))
        self._storage.add_channel(len(self._topics), channel, definition)
        return len(self._topics)

    def write(self, number: int, log_time_ns: int, data: bytes) -> None:
        """Append a serialized message of topic `number`.

        Raises
        ------
        OSError : the disk is full or gone; the bag stays readable up to the flush before.
        """
        if self._is_full(log_time_ns):
            self._begin_file()
        if self._file_first_ns is None:
            self._file_first_ns = log_time_ns
        if self._storage.write(number, log_time_ns, data) or time.monotonic() >= self._due:
            self.flush()

    def _is_full(self, log_time_ns: int) -> bool:
        if self._file_first_ns is None:
            return False
        return log_time_ns - self._file_first_ns >= self._split_ns or (
            self._split_bytes < math.inf and self._storage.size >= self._split_bytes
        )

    def _new_file(self) -> Any:
        kind, ending = STORAGES[self._storage_id]
        # rosbag2 numbers the files of a bag
        path = self.path / f"{self.path.resolve().name}_{len(self._finished)}{ending}"
        return kind(path, self._compression) if self._compression else kind(path)

    def _begin_file(self) -> None:
        """Close the present file and go on in another, with the same topics."""
        self.flush()
        done = self._storage
        self._finished.append(_File(done.path.name, dict(done.counts), done.first_ns, done.last_ns))
        done.close()
        self._storage, self._file_first_ns = self._new_file(), None
        for number, (channel, _) in enumerate(self._topics, start=1):
            self._storage.add_channel(number, channel, message_definition(channel.msgtype)[0])

    def flush(self) -> None:
        """Bring everything written so far to disk.

        Raises
        ------
        OSError : the disk is full or gone; the bag stays readable up to the flush before.
        """
        self._due = time.monotonic() + self.flush_period_s
        document = self._metadata()
        self._storage.flush(yaml.safe_dump(document[_INFORMATION], sort_keys=False))
        self._write_metadata(document)

    def flush_if_due(self) -> None:
        """Flush if messages have been waiting for the flush period; for use while no message comes.

        Raises
        ------
        OSError : as `flush`.
        """
        if self._storage.pending and time.monotonic() >= self._due:
            self.flush()

    def close(self) -> None:
        """Flush and close.

        Raises
        ------
        OSError : the last flush failed; the bag is closed and readable up to the flush before.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.flush()
        finally:
            self._storage.close()

    def discard(self) -> None:
        """Remove the folder that this writer has made; for a bag in which nothing arrived."""
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _metadata(self) -> dict[str, Any]:
        counts, first, last = self._storage.pending_totals()
        files = [*self._finished, _File(self._storage.path.name, counts, first, last)]
        filled = [file for file in files if sum(file.counts.values())] or files[:1]
        first, last = min(file.first_ns for file in filled), max(file.last_ns for file in filled)
        topics = [
            {
                "topic_metadata": {
                    "name": channel.topic,
                    "type": channel.msgtype,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": profiles(qos),
                    "type_description_hash": channel.type_hash,
                },
                "message_count": sum(file.counts.get(number, 0) for file in files),
            }
            for number, (channel, qos) in enumerate(self._topics, start=1)
        ]
        return {
            _INFORMATION: {
                "version": 9,
                "storage_identifier": self._storage_id,
                "duration": {"nanoseconds": last - first},
                "starting_time": {"nanoseconds_since_epoch": first},
                "message_count": sum(sum(file.counts.values()) for file in files),
                "topics_with_message_count": topics,
                "compression_format": "",
                "compression_mode": "",
                "relative_file_paths": [file.name for file in files],
                "files": [
                    {
                        "path": file.name,
                        "starting_time": {"nanoseconds_since_epoch": file.first_ns},
                        "duration": {"nanoseconds": file.last_ns - file.first_ns},
                        "message_count": sum(file.counts.values()),
                    }
                    for file in files
                ],
                "custom_data": None,
                "ros_distro": "jazzy",
            }
        }

    def _write_metadata(self, document: dict[str, Any]) -> None:
        # under another name first: there is a whole metadata.yaml at any time
        text = yaml.safe_dump(document, sort_keys=False).encode()
        final, partial = self.path / "metadata.yaml", self.path / "metadata.yaml.partial"
        try:
            partial.write_bytes(text)
            os.replace(partial, final)
        except OSError:
            partial.unlink(missing_ok=True)
            if not final.exists():
                raise
            # a full disk has no room for a second file, but for new numbers in the old one
            with final.open("r+b") as file:
                file.write(text)
                file.truncate()


_INFORMATION = "rosbag2_bagfile_information"


@dataclass(frozen=True)
class _File:
    """One file of a bag: its name, messages of each topic number, earliest and latest log time [ns]."""

    name: str
    counts: Mapping[int, int]
    first_ns: int
    last_ns: int


def write_bag(
    path: str | Path,
    recordings: Recording | Mapping[str, Recording],
    *,
    storage: str = "mcap",
    namespace: str = "/vo2",
) -> Path:
    """Write recordings as a bag and return its path; log times are the stamps. The bag is whole or not there.

    A measurement with `commanded_current` also becomes commands, each stamped with the sample before the
    interval that it governs, unless the recordings bring a command of their own.

    Parameters
    ----------
    path : directory to create
    recordings : role (`measurement`, `command`, `estimate`, `reference`) -> recording, or a measurement alone
    storage : "mcap" or "sqlite3"
    namespace : of the topics

    Raises
    ------
    BagError : unknown storage, the path exists, or cannot be made.
    OSError : the disk is full.
    """
    given = {"measurement": recordings} if isinstance(recordings, Recording) else dict(recordings)
    if unknown := sorted(set(given) - set(_ORDER)):
        raise BagError(f"recordings: found {', '.join(unknown)}, need some of {', '.join(_ORDER)}")
    measurement = given.get("measurement")
    if measurement is not None and COMMANDED_CURRENT in measurement and "command" not in given:
        given["command"] = _commands(measurement)
    roles = [role for role in _ORDER if role in given]
    stamps = [np.rint(given[role].time_s * 1e9).astype(np.int64) for role in roles]
    messages = [_encoded(given[role], stamp) for role, stamp in zip(roles, stamps, strict=True)]
    # flushed by size alone: the same recordings make the same file, byte for byte
    bag = BagWriter(path, storage=storage, flush_period_s=math.inf)
    try:
        _write_all(bag, roles, namespace, stamps, messages)
    except BaseException:  # a full disk, Ctrl-C
        bag.discard()
        raise
    return bag.path


def _write_all(
    bag: BagWriter,
    roles: Sequence[str],
    namespace: str,
    stamps: Sequence[np.ndarray],
    messages: Sequence[list[bytes]],
) -> None:
    with bag:
        topics = [bag.add_topic(f"{namespace.rstrip('/')}/{role}", JOINT_STATE) for role in roles]
        topic = np.repeat(np.arange(len(roles)), [stamp.size for stamp in stamps])
        every = np.concatenate(stamps) if stamps else np.empty(0, np.int64)
        place = np.concatenate([np.arange(stamp.size) for stamp in stamps]) if stamps else every
        order = np.lexsort((topic, every))
        in_order = zip(topic[order].tolist(), every[order].tolist(), place[order].tolist(), strict=True)
        for which, stamp, k in in_order:
            bag.write(topics[which], stamp, messages[which][k])


def _encoded(recording: Recording, stamp_ns: np.ndarray) -> list[bytes]:
    names = [name for name in recording.channels if name != COMMANDED_CURRENT]
    matrix = np.column_stack([recording[name] for name in names]) if names else np.empty((len(recording), 0))
    return encode(stamp_ns, names, matrix, recording.device)


def _commands(measurement: Recording) -> Recording:
    current = measurement[COMMANDED_CURRENT][1:]
    given = np.flatnonzero(~np.isnan(current))
    first = int(given[0]) if given.size else current.size  # NaN up to here: nothing was commanded yet
    return Recording(measurement.time_s[first:-1], {HEATER_CURRENT: current[first:]}, measurement.device)


@lru_cache(maxsize=64)
def message_definition(msgtype: str) -> tuple[str, str]:
    """Return the text of the message definition and its RIHS01 hash.

    Parameters
    ----------
    msgtype : such as sensor_msgs/msg/JointState

    Raises
    ------
    BagError : a type that the common interfaces of ROS 2 Jazzy do not have.
    """
    store = typestore()
    if msgtype not in store.fielddefs:
        raise BagError(
            f"message type {msgtype}: not among the common interfaces of ROS 2 Jazzy, it cannot be recorded"
        )
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return text, store.hash_rihs01(msgtype)
