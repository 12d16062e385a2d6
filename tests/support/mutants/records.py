"""Judgements of mutants in a table that is written as they come, and counted by layer."""

from __future__ import annotations

import csv
import statistics
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path

from docs.generate.markdown import put_between


class Verdict(StrEnum):
    """Judgement of a mutant, or of tests without one."""

    KILLED = "killed"
    """A test failed."""
    STOPPED = "out of time"
    """The tests took several times as long as without the change. Counts as killed: nobody would wait for them."""
    SURVIVED = "survived"
    """No test saw it."""
    UNJUDGED = "not judged"
    """The tests did not run: the change breaks an import, or a test is not found."""
    SOUND = "sound"
    """Tests that pass without a change."""


SEEN = (Verdict.KILLED, Verdict.STOPPED)


@dataclass(frozen=True)
class Judgement:
    """One row of the table.

    Attributes:
        layer: the mutant's, or nothing for tests without a change.
        mutant: its file and text, or the tests.
        digest: of what was judged.
        verdict: what came of it.
        seconds: that its tests took.
        by: the test that failed first.
    """

    layer: str
    mutant: str
    digest: str
    verdict: Verdict
    seconds: float
    by: str


def read(path: Path) -> list[Judgement]:
    """Rows of a table that was begun; none if there is none."""
    if not path.is_file():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return [
            Judgement(**(row | {"verdict": Verdict(row["verdict"]), "seconds": float(row["seconds"])}))
            for row in csv.DictReader(file)
        ]


def append(path: Path, judgement: Judgement) -> None:
    """Add a row, which is on the disk when this returns."""
    fresh = not path.is_file()
    with open(path, "a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Judgement)])
        if fresh:
            writer.writeheader()
        writer.writerow(asdict(judgement) | {"seconds": f"{judgement.seconds:.2f}"})


def counted(judgements: Iterable[Judgement]) -> str:
    """The table of verdicts by layer, in Markdown."""
    judged = [judgement for judgement in judgements if judgement.layer]
    lines = [["layer", "mutants", "killed", "out of time", "survived", "median s", "minutes"], ["---"] * 7]
    for layer in [*sorted({judgement.layer for judgement in judged}), ""]:
        rows = [judgement for judgement in judged if layer in ("", judgement.layer)]
        counts = [sum(row.verdict is verdict for row in rows) for verdict in (*SEEN, Verdict.SURVIVED)]
        seconds = [row.seconds for row in rows] or [0.0]
        times = [f"{statistics.median(seconds):.1f}", f"{sum(seconds) / 60:.1f}"]
        lines.append([layer or "all", str(len(rows)), *map(str, counts), *times])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def write_page(page: Path, judgements: Iterable[Judgement]) -> None:
    """Put the table of verdicts between the marks of a page."""
    put_between(page, "mutants", counted(judgements))
