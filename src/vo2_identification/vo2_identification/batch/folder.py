"""The bags of a folder, and what each says of the device that it was recorded on."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vo2_models.io import InputError, one_line, read_yaml

from vo2_identification.bags.storage import is_storage_file

__all__ = ["BagNote", "bag_note", "bag_signature", "find_bags"]

_METADATA = "metadata.yaml"
_MOST_BAGS = 1_000_000


class BagNote(NamedTuple):
    """What `custom_data` of a bag's metadata.yaml says, as `ros2 bag record --custom-data` writes it.

    Attributes
    ----------
    device_id : which specimen it is; empty where nobody says
    position_x_m, position_y_m : where it sits on its wafer [m]; NaN where nobody says
    """

    device_id: str = ""
    position_x_m: float = math.nan
    position_y_m: float = math.nan


def find_bags(folder: Path) -> dict[str, Path]:
    """Return name -> path of all bags below a folder, sorted; links are not followed.

    A folder with a metadata.yaml is one bag; without one, each storage file in it is.

    Parameters
    ----------
    folder : to look into

    Raises
    ------
    InputError : no folder, or no bag in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: found no such folder, need one with bags in it")
    found = {str(path.relative_to(folder)): path for path in sorted(_bags_below(folder))[:_MOST_BAGS]}
    if "." in found:
        raise InputError(f"{folder}: is itself a bag, need a folder with bags in it (or --bag)")
    if not found:
        raise InputError(f"{folder}: found no bag in it, need rosbag2 folders or .mcap or .db3 files")
    return found


def _bags_below(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        inside = sorted(entries, key=lambda entry: entry.name)
    files = [Path(entry.path) for entry in inside if entry.is_file()]
    if any(file.name == _METADATA for file in files):
        yield folder
        return
    yield from filter(is_storage_file, files)
    for entry in inside:
        if entry.is_dir(follow_symlinks=False):
            yield from _bags_below(Path(entry.path))


def bag_signature(bag: Path) -> list[list[object]]:
    """Return names, sizes and times of a bag's files: another list means that the bag has changed.

    Parameters
    ----------
    bag : folder or file
    """
    files = sorted(bag.iterdir()) if bag.is_dir() else [bag]
    about = [(file.name, file.stat()) for file in files]
    return [[name, status.st_size, status.st_mtime_ns] for name, status in about]


def bag_note(bag: Path) -> tuple[BagNote, list[str]]:
    """Return what a bag says of its device, and what of it cannot be used.

    Parameters
    ----------
    bag : folder or file; a file alone says nothing
    """
    file = bag / _METADATA
    if not file.is_file():
        return BagNote(), []
    try:
        document = read_yaml(file)
        given = document["rosbag2_bagfile_information"].get("custom_data") or {}
        items = dict(given)
    except (InputError, KeyError, TypeError, AttributeError, ValueError):
        return BagNote(), []  # the reader of the bag tells what is wrong with it
    problems, place = [], {}
    for name in ("position_x_m", "position_y_m"):
        if name not in items:
            continue
        try:
            place[name] = float(items[name])
        except (TypeError, ValueError):
            problems.append(one_line(f"custom_data {name}: found {items[name]!r}, need a number in metres"))
    return BagNote(one_line(items.get("device_id") or "", 100), **place), problems
