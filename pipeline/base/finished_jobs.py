"""Time and memory of finished jobs, by the benchmark files that Snakemake writes of them.

Wall time is exact. Processor time is what a job and its children had used when Snakemake last looked at them, which it
does every half second for a quarter of a minute, then every half minute: of a job of 44 s it says what the first 15
took. What follows the last look is taken to go on as before. Looks come late by the time that they take
themselves, some tenths of a second in thirty: a job that ends within these is counted too low.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

SHORT_S, LONG_S = 0.5, 30.0
"""Pauses between looks (`snakemake.benchmark.BENCHMARK_INTERVAL_SHORT`, `BENCHMARK_INTERVAL`)."""
SHORT_LOOKS = 30
"""Short pauses before the first long one."""


@dataclass(frozen=True)
class FinishedJob:
    """Time and memory of a job.

    Attributes:
        stage: its stage, or its rule.
        words: what else its file is called by: the number of a chunk, the name of a variant.
        wall_s: seconds from start to end.
        cpu_s: a processor's seconds, of all its processes; NaN for a job too short to be looked at.
        peak_mb: the largest resident set that was seen, MB; NaN as above.
    """

    stage: str
    words: tuple[str, ...]
    wall_s: float
    cpu_s: float
    peak_mb: float


def finished_jobs(folder: Path) -> list[FinishedJob]:
    """Read the benchmarks of a run, in the order of their names.

    Of a job that was repeated, the last run counts.
    """
    return [job for path in sorted(folder.glob("*.tsv")) if (job := _read(path)) is not None]


def _read(path: Path) -> FinishedJob | None:
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    if not rows:
        return None
    stage, *words = path.name.removesuffix(".tsv").split(".")
    wall, seen, peak = (_number(rows[-1].get(name)) for name in ("s", "cpu_time", "max_rss"))
    return FinishedJob(stage, tuple(words), wall, seen * wall / (last_look(wall) or wall), peak)


def last_look(wall_s: float) -> float:
    """Seconds after its start at which a job of `wall_s` was looked at last."""
    first = SHORT_LOOKS * SHORT_S
    begin, pause = (0.0, SHORT_S) if wall_s < first else (first, LONG_S)
    return begin + pause * ((wall_s - begin) // pause)


def _number(text: str | None) -> float:
    """Read a number; NaN for the NA and the dash of a job that was not looked at."""
    return math.nan if text in (None, "", "NA", "-") else float(text)
