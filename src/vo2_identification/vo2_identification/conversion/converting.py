"""From table and map to recordings."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import Recording
from vo2_models.units import SI

from vo2_identification.bags.joint_state import Samples
from vo2_identification.bags.problems import Problem, limited
from vo2_identification.bags.stamps import find_gaps, increasing_samples
from vo2_identification.conversion.column_map import ColumnMap, MapError, Series, Source
from vo2_identification.conversion.tables import Table, read_table

__all__ = ["Converted", "convert_file", "files_of"]

_FEWEST_KEPT = 0.1
_LATEST_S = 2.0**31
"""a stamp holds its seconds in 32 bits"""
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Converted:
    """One recording.

    Attributes
    ----------
    name : of the file and, where a table holds several, the series
    units : channel -> SI unit, degC for temperatures
    """

    name: str
    recording: Recording
    units: Mapping[str, str]
    problems: list[Problem]


def files_of(source: Path, column_map: ColumnMap) -> list[Path]:
    """Return the file, or the files of a folder that the map's pattern fits.

    Parameters
    ----------
    source : file or folder
    column_map : its pattern

    Raises
    ------
    MapError : nothing there.
    """
    if source.is_dir():
        found = sorted(each for each in source.glob(column_map.files) if each.is_file())
        if not found:
            raise MapError(f"{source}: found no file {column_map.files} in it, need one; or name a file")
        return found
    if not source.exists():
        raise MapError(f"{source}: found nothing there, need a file or a folder")
    return [source]


def convert_file(path: Path, column_map: ColumnMap, *, only: str | None = None) -> list[Converted]:
    """Return the recordings of one file.

    A cell without a value becomes NaN and is reported; so is a row without a time, which is left out.

    Parameters
    ----------
    only : name of the one series wanted
    path : of the table
    column_map : which column is which channel

    Raises
    ------
    MapError : a cell that is no number, a column or sheet or series that is not there.
    """
    series = [one for one in column_map.series if only is None or one.name == only]
    if not series:
        names = ", ".join(one.name for one in column_map.series if one.name) or "none"
        raise MapError(f"map {column_map.path}: found no series {only!r}, the map has {names}")
    table = read_table(path, column_map)
    return [
        _convert(table, one, column_map, f"{path.stem}_{one.name}" if one.name else path.stem)
        for one in series
    ]


def _convert(table: Table, series: Series, column_map: ColumnMap, name: str) -> Converted:
    problems: list[Problem] = []
    read = {channel: _values(table, source, column_map) for channel, source in series.channels.items()}
    columns = {channel: np.where(np.isinf(column), np.nan, column) for channel, column in read.items()}
    rows = np.array([number for number, _ in table.rows])
    if isinstance(series.time, float):
        time_s = np.arange(rows.size) / series.time
        timeless = np.zeros(rows.size, np.bool_)
    else:
        time_s = _values(table, series.time, column_map)
        timeless = ~np.isfinite(time_s)
    # a series shorter than its neighbours in the table has empty cells below it: they belong to no recording
    empty = np.all([np.isnan(values) for values in columns.values()], axis=0)
    filled = np.flatnonzero(~(empty & timeless) if timeless.any() else ~empty)
    stop = int(filled[-1]) + 1 if filled.size else 0
    if not stop:
        raise MapError(f"{table.path}: found no value in the columns of the map, need some")
    if table.cut:
        text = f"row {table.cut}, the last, ends before its last column and is left out"
        problems.append(Problem("truncated", table.path, text))
    for k in np.flatnonzero(timeless[:stop]):
        problems.append(Problem("malformed", table.path, f"row {rows[k]} has no time and is left out"))
    keep = np.flatnonzero(~timeless[:stop])
    if not keep.size:
        raise MapError(f"{table.path}: no row has a time, need some; check the time column of the map")
    if np.max(np.abs(time_s[keep])) > _LATEST_S:
        raise MapError(
            f"{table.path}: found a time of {np.max(np.abs(time_s[keep])):.6g} s, need less than {_LATEST_S:.4g} s; "
            "check the time column and its unit"
        )
    stamp_ns = np.rint(time_s[keep] * 1e9).astype(np.int64)
    if stamp_ns.size and stamp_ns.min() < 0:
        problems.append(
            Problem(
                "negative_time",
                table.path,
                f"times begin at {stamp_ns.min() / 1e9:g} s, shifted to begin at 0",
            )
        )
        stamp_ns = stamp_ns - stamp_ns.min()
    values = {channel: column[keep] for channel, column in columns.items()}
    present = {channel: np.ones(keep.size, np.bool_) for channel in values}
    samples = Samples(stamp_ns, values, present, {}, [])
    index, disorder = increasing_samples(table.path, samples)
    rows = rows[keep]
    if index.size < _FEWEST_KEPT * keep.size:
        steps = np.diff(stamp_ns)
        again = np.flatnonzero(steps == 0) + 1
        if again.size > np.count_nonzero(steps < 0) and np.any(steps > 0):
            first = again[0]
            raise MapError(
                f"{table.path}: {again.size} of {keep.size} rows have the time of the row before with other values, first "
                f"row {rows[first]} ({stamp_ns[first] / 1e9:.9g} s); need one row per time: give a time column with more "
                "digits, or rate_hz in place of a column"
            )
        raise MapError(
            f"{table.path}: of {keep.size} rows only {index.size} would be left in order of time, which runs from "
            f"{time_s[keep[0]]:.9g} s in row {rows[0]} to {time_s[keep[-1]]:.9g} s in row {rows[-1]}; check the time "
            "column and its unit, or give rate_hz in place of a column"
        )
    if not disorder and index.size < keep.size:
        text = f"{keep.size - index.size} rows repeat the row before, time and all, and are left out"
        problems.append(Problem("repeat", table.path, text))
    problems.extend(_by_row(disorder, rows))
    stamp_ns, rows = stamp_ns[index], rows[index]
    values = {channel: column[index] for channel, column in values.items()}
    for channel, column in values.items():
        endless = np.isinf(read[channel][keep][index])
        problems.extend(_missing(table.path, channel, column, endless, stamp_ns, rows))
    for channel, guard in series.guards.items():
        judge = values[guard.channel]
        outside = ~((judge >= guard.at_least) & (judge <= guard.at_most)) & ~np.isnan(values[channel])
        values[channel] = np.where(outside, np.nan, values[channel])
        if outside.any():
            first = int(np.flatnonzero(outside)[0])
            text = f"{channel} means nothing in {outside.sum()} rows, where {guard.channel} is outside the map's bounds"
            problems.append(
                Problem("nan", table.path, f"{text}; first row {rows[first]}", stamp_ns[first] / 1e9)
            )
    problems.extend(_by_row(find_gaps(table.path, stamp_ns, np.arange(rows.size)), rows))
    units = {channel: SI[source.unit.quantity] for channel, source in series.channels.items()}
    return Converted(name, Recording(stamp_ns / 1e9, values, column_map.device), units, problems)


def _values(table: Table, source: Source, column_map: ColumnMap) -> NDArray[np.float64]:
    """Return a column in SI units, NaN where a cell has no value."""
    place = table.column(source.column)
    number = _number_reader(column_map)
    values = np.full(len(table.rows), np.nan)
    for k, (row, cells) in enumerate(table.rows):
        cell = cells[place] if place < len(cells) else None
        try:
            values[k] = number(cell)
        except (TypeError, ValueError, OverflowError):
            raise MapError(
                f"{table.path}: row {row}, column {source.column!r}: found {cell!r}, need a number; "
                + _remedy(cell, column_map, row if k == 0 else 0)
            ) from None
    less, factor = source.less or (None, 0.0)
    other = _values(table, less, column_map) if less else 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # what a scale makes infinite is reported by its rows
        return (
            source.unit.factor * (source.scale * values + source.offset) + source.unit.offset - factor * other
        )


def _remedy(cell: Any, column_map: ColumnMap, first_row: int) -> str:
    """What to do about a cell that is no number; `first_row` is its row where that is the first of the samples, else 0."""
    if isinstance(cell, str) and column_map.decimal == "." and _DECIMAL_COMMA.fullmatch(cell.strip()):
        return 'set decimal: "," in the map if the comma is a decimal one'
    if first_row:
        return f"set first_row: {first_row + 1} in the map if the samples begin below this row, as below a row of units"
    return "list it under missing in the map if it means that there is no value"


def _by_row(problems: list[Problem], rows: NDArray[np.int64]) -> list[Problem]:
    """Return the problems with row numbers of the table in place of sample numbers."""
    return [
        problem
        if problem.index is None
        else replace(problem, text=f"row {rows[problem.index]}: {problem.text}", index=None)
        for problem in problems
    ]


def _number_reader(column_map: ColumnMap) -> Callable[[Any], float]:
    missing, comma = column_map.missing, column_map.decimal == ","

    def number(cell: Any) -> float:
        if cell is None:
            return np.nan
        if isinstance(cell, str):
            text = cell.strip()
            if text.lower() in missing:
                return np.nan
            return float(text.replace(",", ".") if comma else text)
        return float(cell)

    return number


def _missing(
    path: str,
    channel: str,
    column: NDArray[np.float64],
    endless: NDArray[np.bool_],
    stamp_ns: NDArray[np.int64],
    rows: NDArray[np.int64],
) -> list[Problem]:
    """Return one problem per stretch of rows without a finite value."""
    bad = ~np.isfinite(column)
    places = np.flatnonzero(bad)
    breaks = np.flatnonzero((np.diff(places) > 1) | (np.diff(rows[places]) > 1)) + 1
    found = []
    for stretch in np.split(places, breaks) if places.size else []:
        first, last = stretch[0], stretch[-1]
        place = f"row {rows[first]}" if last == first else f"rows {rows[first]} to {rows[last]}"
        what = "is infinite" if endless[stretch].any() else "has no value"
        found.append(Problem("nan", path, f"{place}: {channel} {what}, kept as NaN", stamp_ns[first] / 1e9))
    return limited(found)
