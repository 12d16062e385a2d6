"""Write the README's table of results from finished runs; rows of other subjects stay as they are.

    python -m docs.generate.results_table --results results/subjectA results/subjectB

Minutes are of the wall clock, summed over all jobs of the subject (Snakemake's benchmarks), as if none had run beside
another.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import parted, put_between, table
from pipeline.base.code_digest import ROOT
from pipeline.base.files import read_json, read_table
from pipeline.base.finished_jobs import finished_jobs

TABLE = "results"
"""Name of the marks around the table in the README; this module rewrites all between."""

COLUMNS = ("subject", "capture", "images scored", "PSNR, dB", "fully lit", "partially lit", "SSIM", "FLIP", "minutes")


def run(*, results: tuple[Path, ...], variant: str = "full", page: Path = ROOT / "README.md") -> None:
    """Put a row per subject into the page's table.

    Args:
        results: folders results/SUBJECT of finished runs.
        variant: the avatar whose scores are shown.
        page: the page with the table.
    """
    shown = parted(page, TABLE)[1]
    rows = {line.split("|")[1].strip(): line.strip("| ").split(" | ") for line in shown.strip().splitlines()[2:]}
    for folder in results:
        cells = row(folder, variant)
        rows[cells[0]] = cells
    put_between(page, TABLE, table(COLUMNS, (rows[name] for name in sorted(rows))))


def row(results: Path, variant: str) -> list[str]:
    """The cells of a subject."""
    scores = pd.read_csv(results / "metrics.csv")
    scores = scores[(scores.variant == variant) & (scores.split == "test")].set_index("lit")
    best = scores.loc["all"]
    psnr = [f"{scores.psnr_db[lit]:.2f}" for lit in ("all", "full", "partial")]
    counts = {name: len(read_table(results / f"index/{name}.parquet")) for name in ("cameras", "lights", "frames")}
    kind = read_json(results / "index/capture.json")["kind"]
    capture = f"{kind}: {', '.join(f'{count} {name}' for name, count in counts.items())}"
    return [f"`{best.subject}`", capture, f"{best.images}", *psnr, f"{best.ssim:.3f}", f"{best.flip:.3f}",
            f"{minutes(results / 'benchmarks', variant):.0f}"]  # fmt: skip


def minutes(benchmarks: Path, variant: str) -> float:
    """Wall time of all jobs but the training of other variants, and what nothing of metrics.csv needs."""
    aside = ("measure_cost", "review_", "relight_", "export_", "write_report", "check_budget")
    jobs = [job for job in finished_jobs(benchmarks) if not job.stage.startswith(aside)]
    return sum(job.wall_s for job in jobs if job.stage != "train_avatar" or job.words == (variant,)) / 60


if __name__ == "__main__":
    tyro.cli(run)
