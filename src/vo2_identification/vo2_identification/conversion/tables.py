"""CSV, whitespace-separated text and XLSX as rows of cells.

A table is held in memory: at most 10 million cells, some 1 GB, from a file of at most 537 MB (of a workbook:
decompressed, and at most 100 times its size), with lines of at most a million characters.
"""

from __future__ import annotations

import csv
import gzip
import struct
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO, TypeVar
from zipfile import BadZipFile, ZipFile

from vo2_models.io import InputError, check_regular

from vo2_identification.conversion.column_map import ColumnMap, MapError

__all__ = ["Table", "read_table"]

_HEADER_SEARCH = 200
_MOST_BYTES = 1 << 29
_LONGEST_LINE = 1 << 20
_MOST_CELLS = 10_000_000
_MOST_ROWS = 1 << 20  # of a sheet
_MOST_TIMES = 100  # workbooks expand some 20 times
_SLACK = 1 << 20
_WORKBOOK = b"PK\x03\x04"  # an .xlsx file is a ZIP archive


_Row = TypeVar("_Row", bound=Sequence[Any])


@dataclass(frozen=True)
class Table:
    """Rows of samples.

    Attributes
    ----------
    path : the file, with the sheet where there are sheets
    names : column names, empty where the map has no header row
    rows : (row number from 1, its cells)
    cut : number of a last row that has fewer cells than every other and is not among `rows`, 0 where there is none
    """

    path: str
    names: tuple[str, ...]
    rows: Sequence[tuple[int, Sequence[Any]]]
    cut: int = 0

    def column(self, wanted: str | int) -> int:
        """Return the index from 0 of a column given by name or by number from 1.

        Raises
        ------
        MapError : no such column, or a name that several columns have.
        """
        if isinstance(wanted, int):
            width = max((len(cells) for _, cells in self.rows), default=0)
            if wanted > width:
                raise MapError(f"{self.path}: found {width} columns, need a column {wanted}")
            return wanted - 1
        if not self.names:
            raise MapError(f"{self.path}: column {wanted!r} has a name, but the map names no header_row")
        places = [k for k, name in enumerate(self.names) if name == wanted.strip()]
        if len(places) == 1:
            return places[0]
        if not places:
            present = ", ".join(repr(name) for name in self.names if name) or "none"
            raise MapError(
                f"{self.path}: found no column {wanted!r} in the header, which has {present}{self._hint(wanted)}"
            )
        numbers = ", ".join(str(k + 1) for k in places)
        raise MapError(
            f"{self.path}: column {wanted!r} occurs {len(places)} times; use one of its numbers {numbers}"
        )

    def _hint(self, wanted: str) -> str:
        """Say where a name that is not in the header stands after all, or nothing."""
        wanted = wanted.strip()
        for mark, name in (";", '";"'), (",", "comma"), ("\t", "tab"):
            if len(self.names) == 1 and wanted in [part.strip() for part in self.names[0].split(mark)]:
                return f"; the columns look separated otherwise: set delimiter: {name} in the map"
        for number, cells in self.rows[:_HEADER_SEARCH]:
            if any(str(cell).strip() == wanted for cell in cells if cell is not None):
                return f"; it stands in row {number}: set header_row: {number} in the map"
        return ""


def read_table(path: Path, column_map: ColumnMap) -> Table:
    """Return the header and the sample rows of a file; rows without any cell are left out.

    Parameters
    ----------
    path : of the file
    column_map : where in it the samples are

    Raises
    ------
    MapError : not readable, not in the map's encoding, no such sheet, no such rows.
    """
    name = str(path)
    try:
        if column_map.form == "xlsx":
            cells: Sequence[Sequence[Any]]
            sheet, cells = _sheet(path, column_map.sheet)
            name = f"{path} sheet {sheet}"
        else:
            cells = _text_rows(path, column_map)
    except MapError:
        raise
    except InputError as error:
        raise MapError(str(error)) from error
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeError as error:
        place = f"byte {error.start}" if isinstance(error, UnicodeDecodeError) else "the text"
        raise MapError(
            f"{path}: {place} is not {column_map.encoding}; set encoding in the map, for instance cp1252"
        ) from error
    except csv.Error as error:
        raise MapError(f"{path}: not a table that can be read ({error})") from error
    header: tuple[str, ...] = ()
    if column_map.header_row:
        if column_map.header_row > len(cells):
            raise MapError(f"{name}: found {len(cells)} rows, need a header in row {column_map.header_row}")
        header = tuple("" if cell is None else str(cell).strip() for cell in cells[column_map.header_row - 1])
        header = header or ("",)  # a blank row is a header all the same: one without names
    last = column_map.last_row or len(cells)
    rows = [
        (number, row)
        for number, row in enumerate(cells, start=1)
        if column_map.first_row <= number <= last and any(cell not in (None, "") for cell in row)
    ]
    if not rows:
        raise MapError(f"{name}: found {len(cells)} rows, need samples from row {column_map.first_row} on")
    wide = [number for number, row in rows if sum(cell not in (None, "") for cell in row) >= 2 * len(header)]
    if column_map.delimiter == "," and len(header) > 1 and len(wide) == len(rows):
        raise MapError(
            f"{name}: row {wide[0]}: found {len(rows[0][1])} cells under a header of {len(header)}: commas that separate and "
            'decimal ones? save the table with another separator, and set delimiter: ";" and decimal: "," in the map'
        )
    _check_width(name, header, rows)
    # what was being written when the logger stopped: even its last cell may be half a number
    open_end = column_map.form != "xlsx" and not column_map.last_row and len(rows) > 1
    if open_end and len(rows[-1][1]) < min(len(row) for _, row in rows[:-1]):
        return Table(name, header, rows[:-1], rows[-1][0])
    return Table(name, header, rows)


def _check_width(name: str, header: Sequence[str], rows: Sequence[tuple[int, Sequence[Any]]]) -> None:
    """Refuse single rows with more than their header has: what stands behind a stray separator is another column's."""

    def filled(row: Sequence[Any]) -> int:
        return max((k for k, cell in enumerate(row, start=1) if cell not in (None, "")), default=0)

    wider = [(number, filled(row)) for number, row in rows if filled(row) > len(header)]
    if len(header) > 1 and wider and 2 * len(wider) < len(rows):
        number, cells = wider[0]
        raise MapError(
            f"{name}: row {number}: found {cells} cells under a header of {len(header)}, as in {len(wider)} of {len(rows)} rows: "
            "a separator too many, or two lines in one? mend the row, or give first_row and last_row in the map"
        )


def _text_rows(path: Path, column_map: ColumnMap) -> list[list[str]]:
    check_regular(path, _MOST_BYTES)
    with _opened(path, "rb") as binary:
        if binary.read(4) == _WORKBOOK:
            raise MapError(
                f"{path}: found an .xlsx workbook, need a text table; or set format: xlsx in the map"
            )
    with _opened(path, "rt", encoding=column_map.encoding, newline="") as file:
        lines = _lines(file, path)
        if column_map.delimiter == "whitespace":
            return _limited((line.split() for line in lines), path)
        return _limited(csv.reader(lines, delimiter=column_map.delimiter), path)


def _lines(file: TextIO, path: Path) -> Iterator[str]:
    number = 0
    while line := file.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE:
            raise MapError(
                f"{path}: line {number} has more than {_LONGEST_LINE} characters, need rows of a table"
            )
        yield line


def _limited(rows: Iterable[_Row], path: Path) -> list[_Row]:
    """Return the rows; refuse a table that would not fit into memory."""
    taken: list[_Row] = []
    cells = 0
    for row in rows:
        cells += len(row)
        if cells > _MOST_CELLS or len(taken) >= _MOST_CELLS:
            raise MapError(
                f"{path}: row {len(taken) + 1}: found more than {_MOST_CELLS / 1e6:g} million cells up to here; "
                "split the table, or delete stray cells far to the right or below"
            )
        taken.append(row)
    return taken


def _opened(path: Path, mode: str, **text: Any) -> Any:
    """Open a file as it is, or what a .gz file holds."""
    return gzip.open(path, mode, **text) if path.suffix == ".gz" else path.open(mode.replace("t", ""), **text)


def _sheet(path: Path, wanted: str | None) -> tuple[str, list[Sequence[Any]]]:
    from openpyxl import load_workbook

    check_regular(path, _MOST_BYTES)
    _check_archive(path)
    try:
        with warnings.catch_warnings():
            # it warns of parts that it leaves out, such as print settings: nothing that a table needs
            warnings.simplefilter("ignore", UserWarning)
            book = load_workbook(path, read_only=True, data_only=True)
        try:
            if wanted is not None and wanted not in book.sheetnames:
                raise MapError(
                    f"{path}: found no sheet {wanted!r}, the workbook has {', '.join(book.sheetnames)}"
                )
            sheet = book[wanted] if wanted is not None else book.worksheets[0]
            # what the file says of its size is neither reliable nor needed
            sheet.reset_dimensions()
            rows = sheet.iter_rows(values_only=True, max_row=_MOST_ROWS + 1)
            found = _limited(rows, path)
            if len(found) > _MOST_ROWS:
                raise MapError(
                    f"{path}: found a cell below row {_MOST_ROWS}, the last one of a sheet; delete it"
                )
            return sheet.title, found
        finally:
            book.close()
    except (MapError, OSError):
        raise
    except Exception as error:  # openpyxl raises whatever its parsers meet in a damaged workbook
        raise MapError(
            f"{path}: not an .xlsx workbook that can be read ({type(error).__name__}: {error}); save it anew, "
            "or for a text table set format: csv in the map"
        ) from error


def _check_archive(path: Path) -> None:
    """Refuse a ZIP archive that expands to more than a workbook does; what it says of its members binds the reading."""
    try:
        with ZipFile(path) as archive:
            members = archive.infolist()
    except (BadZipFile, ValueError, NotImplementedError, LookupError, struct.error) as error:
        raise MapError(
            f"{path}: not an .xlsx workbook ({error}); for a text table set format: csv in the map"
        ) from error
    size = sum(member.file_size for member in members)
    packed = path.stat().st_size
    if size > _MOST_BYTES or size > _MOST_TIMES * packed + _SLACK:
        raise MapError(
            f"{path}: found {packed / 1e6:.4g} MB that expand to {size / 1e6:.4g} MB, need at most "
            f"{_MOST_TIMES} times and {_MOST_BYTES / 1e6:.4g} MB; save the table as csv"
        )
