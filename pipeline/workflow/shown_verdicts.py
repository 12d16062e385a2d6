"""Verdicts that a finished run shows: logs of stages that succeed are read by nobody."""

from __future__ import annotations

import csv
from pathlib import Path

TABLES = ("*/calibration/verdicts_*.csv", "*/tracking/review/verdicts.csv")
"""Tables of verdicts, below the project's results."""

MOST_SHOWN = 20
"""Lines that are shown; the rest is counted."""


def shown_verdicts(results: Path, since: float) -> list[str]:
    """Lines about verdicts that are not good, from tables written since a moment.

    Args:
        results: folder of the project's results.
        since: seconds of `time.time`.
    """
    lines = []
    for path in sorted(path for pattern in TABLES for path in results.glob(pattern)):
        if path.stat().st_mtime < since:
            continue
        with open(path, newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["grade"] != "good"]
        lines += [f"{path}: {row['kind']} {row['name']}: {row['grade']}: {row['reason']}" for row in rows]
    more = len(lines) - MOST_SHOWN
    return lines[:MOST_SHOWN] + ([f"... and {more} more that are weak or failed"] if more > 0 else [])
