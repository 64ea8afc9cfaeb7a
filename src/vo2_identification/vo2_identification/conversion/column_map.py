"""The YAML map: which file, which rows, which column is which channel."""

from __future__ import annotations

import codecs
import math
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from vo2_models.device.description import PRESETS, DeviceDescription, preset
from vo2_models.io import InputError, read_yaml
from vo2_models.units import CHANNEL_QUANTITIES, SI, Unit, any_unit, fitting_units, unit_named

__all__ = ["ColumnMap", "Guard", "MapError", "Series", "Source", "read_map"]


class MapError(InputError):
    """A map or a table that cannot be used; the message is one line that names the place and the remedy."""


@dataclass(frozen=True)
class Source:
    """One column: its name or number (from 1); SI value = unit of (scale * cell + offset), less another column's share.

    `less` is that column with a factor for its SI values, such as a pressure and the area that it acts on.
    """

    column: str | int
    unit: Unit
    scale: float = 1.0
    offset: float = 0.0
    less: tuple[Source, float] | None = None


@dataclass(frozen=True)
class Guard:
    """Where a channel means something: where another channel lies within bounds, in SI units."""

    channel: str
    at_least: float
    at_most: float


@dataclass(frozen=True)
class Series:
    """One recording in a table: `time` is a column or a sampling rate [Hz]."""

    name: str
    time: Source | float
    channels: Mapping[str, Source]
    guards: Mapping[str, Guard]


@dataclass(frozen=True)
class ColumnMap:
    """A map as read.

    Attributes
    ----------
    path : where it was read from
    description : what the recordings are, for people
    files : pattern of the files it fits, for when a folder is converted
    form : "csv" or "xlsx"
    delimiter : of csv; "whitespace" for any blanks
    encoding : of csv; a byte order mark is skipped
    decimal : "." or ","
    sheet : of xlsx; None for the first
    header_row : row of the column names, from 1; 0 where there is none
    first_row, last_row : rows of the samples, from 1; last_row 0 for the end
    missing : cells that mean "no value", in lower case
    device : id of the device
    described : what the device is, where the map names a preset or a device file; None for a mere name
    series : the recordings in each table
    """

    path: Path
    description: str
    files: str
    form: str
    delimiter: str
    encoding: str
    decimal: str
    sheet: str | None
    header_row: int
    first_row: int
    last_row: int
    missing: frozenset[str]
    device: str
    described: DeviceDescription | None
    series: tuple[Series, ...]


_TABLE_KEYS = {
    "description": str,
    "files": str,
    "format": str,
    "delimiter": str,
    "encoding": str,
    "decimal": str,
    "sheet": str,
    "header_row": int,
    "first_row": int,
    "last_row": int,
    "missing": list,
    "device": str,
    "time": dict,
    "channels": dict,
    "series": dict,
}
_MEANT = 0.75
"""Likeness of a name to a channel of the contract from which that is taken to be meant [1]."""
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
_NOT_OF_TABLES = {"idna", "punycode", "undefined", "unicode_escape", "raw_unicode_escape"}
_NO_DELIMITERS = '"\r\n\0'
_DELIMITERS = {"tab": "\t", "comma": ",", "semicolon": ";"}


def read_map(path: Path) -> ColumnMap:
    """Return the map of a YAML file.

    Parameters
    ----------
    path : of the map

    Raises
    ------
    MapError : not readable, a key that is not known, a value that does not fit, a unit that is not the channel's.
    """
    try:
        document = read_yaml(path)
    except InputError as error:
        raise MapError(f"map {error}") from error
    where = f"map {path}"
    table = _checked(document, _TABLE_KEYS, where)
    form = table.get("format") or ("xlsx" if str(table.get("files", "")).endswith(".xlsx") else "csv")
    _one_of(form, ("csv", "xlsx"), f"{where}: format")
    for key in ("header_row", "first_row", "last_row"):
        if table.get(key, 0) < 0:
            raise MapError(f"{where}: {key}: found {table[key]}, need a row from 1 on")
    header = table.get("header_row", 0)
    decimal = table.get("decimal", ".")
    _one_of(decimal, (".", ","), f"{where}: decimal")
    encoding = table.get("encoding", "utf-8-sig")
    try:
        if codecs.lookup(encoding).name in _NOT_OF_TABLES:
            raise LookupError
        "a".encode(encoding)  # of a codec that makes no text, such as zlib, a LookupError too
    except (LookupError, ValueError):
        raise MapError(
            f"{where}: encoding: found {encoding!r}, which is no text encoding known here"
        ) from None
    delimiter = table.get("delimiter", ",")
    delimiter = _DELIMITERS.get(delimiter, delimiter)
    if delimiter != "whitespace" and (len(delimiter) != 1 or delimiter in _NO_DELIMITERS):
        raise MapError(f"{where}: delimiter: found {delimiter!r}, need one character, tab or whitespace")
    files = table.get("files", "*.xlsx" if form == "xlsx" else "*.csv")
    if not files or "/" in files or "**" in files or files in (".", ".."):
        raise MapError(f"{where}: files: found {files!r}, need a pattern of file names without folders")
    if "series" in table and "channels" in table:
        raise MapError(f"{where}: found series and channels, need one of them")
    device = table.get("device", "")
    described = _device(device, path)
    quantities = dict(CHANNEL_QUANTITIES)
    if described is not None:
        of_unit = {unit: quantity for quantity, unit in SI.items()}
        units = described.units
        quantities |= {name: of_unit[units[role]] for role, name in described.names.items()}
    parts = table.get("series") or {"": {key: table[key] for key in ("time", "channels") if key in table}}
    series = tuple(
        _series(
            str(name),
            part,
            table.get("time"),
            f"{where}: series {name}" if name else where,
            quantities,
            own_names=described is None,
        )
        for name, part in parts.items()
    )
    return ColumnMap(
        path=path,
        description=table.get("description", ""),
        files=files,
        form=form,
        delimiter=delimiter,
        encoding="utf-8-sig" if encoding.lower().replace("_", "-") in {"utf-8", "utf8"} else encoding,
        decimal=decimal,
        sheet=table.get("sheet"),
        header_row=header,
        first_row=table.get("first_row", header + 1),
        last_row=table.get("last_row", 0),
        missing=frozenset(str(text).lower() for text in table.get("missing", _MISSING)),
        device=device if described is None else described.id,
        described=described,
        series=series,
    )


def _device(name: str, path: Path) -> DeviceDescription | None:
    """What a map's device is: a preset, a device file beside the map (or as the path says), or a mere name."""
    if not name.endswith((".yaml", ".yml")):
        return preset(name) if name in PRESETS else None
    try:
        return preset(path.parent / name)
    except ValueError as error:
        raise MapError(f"map {path}: device: {error}") from error


def _series(
    name: str, part: Any, common_time: Any, where: str, quantities: Mapping[str, str], *, own_names: bool
) -> Series:
    # it becomes part of a folder's name
    if any(letter in "/\\" or not letter.isprintable() for letter in name) or len(name) > 100:
        raise MapError(f"{where}: need a name of at most 100 printable characters without slashes")
    part = _checked(part, {"time": dict, "channels": dict}, where)
    if not part.get("channels"):
        raise MapError(f"{where}: found no channels, need at least one of {', '.join(quantities)}")
    channels, guards = {}, {}
    for channel, entry in part["channels"].items():
        place = f"{where}: channel {channel}"
        quantity = quantities.get(channel)
        # a rig without a device file yet has names of its own; one letter off is a mistake all the same
        if quantity is None and own_names and not get_close_matches(str(channel), quantities, cutoff=_MEANT):
            quantity = _quantity_of(entry, place)
        if quantity is None:
            raise MapError(
                f"{place}: not a channel, need one of {', '.join(quantities)}; or name a device file that has it"
            )
        channels[channel] = _source(entry, quantity, place)
        if "valid_where" in entry:
            guards[channel] = _guard(entry["valid_where"], f"{place}: valid_where")
    for channel, guard in guards.items():
        if guard.channel not in channels:
            raise MapError(f"{where}: channel {channel}: valid_where: {guard.channel} is not in this map")
    return Series(name, _time(part.get("time", common_time), where), channels, guards)


def _time(entry: Any, where: str) -> Source | float:
    if not isinstance(entry, dict) or ("rate_hz" in entry) == ("column" in entry):
        raise MapError(f"{where}: time: found {entry!r}, need either a column (with unit) or rate_hz")
    if "column" in entry:
        return _source(entry, "time", f"{where}: time")
    rate = _checked(entry, {"rate_hz": float}, f"{where}: time")["rate_hz"]
    if not 0 < rate < math.inf:
        raise MapError(f"{where}: time: rate_hz: found {rate!r}, need a finite number above 0")
    return float(rate)


def _source(entry: Any, quantity: str, where: str) -> Source:
    keys = {
        "column": (str, int), "unit": (str, int), "scale": float, "offset": float, "valid_where": dict, "less": dict,
    }  # fmt: skip
    entry = _checked(entry, keys, where)
    for key in ("column", "unit"):
        if key not in entry:
            raise MapError(
                f"{where}: found no {key}, need one"
                + (f" of {fitting_units('', quantity)}" if key == "unit" else "")
            )
    name = str(entry["unit"])
    unit = unit_named(name, quantity)
    if unit is None:
        raise MapError(
            f"{where}: unit: found {name!r}, need a unit of {quantity}: {fitting_units(name, quantity)}"
        )
    column = entry["column"]
    if isinstance(column, int) and column < 1:
        raise MapError(f"{where}: column: found {column}, need a number from 1, or a name")
    less = _less(entry["less"], f"{where}: less") if "less" in entry else None
    return Source(column, unit, float(entry.get("scale", 1.0)), float(entry.get("offset", 0.0)), less)


def _less(entry: Any, where: str) -> tuple[Source, float]:
    """What is taken off a channel: a column in any unit, and the channel's SI unit per SI unit of it."""
    entry = _checked(entry, {"column": (str, int), "unit": (str, int), "factor": float}, where)
    factor = entry.pop("factor", math.nan)
    if not math.isfinite(factor):
        raise MapError(
            f"{where}: factor: found {factor}, need a finite number, the channel's SI unit per SI unit of this"
        )
    return _source(entry, _quantity_of(entry, where), where), float(factor)


def _quantity_of(entry: Any, where: str) -> str:
    """Quantity that the unit of an entry measures."""
    name = entry.get("unit") if isinstance(entry, dict) else None
    unit = any_unit(str(name))
    if unit is None:
        raise MapError(
            f"{where}: unit: found {name!r}, which is not known; need one of {fitting_units(str(name or ''))}"
        )
    return unit.quantity


def _guard(entry: Any, where: str) -> Guard:
    entry = _checked(entry, {"channel": str, "at_least": float, "at_most": float}, where)
    if "channel" not in entry or len(entry) < 2:
        raise MapError(f"{where}: found {entry!r}, need a channel and at_least, at_most or both")
    return Guard(entry["channel"], float(entry.get("at_least", "-inf")), float(entry.get("at_most", "inf")))


def _checked(document: Any, keys: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return `document` if it is a mapping of known keys with values of their types."""
    if not isinstance(document, dict):
        raise MapError(f"{where}: found {type(document).__name__}, need keys and values: {', '.join(keys)}")
    result = {}
    for key, value in document.items():
        if key not in keys:
            raise MapError(
                f"{where}: found the key {key!r}, which means nothing here; known are {', '.join(keys)}"
            )
        kinds = keys[key] if isinstance(keys[key], tuple) else (keys[key],)
        if kinds == (float,) and isinstance(value, str):
            value = _number(value)  # YAML 1.1 takes 1e-6, without a point, for a text
        allowed = (*kinds, int) if float in kinds else kinds
        too_large = isinstance(value, int) and abs(value) >= 2**63
        if not isinstance(value, allowed) or isinstance(value, bool) or too_large:
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise MapError(f"{where}: {key}: found {value!r}, need {wanted}")
        result[key] = value
    return result


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _one_of(value: str, allowed: tuple[str, ...], where: str) -> None:
    if value not in allowed:
        raise MapError(f"{where}: found {value!r}, need {' or '.join(allowed)}")
