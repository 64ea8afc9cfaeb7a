"""The results of many bags as one table: Parquet for programs, CSV for everybody."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

from vo2_models.io import InputError

__all__ = ["columns_of", "csv_text", "parquet_bytes"]

Row = Mapping[str, Any]


def columns_of(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Return column -> values, one for each row; None where a row has none, and where a number is not finite.

    A column holds numbers alone or texts alone.

    Parameters
    ----------
    rows : column -> number, text or None
    """
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: [_plain(row.get(name)) for row in rows] for name in names}
    for name, values in columns.items():
        if any(isinstance(value, str) for value in values):
            columns[name] = [None if value is None else str(value) for value in values]
    return columns


def csv_text(rows: Sequence[Row]) -> str:
    """Return the table as CSV: comma, decimal point, an empty cell where there is nothing.

    Parameters
    ----------
    rows : column -> number, text or None
    """
    columns = columns_of(rows)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return out.getvalue()


def parquet_bytes(rows: Sequence[Row]) -> bytes:
    """Return the table as a Parquet file.

    Parameters
    ----------
    rows : column -> number, text or None

    Raises
    ------
    InputError : pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError("found no pyarrow, need it for the Parquet table: pip install pyarrow") from error
    columns = {
        name: pyarrow.array(values, type=pyarrow.string() if _are_texts(values) else None)
        if any(value is not None for value in values)
        else pyarrow.nulls(len(values), pyarrow.float64())
        for name, values in columns_of(rows).items()
    }
    out = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns), out)
    return out.getvalue()


def _are_texts(values: Sequence[Any]) -> bool:
    return any(isinstance(value, str) for value in values)


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
