"""Reading parquet tables of a capture with typed columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd
import pyarrow
import pyarrow.parquet as pq

from pipeline.base import large_tables
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_parquet as read_whole
from pipeline.capture.index.csv_tables import DTYPES, Kind
from pipeline.capture.paths import locate

UNREADABLE = (InputError, pyarrow.ArrowException, OSError, ValueError)
"""What reading a file that is no parquet table raises."""


def read_parquet(root: Path, path: str, columns: Mapping[str, Kind], complaints: Complaints) -> pd.DataFrame | None:
    """Read the wanted columns of a parquet table; None, and a complaint, if that fails."""
    try:
        table = read_whole(locate(root, path))
    except UNREADABLE as error:
        complaints.add(path, "table", expected="a parquet table", found=str(error))
        return None
    if missing := [column for column in columns if column not in table.columns]:
        complaints.add(path, "columns", expected=", ".join(columns), found=f"no {', '.join(missing)}")
        return None
    try:
        return table[list(columns)].astype({column: DTYPES[kind] for column, kind in columns.items()})
    except (TypeError, ValueError) as error:
        _complain_of_types(path, columns, str(error), complaints)
        return None


def read_pieces(
    root: Path, path: str, columns: Mapping[str, Kind], complaints: Complaints
) -> Iterator[pd.DataFrame | None]:
    """Read the wanted columns of a parquet table a piece of rows at a time.

    The index counts the rows of the table. None, and the complaint of `read_parquet`, is last where that fails.
    """
    try:
        file = locate(root, path)
        with pq.ParquetFile(file) as opened:
            # Not the names that the file lists: pandas makes an index of some.
            names = opened.schema_arrow.empty_table().to_pandas(use_threads=False).columns
        if missing := [column for column in columns if column not in names]:
            complaints.add(path, "columns", expected=", ".join(columns), found=f"no {', '.join(missing)}")
            yield None
            return
        yield from _typed_pieces(file, path, columns, complaints)
    except UNREADABLE as error:
        complaints.add(path, "table", expected="a parquet table", found=str(error))
        yield None


def _typed_pieces(
    file: Path, path: str, columns: Mapping[str, Kind], complaints: Complaints
) -> Iterator[pd.DataFrame | None]:
    """Pieces with their types; the complaint is of the first column that has none, wherever in the table."""
    order, rows, wrong = list(columns), 0, {}
    for piece in large_tables.read_pieces(file, order):
        typed = {}
        for column in order[: min(map(order.index, wrong), default=len(order))]:
            try:
                typed[column] = piece[[column]].astype({column: DTYPES[columns[column]]})[column]
            except (TypeError, ValueError) as error:
                wrong[column] = str(error)
                break
        if not wrong:
            yield pd.DataFrame(typed).set_axis(pd.RangeIndex(rows, rows + len(piece)))
        rows += len(piece)
    if wrong:
        _complain_of_types(path, columns, wrong[min(wrong, key=order.index)], complaints)
        yield None


def _complain_of_types(path: str, columns: Mapping[str, Kind], found: str, complaints: Complaints) -> None:
    numbers = [column for column, kind in columns.items() if kind in ("whole", "number")]
    complaints.add(path, "columns", expected=f"numbers in {', '.join(numbers)}", found=found)
