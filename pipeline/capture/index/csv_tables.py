"""Reading csv tables with typed columns; what is wrong in them is named by line."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from pipeline.base.errors import MOST_LISTED, Complaints, InputError, listed
from pipeline.capture.paths import locate

Kind = Literal["name", "text", "whole", "number"]

DTYPES = {"name": "str", "text": "str", "whole": "int64", "number": "float64"}

FLOAT32 = np.finfo(np.float32)

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
"""Names of cameras and lights become parts of paths: nothing in them may climb or hide."""


def read_csv(root: Path, path: str, columns: Mapping[str, Kind], complaints: Complaints) -> pd.DataFrame | None:
    """Read the wanted columns of a csv file, other columns left out.

    None if a column is missing, or a name or whole number is something else.
    """
    try:
        text = read_text_cells(locate(root, path))
    except (InputError, OSError, ValueError) as error:
        complaints.add(path, "table", expected=f"the columns {', '.join(columns)}", found=str(error))
        return None
    if missing := [column for column in columns if column not in text.columns]:
        found = f"no {', '.join(missing)} among {', '.join(map(str, text.columns))}"
        complaints.add(path, "columns", expected=", ".join(columns), found=found)
        return None
    return _typed(path, text, columns, complaints)


def column_names(root: Path, path: str) -> list[str]:
    """Names of a csv file's columns; none if it cannot be read.

    `read_csv` complains about that.
    """
    try:
        return header_cells(locate(root, path))
    except (InputError, OSError, ValueError):
        return []


def read_text_cells(file: Path) -> pd.DataFrame:
    """Every cell of a csv file as it stands, but for spaces around it; empty lines are left out.

    All rows are as long as the header: of one cell too many nobody can tell which columns it moves.

    Raises:
        ValueError: if it is no csv in UTF-8, or a row or a column's name says that cells are missing or too many.
    """
    (_, header), *rows = _lines(file)
    if twice := sorted({name for name in header if name and header.count(name) > 1}):
        raise ValueError(f"columns that are there twice: {listed(twice)}")
    if ragged := [f"{len(row)} in line {line}" for line, row in rows if len(row) != len(header)]:
        raise ValueError(f"rows of another number of cells than the {len(header)} of the header: {listed(ragged)}")
    return pd.DataFrame([row for _, row in rows], columns=header, dtype="str")


def header_cells(file: Path) -> list[str]:
    """Names of a csv file's columns, whatever its rows are like.

    Raises:
        ValueError: as `read_text_cells`.
    """
    return _lines(file)[0][1]


def _lines(file: Path) -> list[tuple[int, list[str]]]:
    """Number and cells of each line that is not empty; at least one."""
    with open(file, newline="", encoding="utf-8-sig") as lines:
        reader = csv.reader(lines, skipinitialspace=True, strict=True)
        try:
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
        except csv.Error as error:
            raise ValueError(f"{error} in line {reader.line_num}") from error
    if not rows:
        raise ValueError("No columns: the file is empty")
    return rows


def _typed(path: str, text: pd.DataFrame, columns: Mapping[str, Kind], complaints: Complaints) -> pd.DataFrame | None:
    table, good = {}, True
    for column, kind in columns.items():
        values = text[column].str.strip()
        if kind == "name":
            valid, expected = values.map(lambda value: bool(NAME.fullmatch(value))), "letters, digits, _ - and ."
        elif kind == "text":
            valid, expected = values != "", "text"
        elif kind == "whole":
            valid, expected = values.str.fullmatch(r"[+-]?\d{1,15}"), "a whole number"
        else:
            numbers = pd.to_numeric(values, errors="coerce").astype(np.float64)
            # Later stages compute in float32: what is no finite number there is none here.
            valid, expected = numbers.abs() <= FLOAT32.max, "a finite number"
        if not valid.all():
            complain_rows(complaints, path, column, ~valid, expected, values)
        if kind == "number":
            # A bad number is not a number in the table: names beside it can still be checked against other tables.
            # One parser for all digits: pandas' own rounds the last one differently.
            table[column] = values.where(valid, "nan").map(float).astype(np.float64)
        elif valid.all():
            table[column] = values.astype(DTYPES[kind])
        else:
            good = False
    return pd.DataFrame(table) if good else None


def complain_rows(
    complaints: Complaints, path: str, key: str, bad: pd.Series, expected: str, values: pd.Series
) -> None:
    """Name the file's lines (the header is line 1) and what stands there."""
    rows = np.flatnonzero(bad)
    found = listed([f"'{values.iloc[row]}' in line {row + 2}" for row in rows])
    complaints.add(path, key, expected=expected, found=found)


def complain_repeats(complaints: Complaints, path: str, table: pd.DataFrame, keys: list[str]) -> None:
    """Name the rows that repeat another row's keys."""
    repeated = repeated_keys(table, keys)
    complain_of_repeated(complaints, path, repeated, len(repeated))


def repeated_keys(table: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Keys that more than one row has, each once.

    In the order and with the index of the first rows that repeat them.
    """
    return table.loc[table.duplicated(keys), keys].drop_duplicates()


def complain_of_repeated(complaints: Complaints, path: str, repeated: pd.DataFrame, total: int) -> None:
    """Name the keys of `repeated_keys`.

    Args:
        repeated: the first of them, at least as many as are listed.
        total: number of all.
    """
    if total:
        named = list(repeated[:MOST_LISTED].map(str).agg(" ".join, axis=1))
        found = f"repeated: {listed(named, total=total)}"
        complaints.add(path, " and ".join(repeated.columns), expected="each once", found=found)


def complain_unknown(
    complaints: Complaints, path: str, key: str, values: Iterable[object], known: Collection[object], where: str
) -> None:
    """Name the values that another table does not list."""
    known = set(known)
    if unknown := [value for value in dict.fromkeys(values) if value not in known]:
        complaints.add(path, key, expected=f"one that {where} lists", found=listed(unknown))
