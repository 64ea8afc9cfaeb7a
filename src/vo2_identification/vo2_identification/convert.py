"""`convert`: a rig's own CSV or XLSX becomes a rosbag2 bag."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from vo2_models.recording import Recording

if TYPE_CHECKING:
    from vo2_identification.conversion.column_map import ColumnMap

from vo2_models.command_line import INTERRUPTED, refuse

__all__ = ["main", "shipped_maps"]

_DESCRIPTION = """
Make rosbag2 bags of a rig's own tables. A YAML map says which column is which channel, in which unit, and how the
samples lie in time; the maps that come with this package are examples to copy. Each recording becomes a bag with
one /vo2/measurement message per row, in ampere, ohm, metre and degree Celsius.
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C.

    Parameters
    ----------
    args : command line, None for that of the process
    """
    options = _parser().parse_args(args)
    if options.list:
        for name, path in shipped_maps().items():
            print(f"{name}: {path}")
        return 0
    if not (options.map and options.input and options.output):
        return refuse("convert", "--map, --input and --output are needed; see --help")
    try:
        return _convert(options)
    except KeyboardInterrupt:
        print("convert: interrupted; the bags named so far are complete", file=sys.stderr)
        return INTERRUPTED


def _convert(options: argparse.Namespace) -> int:
    from vo2_identification.bags import BagError
    from vo2_identification.conversion.column_map import MapError, read_map
    from vo2_identification.conversion.converting import files_of

    try:
        column_map = read_map(_map_path(options.map))
        files = files_of(options.input, column_map)
        several = len(files) * (1 if options.only else len(column_map.series)) > 1
        if options.output.exists() and not several:
            raise BagError(f"{options.output}: exists already, need the name of a new bag")
    except (BagError, MapError) as error:
        return refuse("convert", error)
    refused = 0
    for file in files:
        # one bad file of a folder must not cost the others
        try:
            _convert_file(file, column_map, options, several=several)
        except (BagError, MapError) as error:
            refused += 1
            refuse("convert", error)
        except OSError as error:
            place = error.filename or options.output
            return refuse(
                "convert",
                f"{place}: cannot be written ({error.strerror or error}); free some space or name another",
            )
    if refused and len(files) > 1:
        refuse("convert", f"{refused} of {len(files)} files were not converted")
    return 2 if refused else 0


def _convert_file(file: Path, column_map: ColumnMap, options: argparse.Namespace, *, several: bool) -> None:
    from vo2_models.identification.plausibility import doubts

    from vo2_identification.bags import write_bag
    from vo2_identification.bags.problems import in_few_lines
    from vo2_identification.conversion.converting import convert_file

    for converted in convert_file(file, column_map, only=options.only):
        recording = converted.recording
        path = options.output / converted.name if several else options.output
        try:
            write_bag(path, recording, storage=options.storage, namespace=options.namespace)
        except OSError as error:
            raise OSError(error.errno, error.strerror or str(error), str(path)) from error
        for problem in in_few_lines(converted.problems):
            print(f"convert: {problem}", file=sys.stderr)
        if (device := column_map.described) is not None:
            inside = device.in_roles(recording)
            for doubt in doubts(inside, device.key):
                print(f"convert: {file}: {doubt}", file=sys.stderr)
        print(_line(recording, path, converted.units), flush=True)


def shipped_maps() -> dict[str, Path]:
    """Return the maps that are installed with this package: name -> file."""
    folder = Path(__file__).resolve().parents[1] / "config"  # beside the package in the source tree
    if not folder.is_dir():
        from ament_index_python.packages import get_package_share_directory

        folder = Path(get_package_share_directory("vo2_identification"), "config")
    return {path.stem.removeprefix("convert_"): path for path in sorted(folder.glob("convert_*.yaml"))}


def _map_path(name: str) -> Path:
    if not name.endswith((".yaml", ".yml")) and (shipped := shipped_maps()):
        if name in shipped:
            return shipped[name]
        if not Path(name).exists():
            from vo2_identification.conversion.column_map import MapError

            raise MapError(
                f"map {name}: found no such file, nor a shipped map of this name: {', '.join(shipped)}"
            )
    return Path(name)


def _line(recording: Recording, path: Path, units: Mapping[str, str]) -> str:
    ranges = ", ".join(
        f"{name} {np.nanmin(values):.6g} to {np.nanmax(values):.6g} {units[name]}".removesuffix(" 1")
        if np.isfinite(values).any()
        else f"{name} without any value"
        for name, values in recording.channels.items()
    )
    span = recording.time_s[-1] - recording.time_s[0]
    return f"{len(recording)} samples over {span:.6g} s ({ranges}). The bag: {path}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="convert", description=_DESCRIPTION, allow_abbrev=False)
    parser.add_argument("--map", help="YAML map, or the name of one that is shipped (see --list).")
    parser.add_argument(
        "--input", type=Path, help="The table; or a folder, of which all files that fit are taken."
    )
    parser.add_argument(
        "--output",
        type=Path,
        help="Folder of the new bag. Of several recordings each gets a folder in it, named after file and series.",
    )
    parser.add_argument(
        "--only", metavar="SERIES", help="Take only this series of a table that holds several."
    )
    parser.add_argument("--namespace", default="/vo2", help="Namespace of the topic. Default: /vo2.")
    parser.add_argument(
        "--storage", choices=["mcap", "sqlite3"], default="mcap", help="Storage of the bag. Default: mcap."
    )
    parser.add_argument("--list", action="store_true", help="List the maps that are shipped and stop.")
    return parser


if __name__ == "__main__":
    sys.exit(main())
