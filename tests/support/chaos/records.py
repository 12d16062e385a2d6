"""Outcomes of attacks in a table that is written as they come, and counted by part and class."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from docs.generate.markdown import parted, put_between
from tests.support.chaos.outcome import DEFECTS, Outcome, Result

COLUMNS = ("part", "attack", "outcome", "stage", "seconds", "said")

HEAD = ("part", "attacks", *Outcome, "minutes")
RULE = "|" + " --- |" * len(HEAD) + "\n"
"""Line between the head of the table of classes and its rows."""

UNPRINTABLE = re.compile(r"[^\x20-\x7e\xa0-\uffff]")


@dataclass(frozen=True)
class Record:
    """One row of the table."""

    part: str
    attack: str
    outcome: Outcome
    stage: str
    seconds: float
    said: str


def read(path: Path) -> list[Record]:
    """Rows of a table that was begun; none if there is none."""
    if not path.is_file():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return [
            Record(
                row["part"], row["attack"], Outcome(row["outcome"]), row["stage"], float(row["seconds"]), row["said"]
            )
            for row in csv.DictReader(file)
        ]


def append(path: Path, part: str, attack: str, result: Result, seconds: float) -> Record:
    """Add a row, which is on the disk when this returns."""
    fresh = not path.is_file()
    said = UNPRINTABLE.sub("?", result.said)
    record = Record(part, UNPRINTABLE.sub("?", attack), result.outcome, result.stage, seconds, said)
    with open(path, "a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(COLUMNS)
        writer.writerow([part, record.attack, str(record.outcome), record.stage, f"{seconds:.2f}", said])
    return record


def counted(records: Iterable[Record]) -> str:
    """The table of classes by part, in Markdown."""
    records = list(records)
    counts = Counter((record.part, record.outcome) for record in records)
    parts = list(dict.fromkeys(record.part for record in records))
    lines = [list(HEAD)]
    for part in parts:
        numbers = [counts[part, outcome] for outcome in Outcome]
        minutes = sum(record.seconds for record in records if record.part == part) / 60
        lines.append([part, str(sum(numbers)), *map(str, numbers), f"{minutes:.1f}"])
    head, *rows = ("| " + " | ".join(line) + " |\n" for line in lines)
    return head + RULE + "".join(rows)


def write_page(page: Path, records: Iterable[Record]) -> None:
    """Put the table of classes between the marks of a page; rows of parts without a record stay."""
    written = _rows(parted(page, "attacks")[1])
    head, rows = counted(records).split(RULE)
    written |= _rows(head + RULE + rows)
    put_between(page, "attacks", head + RULE + "".join(written.values()))


def _rows(table: str) -> dict[str, str]:
    """Lines of a table below its head, by their first cell."""
    lines = table.partition(RULE)[2].splitlines(keepends=True)
    return {line.split("|")[1].strip(): line for line in lines}


def defects(records: Iterable[Record]) -> list[Record]:
    """Records of outcomes that should not be."""
    return [record for record in records if record.outcome in DEFECTS]
