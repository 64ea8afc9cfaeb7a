"""The files of a bag, whatever their storage and compression, as one stream of serialized messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from vo2_models.io import InputError, check_regular, one_line, read_yaml

from vo2_identification.bags.channels import Channel
from vo2_identification.bags.decompression import ZSTD_MAGIC, expand, expand_pieces, most_bytes
from vo2_identification.bags.mcap_scan import scan_mcap
from vo2_identification.bags.problems import BagError, Problem, limited
from vo2_identification.bags.sqlite_scan import scan_sqlite

__all__ = ["RawMessage", "is_storage_file", "raw_messages", "storage_files"]

_SCANNERS = {".mcap": scan_mcap, ".db3": scan_sqlite}
_INFORMATION = "rosbag2_bagfile_information"
_PIECE = 1 << 16
_MOST_DAMAGED = 1000


class RawMessage(NamedTuple):
    """One stored message: `channel` (topic, type, QoS), `log_time_ns`, and `data` in CDR."""

    channel: Channel
    log_time_ns: int
    data: bytes


def raw_messages(
    path: str | Path, problems: list[Problem], wanted: Callable[[Channel], bool] = lambda channel: True
) -> Iterator[RawMessage]:
    """Yield the messages of a bag in the order it was written; append what is wrong to `problems`.

    One chunk is in memory at a time (at most 268 MB), whatever the size of the bag.

    Parameters
    ----------
    path : a bag's directory, or one of its files (.mcap, .db3, either with .zstd behind it)
    problems : list that grows while the messages are consumed
    wanted : which channels; the messages of others are skipped unread where the storage allows it

    Raises
    ------
    BagError : nothing there, no storage file in it, a file of another kind, or one that cannot be read.
    """
    damaged: list[Problem] = []
    try:
        for file in storage_files(Path(path), problems):
            with _plain_file(file, problems) as plain:
                count = 0
                for channel, log_time, data in _SCANNERS[plain.suffix](plain, problems, wanted):
                    if data[:4] == ZSTD_MAGIC:  # rosbag2's compression mode "message"
                        data, wrong = expand(data, "zstd")
                        if wrong:
                            if len(damaged) <= _MOST_DAMAGED:
                                text = f"message {count} of the file cannot be decompressed: {wrong}"
                                damaged.append(Problem("malformed", channel.topic, text))
                            continue
                    count += 1
                    yield RawMessage(channel, log_time, data)
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read ({error.strerror or error})") from error
    problems.extend(limited(damaged))


def storage_files(path: Path, problems: list[Problem]) -> list[Path]:
    """Return the storage files of a bag in the order they were written.

    Parameters
    ----------
    path : of the bag
    problems : list that is appended to

    Raises
    ------
    BagError : nothing there, or no storage file in it.
    """
    if "\0" in str(path) or not path.exists():
        raise BagError(f"{path}: found nothing there, need a rosbag2 directory or an .mcap or .db3 file")
    if not path.is_dir():
        check_regular(path)
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
    files = files or present
    if not files:
        raise BagError(f"{path}: found no .mcap or .db3 file in it, need a rosbag2 directory")
    for file in files:
        check_regular(file)
    return files


def _listed(path: Path, problems: list[Problem]) -> list[str]:
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        text = "the bag has no metadata.yaml (the recorder was stopped hard); the files in it are read"
        problems.append(Problem("metadata", path.name, text))
        return []
    try:
        document = read_yaml(metadata)
        return [Path(str(name)).name for name in document[_INFORMATION]["relative_file_paths"]]
    except (InputError, KeyError, TypeError) as error:
        text = f"metadata.yaml cannot be used ({one_line(error, 300)}); the files in the bag are read"
        problems.append(Problem("metadata", path.name, text))
        return []


def _present_as(wanted: Path, present: list[Path]) -> Path | None:
    """Return the file itself, or its compressed or not yet compressed sibling."""
    names = (wanted.name, f"{wanted.name}.zstd", wanted.name.removesuffix(".zstd"))
    return next((one for name in names for one in present if one.name == name), None)


def is_storage_file(path: Path) -> bool:
    """Return whether the name is that of a bag's storage file (.mcap, .db3, either with .zstd behind it).

    Parameters
    ----------
    path : of the file
    """
    return _kind(path) is not None


def _kind(path: Path) -> str | None:
    ending = Path(path.name.removesuffix(".zstd")).suffix
    return ending if ending in _SCANNERS else None


def _split_number(path: Path) -> tuple[object, ...]:
    # bag_2 before bag_10
    return tuple(int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name))


@contextmanager
def _plain_file(file: Path, problems: list[Problem]) -> Iterator[Path]:
    """Give `file`, or for a compressed one a decompressed copy that lives as long as the context."""
    if file.suffix != ".zstd":
        yield file
        return
    with TemporaryDirectory(prefix="vo2_bag_") as folder:
        plain = Path(folder, file.stem)
        with file.open("rb") as packed, plain.open("wb") as unpacked:
            parts = iter(lambda: packed.read(_PIECE), b"")
            try:
                for piece in expand_pieces(parts, "zstd", most_bytes(file.stat().st_size)):
                    unpacked.write(piece)
            except EOFError as error:
                text = f"the compressed file cannot be read to its end: {error}; what is there is read"
                problems.append(Problem("truncated", file.name, text, index=packed.tell()))
        yield plain
