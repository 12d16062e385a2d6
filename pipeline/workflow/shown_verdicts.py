"""Verdicts that a finished run shows: logs of stages that succeed are read by nobody."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

TABLES = (
    "*/index/verdicts_*.csv", "*/calibration/verdicts_*.csv", "*/verdicts_*.csv", "*/tracking/verdicts_*.csv",
    "*/tracking/review/verdicts.csv",
)  # fmt: skip
"""Tables of verdicts, below the project's results, in data order."""

GRADES = ("good", "weak", "failed")

MOST_SHOWN = 20
"""Lines that are shown; the rest is counted."""


def shown_verdicts(results: Path, since: float) -> tuple[list[str], list[str]]:
    """Lines of a table of all verdicts since a moment, and lines about those that are not good.

    The table has a row for each subject and kind, with how many are good, weak and failed: it shows what was judged,
    also when all is well. Both are empty if nothing was judged.

    Args:
        results: folder of the project's results.
        since: seconds of `time.time`.
    """
    counts: dict[tuple[str, str], Counter] = {}
    lines = []
    for path in (path for pattern in TABLES for path in sorted(results.glob(pattern))):
        if path.stat().st_mtime < since:
            continue
        subject = path.relative_to(results).parts[0]
        with open(path, newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                counts.setdefault((subject, row["kind"]), Counter())[row["grade"]] += 1
                if row["grade"] != "good":
                    lines.append(f"{path}: {row['kind']} {row['name']}: {row['grade']}: {row['reason']}")
    more = len(lines) - MOST_SHOWN
    return _table(counts), lines[:MOST_SHOWN] + ([f"... and {more} more that are weak or failed"] if more > 0 else [])


def _table(counts: dict[tuple[str, str], Counter]) -> list[str]:
    if not counts:
        return []
    rows = [("subject", "verdicts on", *GRADES)]
    rows += [(*key, *(str(found[grade]) for grade in GRADES)) for key, found in counts.items()]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    cells = ([*map(str.ljust, row[:2], widths[:2]), *map(str.rjust, row[2:], widths[2:])] for row in rows)
    return ["  ".join(row) for row in cells]
