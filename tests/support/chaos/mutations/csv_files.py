"""Changes to tables in csv: text, rows, columns and cells."""

from __future__ import annotations

import csv
import io
import random
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from tests.support.chaos.mutations.mutation import Meaning, Mutation, replace

BROKEN, SAME, OTHER = Meaning.BROKEN, Meaning.SAME, Meaning.OTHER

Rows = list[list[str]]

CELLS = ("", "NA", "nan", "inf", "1e400", "x", "1;2", "--help", "../a", "a b", "é", "0x10", "1_0", "٣", "9" * 400,
         "\x00")  # fmt: skip
"""Cells that are no name, and no number either."""

TEXTS: dict[str, tuple[Meaning, Callable[[str], str | bytes]]] = {
    "lines end as on Windows": (SAME, lambda text: text.replace("\n", "\r\n")),
    "a byte order mark": (SAME, lambda text: b"\xef\xbb\xbf" + text.encode()),
    "no last line end": (SAME, lambda text: text.rstrip("\n")),
    "empty lines": (SAME, lambda text: text.replace("\n", "\n\n")),
    "all cells quoted": (SAME, lambda text: _written(_read(text), quoting=csv.QUOTE_ALL)),
    "spaces around cells": (SAME, lambda text: text.replace(",", " , ")),
    "semicolons": (BROKEN, lambda text: text.replace(",", ";")),
    "decimal commas": (BROKEN, lambda text: text.replace(".", ",")),
    "a quote that stays open": (BROKEN, lambda text: text.replace(",", ',"', 1)),
    "in UTF-16": (BROKEN, lambda text: text.encode("utf-16")),
    "without a header": (BROKEN, lambda text: text.split("\n", 1)[1]),
    "only the header": (BROKEN, lambda text: text.split("\n", 1)[0] + "\n"),
    "a comma behind each row": (BROKEN, lambda text: text.replace("\n", ",\n")),
    "a comma too many": (BROKEN, lambda text: text[:-1] + ",\n"),
    "the header again": (BROKEN, lambda text: text + text.split("\n", 1)[0] + "\n"),
}


def mutations(name: str, root: Path, rng: random.Random) -> Iterator[Mutation]:
    """Changes to a table.

    Args:
        name: of the table, relative to the capture.
        root: the sound capture, for the table's columns.
        rng: draws rows.
    """
    for what, (meaning, change) in TEXTS.items():
        yield Mutation(name, what, meaning, partial(_change_text, name, change))
    header, *rows = _read((root / name).read_text())
    count = len(rows)
    yield _rows(
        name, "rows shuffled", SAME if name != "frames.csv" else OTHER, partial(_shuffled, rng.randrange(1 << 30))
    )
    yield _rows(name, "a row twice", BROKEN, partial(_doubled, rng.randrange(count)))
    yield _rows(name, "half of the rows are gone", OTHER, lambda table: table[: 1 + count // 2])
    for place, column in enumerate(header):
        yield _rows(name, f"no column {column}", BROKEN, partial(_without, place))
        yield _rows(name, f"column {column} twice", BROKEN, partial(_column_twice, place))
        yield _rows(name, f"column {column} misspelt", BROKEN, partial(_renamed, place))
        for cell in CELLS:
            row = 1 + rng.randrange(count)
            yield _rows(name, f"{column} in row {row} is {cell[:12]!r}", BROKEN, partial(_with_cell, row, place, cell))
        yield _rows(name, f"cells of {column} one row further", BROKEN, partial(_shifted, place))
    yield from _numbers(name, header)


def _numbers(name: str, header: list[str]) -> Iterator[Mutation]:
    """Wrong numbers that are numbers: in another unit, mirrored, exchanged, of another row."""
    wrong = {
        "lights.csv": ["x", "y", "z"], "frames.csv": ["timestamp_s"], "patterns.csv": ["frame"],
        "cameras.csv": ["width", "height", "sensor_width", "sensor_height"],
    }  # fmt: skip
    for column in wrong.get(name, []):
        place = header.index(column)
        for factor in (-1.0, 1e-3, 1e3, 2.0):
            yield _rows(name, f"{column} times {factor:g}", BROKEN, partial(_scaled, place, factor))
    if name == "lights.csv":
        for first, second in ((1, 2), (2, 3), (1, 3)):
            what = f"{header[first]} and {header[second]} exchanged"
            yield _rows(name, what, BROKEN, partial(_exchanged, first, second))
        for factor in (1e-3, 0.01, 3.28, 39.37, 1e3):
            yield _rows(name, f"all in another unit, times {factor:g}", BROKEN, partial(_all_scaled, factor))
    if name == "patterns.csv":
        for offset in (-2, -1, 1, 2, 3):
            yield _rows(
                name, f"numbered {offset:+d} frames off", BROKEN, partial(_offset, header.index("frame"), offset)
            )


def _read(text: str) -> Rows:
    return list(csv.reader(io.StringIO(text)))


def _written(rows: Rows, quoting: int = csv.QUOTE_MINIMAL) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n", quoting=quoting).writerows(rows)
    return text.getvalue()


def _rows(name: str, what: str, meaning: Meaning, change: Callable[[Rows], Rows]) -> Mutation:
    def apply(root: Path) -> None:
        replace(root / name, _written(change(_read((root / name).read_text()))))

    return Mutation(name, what, meaning, apply)


def _change_text(name: str, change: Callable[[str], str | bytes], root: Path) -> None:
    replace(root / name, change((root / name).read_text()))


def _shuffled(seed: int, table: Rows) -> Rows:
    header, *rows = table
    random.Random(seed).shuffle(rows)
    return [header, *rows]


def _doubled(place: int, table: Rows) -> Rows:
    return [*table, table[1 + place]]


def _without(place: int, table: Rows) -> Rows:
    return [row[:place] + row[place + 1 :] for row in table]


def _column_twice(place: int, table: Rows) -> Rows:
    return [[*row, row[place]] for row in table]


def _renamed(place: int, table: Rows) -> Rows:
    header, *rows = table
    return [[*header[:place], f"{header[place]}q", *header[place + 1 :]], *rows]


def _with_cell(row: int, place: int, cell: str, table: Rows) -> Rows:
    table[row][place] = cell
    return table


def _shifted(place: int, table: Rows) -> Rows:
    cells = [row[place] for row in table[1:]]
    for row, cell in zip(table[1:], [cells[-1], *cells[:-1]], strict=True):
        row[place] = cell
    return table


def _scaled(place: int, factor: float, table: Rows) -> Rows:
    for row in table[1:]:
        value = float(row[place]) * factor
        row[place] = str(int(value)) if row[place].lstrip("-").isdigit() else repr(value)
    return table


def _all_scaled(factor: float, table: Rows) -> Rows:
    for place in (1, 2, 3):
        _scaled(place, factor, table)
    return table


def _exchanged(first: int, second: int, table: Rows) -> Rows:
    for row in table[1:]:
        row[first], row[second] = row[second], row[first]
    return table


def _offset(place: int, offset: int, table: Rows) -> Rows:
    """The log of frames that are numbered otherwise; what falls off at one end comes in at the other."""
    frames = 1 + max(int(row[place]) for row in table[1:])
    for row in table[1:]:
        row[place] = str((int(row[place]) + offset) % frames)
    return [table[0], *sorted(table[1:], key=lambda row: int(row[place]))]
