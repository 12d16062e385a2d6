"""Verdicts for a stage's operator: good, weak or failed, one per calibrated thing, and why."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import pandas as pd

Grade = Literal["good", "weak", "failed"]

COLUMNS = ["kind", "name", "grade", "reason"]


@dataclass(frozen=True)
class Verdict:
    """Verdict on one calibrated thing: its grade, and the reason.

    Attributes:
        kind: what it is on, one of the names in `pipeline.figures.page.KINDS`.
        name: its name in the capture.
        grade: good: use it; weak: usable, and worth a look or another recording; failed: not determined at all.
        reason: the numbers that decided it, and for weak or failed what to do.
    """

    kind: str
    name: str
    grade: Grade
    reason: str


def log_verdicts(log: logging.Logger, verdicts: Sequence[Verdict]) -> None:
    """Log one line per verdict, and one with counts; weak and failed verdicts are warnings."""
    for verdict in verdicts:
        level = logging.INFO if verdict.grade == "good" else logging.WARNING
        log.log(level, "%s %s: %s: %s", verdict.kind, verdict.name, verdict.grade, verdict.reason)
    counts = {grade: sum(verdict.grade == grade for verdict in verdicts) for grade in ("good", "weak", "failed")}
    log.info("%s", ", ".join(f"{count} {grade}" for grade, count in counts.items()))


def verdict_table(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """Columns kind, name, grade, reason; one row per verdict, in their order."""
    return pd.DataFrame([asdict(verdict) for verdict in verdicts], columns=COLUMNS)
