"""Write one page to judge a result by.

It shows scores, pictures, what the result was made from, what it cost, and where it comes from.

Everything is inside the one file, which loads nothing and may be sent to anyone. Parts whose inputs are not there are
named as missing, with the command that makes them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.config.stage_settings import read_changes
from pipeline.config.write_report import WriteReport
from pipeline.report import costs, project, recording, scores
from pipeline.report.part import Part, write_parts
from pipeline.report.pictures import Pictures
from pipeline.report.provenance import provenance
from pipeline.report.requests import read_requests
from pipeline.report.results import Results

log = logging.getLogger("write_report")

PARTS: list[Callable[[Results], Part]] = [
    scores.headline, scores.pictures, recording.relit, scores.ablations, recording.effects, project.effects_comparison,
    recording.calibration, recording.patterns, recording.tracking, recording.atlas, costs.accuracy_cost,
    costs.error_budget, project.cost_scaling, costs.hard_cases, costs.stages, provenance,
]  # fmt: skip
"""In the order of the page: the result first, then what it rests on."""

FIRST_LIMIT, LAST_LIMIT = 600_000, 2_000
"""Bytes of one picture. The limit is halved until the page is small enough; below the last, pictures show nothing."""


def run(
    *, results: Path, project_results: Path, out: Path, subject_settings: str = "{}", requests: tuple[str, ...] = (),
    settings: WriteReport = WriteReport(),
) -> None:  # fmt: skip
    """Write the report of one subject.

    Args:
        results: the subject's results, results/SUBJECT, up to metrics.csv; what else there is, is shown.
        project_results: folder of what belongs to no subject: hard_cases.csv, effects_comparison.csv, scaling/; what is
            not there is named as missing.
        out: HTML file to write.
        subject_settings: JSON, what differs from the defaults in the subject's settings, for the page.
        requests: what jobs of a stage ask for, to be shown beside what they used, each as STAGE:MEGABYTES:MINUTES.
    """
    changed = read_changes("--subject-settings", subject_settings)
    asked = read_requests(requests)
    limit = FIRST_LIMIT
    while True:
        shown = Results(results, project_results, changed, settings, Pictures(limit), asked)
        parts = [part(shown) for part in PARTS]
        size_mb = sum(len(part.html) for part in parts) / 1e6
        if size_mb <= settings.page_mb:
            break
        limit //= 2
        log.info("%.1f MB are too many: pictures of at most %d bytes", size_mb, limit)
        if limit < LAST_LIMIT:
            raise InputError(f"--page-mb: expected room for the text and small pictures, found {settings.page_mb}")
    for part in parts:
        if part.missing:
            log.info("%s: missing: %s", part.title, part.missing)
    write_parts(out, f"{shown.subject}: from capture to avatar", subtitle(shown), parts)
    log.info("%s: %.1f MB", out.name, out.stat().st_size / 1e6)


def subtitle(results: Results) -> str:
    """Size of the recording in one line."""
    cameras, frames = results.table("index/cameras.parquet"), results.table("index/frames.parquet")
    lights = results.table("index/lights.parquet")
    sizes = " and ".join(sorted({f"{row.width} × {row.height}" for row in cameras.itertuples()}))
    return f"{len(cameras)} cameras of {sizes} pixels, {len(frames)} frames, {len(lights)} lights"


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
