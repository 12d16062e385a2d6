"""Read a Goliath capture of the real counts, with tiny images: what importing, planning and inspecting it take.

    python -m benchmarks.bench_goliath_size [--frames 30000] [--cameras 172]

Writes the fake of `benchmarks.goliath_capture` (3.3 GB in the folder for temporary files), imports it through the
workflow, has Snakemake plan the rest, before and after, and inspects some of its chunks, as nodes of a cluster would.
Memory is that of the largest process. Writes the numbers between marks of docs/datasets.md.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.bench_paper_size import working_in
from benchmarks.goliath_capture import GoliathSize, write_goliath_size
from benchmarks.marked_page import write_between
from benchmarks.paper_capture import LINKED
from pipeline.base.files import read_table
from pipeline.base.yaml_files import read_yaml
from pipeline.config.loading import load_project
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.shared_images import first_chunks

ROOT, SUBJECT, PAGE = Path(__file__).resolve().parents[1], "goliath", Path("docs/datasets.md")
TARGET = f"results/{SUBJECT}/metrics.csv"

INSPECTED = 3
"""Chunks whose images are decoded: the first, the middle one, the last."""


@dataclass(frozen=True)
class Run:
    """A run of Snakemake: seconds of wall and processors, memory of its largest process, jobs by rule."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    jobs: dict[str, int]


def snakemake(folder: Path, *words: str) -> Run:
    """Run Snakemake in a process of its own.

    Raises:
        SystemExit: if it fails.
    """
    command = [sys.executable, "-m", "snakemake", "--cores", "2", *words]
    with tempfile.TemporaryFile("w+") as said:
        started = time.monotonic()
        running = subprocess.Popen(command, cwd=folder, stdout=said, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(running.pid, 0)
        running.returncode = os.waitstatus_to_exitcode(status)
        wall = time.monotonic() - started
        said.seek(0)
        text = said.read()
    if running.returncode:
        raise SystemExit(text[-3000:])
    table = text.rpartition("Job stats:")[2]
    rows = dict(re.findall(r"^(\w+) +(\d+)$", table, flags=re.MULTILINE))
    jobs = {rule: int(count) for rule, count in rows.items() if rule != "total"}
    return Run(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, jobs)


def write_project(folder: Path, shipped: Path) -> None:
    """The project with one subject, whose images lie in a public set."""
    folder.mkdir(parents=True)
    for name in LINKED:
        if (ROOT / name).exists():
            (folder / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "config", folder / "config", ignore=shutil.ignore_patterns("subjects"))
    (folder / "config/subjects").mkdir()
    (folder / f"config/subjects/{SUBJECT}.yaml").write_text(f"source: goliath\npath: {shipped}\n")


def chunks_of(folder: Path) -> list[str]:
    """First chunks of the jobs that are run here, of all that inspect images."""
    with working_in(folder):
        project = load_project(read_yaml(Path("config/config.yaml")), {}, Path("config/subjects"))
        firsts = first_chunks(JobFiles(project, SUBJECT))
    return list(dict.fromkeys(firsts[round(share * (len(firsts) - 1))] for share in np.linspace(0, 1, INSPECTED)))


def measure(size: GoliathSize, folder: Path) -> list[str]:
    """Rows of the table."""
    shipped, project = write_goliath_size(folder / "set", size), folder / "project"
    write_project(project, shipped)
    before = size_gb(shipped)
    fresh = snakemake(project, "--dry-run", "--quiet", "rules", "--", TARGET)
    capture = project / "captures" / SUBJECT
    imported = snakemake(project, "--quiet", "all", "--", f"captures/{SUBJECT}/capture.yaml")
    images = read_table(capture / "images.parquet")
    plan = snakemake(project, "--dry-run", "--quiet", "rules", "--", TARGET)
    chunks = chunks_of(project)
    tables = [f"results/{SUBJECT}/inspected/{chunk}.parquet" for chunk in chunks]
    runs = [snakemake(project, "--quiet", "all", "--", table) for table in tables]
    looked = pd.concat([read_table(project / table) for table in tables])
    twice = int(looked[["what", "path"]].duplicated().sum())
    frames, per_chunk = images.frame.nunique(), len(looked[looked.what == "color"]) / len(chunks)
    print(json.dumps({"plan": vars(plan), "fresh": vars(fresh), "twice": twice}, indent=1))
    if twice or looked.unreadable.astype(bool).any():
        raise SystemExit(f"{twice} images inspected twice, or some that cannot be read")
    own = size_gb(capture)
    return [
        f"Measured with {size.cameras} cameras and {size.frames:,} frames of {size.width} x {size.height} pixels: "
        f"{len(images):,} images of {frames:,} frames that have a mesh or lie between two, in {2 * size.cameras + 2} "
        f"archives. The set takes {before:.1f} GB before and {size_gb(shipped):.1f} GB after, `captures/<name>` "
        f"{own:.2f} GB.\n",
        "| step | jobs | wall of one, s | processors, s | largest process, MB |",
        "|---|---|---|---|---|",
        f"| plan, before anything has run | {sum(fresh.jobs.values())} | {cells(fresh, 1)} |",
        f"| `import_capture` | 1 | {cells(imported)} |",
        f"| plan, once it is imported | {sum(plan.jobs.values())} | {cells(plan, 1)} |",
        f"| `inspect_images`, {per_chunk:,.0f} images | {plan.jobs['inspect_images']} | "
        f"{cells(max(runs, key=lambda run: run.wall_s))} |",
        "",
        f"Chunks {', '.join(chunks)} were inspected: each of their images once, none in two of them. Seconds are of a "
        "run of Snakemake, its plan included, on two cores: those of processors are what it took, those of the wall "
        "grow with what else runs. Memory is that of its largest process.",
    ]


def cells(run: Run, digits: int = 0) -> str:
    """Seconds of wall and of processors, and memory, as cells of the table."""
    return f"{run.wall_s:.{digits}f} | {run.cpu_s:.{digits}f} | {run.peak_mb:,.0f}"


def size_gb(folder: Path) -> float:
    """Size of the files of a folder, links not followed, in gigabytes."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) / 1e9


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=GoliathSize.frames)
    parser.add_argument("--cameras", type=int, default=GoliathSize.cameras)
    options = parser.parse_args()
    size = GoliathSize(cameras=options.cameras, frames=options.frames)
    with tempfile.TemporaryDirectory(prefix="goliath_size_") as made:
        lines = measure(size, Path(made))
    print("\n".join(lines))
    print(f"this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    if size == GoliathSize():
        write_between(PAGE, "goliath size", lines)


if __name__ == "__main__":
    main()
