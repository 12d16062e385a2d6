"""Judgements of mutants in a table that is written as they come, and counted by layer."""

from __future__ import annotations

import csv
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path

from docs.generate.markdown import put_between
from tests.support.mutants.mutant import Mutant


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


COLUMNS = (
    "layer", "listed", "killed", "out of time", "argued", "survived", "not judged", "median s", "minutes"
)  # fmt: skip
"""Of the table by layer; a bug that survives with a reason in its list is argued."""


def counted(listed: Sequence[Mutant], found: Sequence[tuple[Mutant, Judgement]]) -> str:
    """The table of verdicts by layer, in Markdown. Each listed bug counts in one column.

    Args:
        listed: all bugs.
        found: those that were judged, with their judgements.
    """
    lines: list[Sequence[str]] = [COLUMNS, ["---"] * len(COLUMNS)]
    for layer in [*sorted({mutant.layer for mutant in listed}), ""]:
        total = sum(layer in ("", mutant.layer) for mutant in listed)
        rows = [(mutant, judgement) for mutant, judgement in found if layer in ("", mutant.layer)]
        alive = [bool(mutant.survives) for mutant, judgement in rows if judgement.verdict is Verdict.SURVIVED]
        counts = [sum(judgement.verdict is verdict for _, judgement in rows) for verdict in SEEN]
        counts += [sum(alive), len(alive) - sum(alive)]
        seconds = [judgement.seconds for _, judgement in rows] or [0.0]
        times = [f"{statistics.median(seconds):.1f}", f"{sum(seconds) / 60:.1f}"]
        lines.append([layer or "all", *map(str, [total, *counts, total - sum(counts)]), *times])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def write_page(page: Path, table: str) -> None:
    """Put the table of verdicts between the marks of a page."""
    put_between(page, "mutants", table)
