"""Time and memory of finished jobs, from Snakemake's benchmark files and from their logs.

Wall time is exact. Processor time is what the stage says at the end of its log. Of a log that does not say it, it is
what Snakemake saw when it last looked at the job and its children, which it does every half second for a quarter of a
minute, then every half minute: of a job of 44 s that is what the first 15 took. What follows the last look is taken to
go on as before. Looks come late by the time that they take themselves, some tenths of a second in thirty: a job that
ends within these is counted too low, one of two processes and 75 s as 77 s where it takes 120.
"""

from __future__ import annotations

import csv
import math
import re
import resource
from dataclasses import dataclass
from pathlib import Path

USED = "used {:.2f} s of a processor"
"""What a stage says when it is done."""

_USED = re.compile(re.escape(USED).replace(re.escape("{:.2f}"), r"([0-9.]+)") + "$", re.MULTILINE)

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
        cpu_s: a processor's seconds, of all its processes, of several nodes on the one that has most; NaN for a job
            that does not say it and is too short to be looked at.
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
    said = _said(path.parent.parent / "logs" / f"{path.stem}.log")
    return FinishedJob(stage, tuple(words), wall, said or seen * wall / (last_look(wall) or wall), peak)


def processor_seconds() -> float:
    """Seconds of a processor that this process has used, and those that it has waited for."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def _said(log: Path) -> float | None:
    """Seconds of a processor that a log ends with; of several nodes or nested stages, the most."""
    if not log.is_file():
        return None
    return max(map(float, _USED.findall(log.read_text(encoding="utf-8", errors="replace"))), default=None)


def last_look(wall_s: float) -> float:
    """Seconds after its start at which a job of `wall_s` was looked at last."""
    first = SHORT_LOOKS * SHORT_S
    begin, pause = (0.0, SHORT_S) if wall_s < first else (first, LONG_S)
    return begin + pause * ((wall_s - begin) // pause)


def _number(text: str | None) -> float:
    """Read a number; NaN for the NA and the dash of a job that was not looked at."""
    return math.nan if text in (None, "", "NA", "-") else float(text)
