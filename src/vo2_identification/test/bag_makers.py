"""Bags written by rosbags alone, as an independent witness for the reader."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

JOINT_STATE = "sensor_msgs/msg/JointState"
STORE = get_typestore(Stores.ROS2_JAZZY)
PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}


class Sample(NamedTuple):
    """One message: topic, stamp [ns], channels and their values."""

    topic: str
    stamp_ns: int
    names: Sequence[str]
    values: Sequence[float]
    frame: str = "integrated"


def joint_state(sample: Sample, *, little_endian: bool = True) -> bytes:
    time = STORE.types["builtin_interfaces/msg/Time"]
    header = STORE.types["std_msgs/msg/Header"]
    seconds, nanoseconds = divmod(sample.stamp_ns, 1_000_000_000)
    message = STORE.types[JOINT_STATE](
        header=header(stamp=time(sec=seconds, nanosec=nanoseconds), frame_id=sample.frame),
        name=list(sample.names),
        position=np.array(sample.values, float),
        velocity=np.zeros(len(sample.values)),
        effort=np.empty(0),
    )
    return bytes(STORE.serialize_cdr(message, JOINT_STATE, little_endian=little_endian))


def bag_by_rosbags(
    path: Path,
    samples: Sequence[Sample],
    *,
    storage: str = "mcap",
    compression: str = "NONE",
    little_endian: bool = True,
    chunk: int = 0,
) -> Path:
    """Write `samples` in the given order; `chunk` closes an MCAP chunk every so many messages."""
    writer = Writer(path, version=9, storage_plugin=PLUGINS[storage])
    writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        topics = {
            topic: writer.add_connection(topic, JOINT_STATE, typestore=STORE)
            for topic in dict.fromkeys(sample.topic for sample in samples)
        }
        for k, sample in enumerate(samples):
            data = joint_state(sample, little_endian=little_endian)
            writer.write(topics[sample.topic], sample.stamp_ns, data)
            if chunk and k % chunk == chunk - 1:
                writer.storage.close_chunk()  # type: ignore[union-attr]
    return path


def measurements(n: int, *, topic: str = "/vo2/measurement", period_ns: int = 1_000_000) -> list[Sample]:
    """Return n samples of current and resistance whose values tell their number."""
    names = ("heater_current", "film_resistance")
    return [Sample(topic, k * period_ns, names, (1e-3 * k, 1e5 - k)) for k in range(n)]
