"""CSV, whitespace-separated text and XLSX as rows of cells."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vo2_identification.conversion.column_map import ColumnMap, MapError

__all__ = ["Table", "read_table"]

_HEADER_SEARCH = 200
_WORKBOOK = b"PK\x03\x04"  # an .xlsx file is a ZIP archive


@dataclass(frozen=True)
class Table:
    """Rows of samples.

    Attributes
    ----------
    path : the file, with the sheet where there are sheets
    names : column names, empty where the map has no header row
    rows : (row number from 1, its cells)
    """

    path: str
    names: tuple[str, ...]
    rows: Sequence[tuple[int, Sequence[Any]]]

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
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise MapError(
            f"{path}: byte {error.start} is not {column_map.encoding}; set encoding in the map, for instance cp1252"
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
    return Table(name, header, rows)


def _text_rows(path: Path, column_map: ColumnMap) -> list[list[str]]:
    with path.open("rb") as binary:
        if binary.read(4) == _WORKBOOK:
            raise MapError(
                f"{path}: found an .xlsx workbook, need a text table; or set format: xlsx in the map"
            )
    with path.open(encoding=column_map.encoding, newline="") as file:
        if column_map.delimiter == "whitespace":
            return [line.split() for line in file]
        return list(csv.reader(file, delimiter=column_map.delimiter))


def _sheet(path: Path, wanted: str | None) -> tuple[str, list[Sequence[Any]]]:
    from zipfile import BadZipFile

    from openpyxl import load_workbook
    from openpyxl.utils.exceptions import InvalidFileException

    try:
        book = load_workbook(path, read_only=True, data_only=True)
    except (BadZipFile, InvalidFileException, KeyError) as error:
        raise MapError(
            f"{path}: not an .xlsx workbook ({error}); for a text table set format: csv in the map"
        ) from error
    try:
        if wanted is not None and wanted not in book.sheetnames:
            raise MapError(
                f"{path}: found no sheet {wanted!r}, the workbook has {', '.join(book.sheetnames)}"
            )
        sheet = book[wanted] if wanted is not None else book.worksheets[0]
        return sheet.title, list(sheet.iter_rows(values_only=True))
    finally:
        book.close()
