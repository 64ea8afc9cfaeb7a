"""The files of a bag, whatever their storage and compression, as one stream of serialized messages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import yaml

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.decompression import ZSTD_MAGIC, expand, zstd
from vo2_identification.bags.mcap_scan import scan_mcap
from vo2_identification.bags.problems import BagError, Problem, limited
from vo2_identification.bags.sqlite_scan import scan_sqlite

__all__ = ["RawMessage", "raw_messages", "storage_files"]

_SCANNERS = {".mcap": scan_mcap, ".db3": scan_sqlite}
_INFORMATION = "rosbag2_bagfile_information"


class RawMessage(NamedTuple):
    """One stored message: `channel` (topic, type, QoS), `log_time_ns`, and `data` in CDR."""

    channel: Channel
    log_time_ns: int
    data: bytes


def raw_messages(path: str | Path, problems: list[Problem]) -> Iterator[RawMessage]:
    """Yield every message of a bag in the order it was written; append what is wrong to `problems`.

    Parameters
    ----------
    path : a bag's directory, or one of its files (.mcap, .db3, either with .zstd behind it)
    problems : list that grows while the messages are consumed

    Raises
    ------
    BagError : nothing there, no storage file in it, or a file of another kind.
    """
    damaged: list[Problem] = []
    for file in storage_files(Path(path), problems):
        with _plain_file(file, problems) as plain:
            count = 0
            for channel, log_time, data in _SCANNERS[plain.suffix](plain, problems):
                if data[:4] == ZSTD_MAGIC:  # rosbag2's compression mode "message"
                    data, whole = expand(data, "zstd")
                    if not whole:
                        text = f"message {count} of the file cannot be decompressed"
                        damaged.append(Problem("malformed", channel.topic, text))
                        continue
                count += 1
                yield RawMessage(channel, log_time, data)
    problems.extend(limited(damaged))


def storage_files(path: Path, problems: list[Problem]) -> list[Path]:
    """Return the storage files of a bag in the order they were written.

    Raises
    ------
    BagError : nothing there, or no storage file in it.
    """
    if not path.exists():
        raise BagError(f"{path}: found nothing there, need a rosbag2 directory or an .mcap or .db3 file")
    if path.is_file():
        if _kind(path) is None:
            raise BagError(f"{path}: found a file of another kind, need .mcap or .db3 (or a bag's directory)")
        return [path]
    present = sorted((one for one in path.iterdir() if _kind(one)), key=_split_number)
    files = []
    for name in _listed(path, problems):
        if (found := _present_as(path / name, present)) is None:
            problems.append(
                Problem("missing_file", name, "metadata.yaml lists this file, but it is not there")
            )
        else:
            files.append(found)
    if not files:
        files = present
    if not files:
        raise BagError(f"{path}: found no .mcap or .db3 file in it, need a rosbag2 directory")
    return files


def _listed(path: Path, problems: list[Problem]) -> list[str]:
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        text = "the bag has no metadata.yaml (the recorder was stopped hard); the files in it are read"
        problems.append(Problem("metadata", path.name, text))
        return []
    try:
        document: Any = yaml.safe_load(metadata.read_text(encoding="utf-8"))
        return [Path(str(name)).name for name in document[_INFORMATION]["relative_file_paths"]]
    except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        text = f"metadata.yaml cannot be used ({reason}); the files in the bag are read"
        problems.append(Problem("metadata", path.name, text))
        return []


def _present_as(wanted: Path, present: list[Path]) -> Path | None:
    """Return the file itself, or its compressed or not yet compressed sibling."""
    names = (wanted.name, f"{wanted.name}.zstd", wanted.name.removesuffix(".zstd"))
    return next((one for name in names for one in present if one.name == name), None)


def _kind(path: Path) -> str | None:
    ending = Path(path.name.removesuffix(".zstd")).suffix
    return ending if ending in _SCANNERS else None


def _split_number(path: Path) -> tuple[object, ...]:
    # bag_2 before bag_10
    return tuple(int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name))


@contextmanager
def _plain_file(file: Path, problems: list[Problem]) -> Iterator[Path]:
    """Give `file`, or for a compressed one a decompressed copy that lives as long as the context."""
    if file.suffix != ".zstd":
        yield file
        return
    with TemporaryDirectory(prefix="vo2_bag_") as folder:
        plain = Path(folder, file.stem)
        decoder = zstd.ZstdDecompressor()
        position = 0
        with file.open("rb") as packed, plain.open("wb") as unpacked:
            while not decoder.eof and (piece := packed.read(1 << 20)):
                try:
                    unpacked.write(decoder.decompress(piece))
                except zstd.ZstdError as error:
                    problems.append(
                        Problem("corrupt", file.name, f"cannot be decompressed ({error})", index=position)
                    )
                    break
                position += len(piece)
            else:
                if not decoder.eof:
                    text = "the compressed file is cut short; what is there is read"
                    problems.append(Problem("truncated", file.name, text, index=position))
        yield plain
