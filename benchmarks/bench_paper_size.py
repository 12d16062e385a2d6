"""Plan a capture of the papers' size: its graph of jobs, what they take, and how long a cluster works on them.

    python -m benchmarks.bench_paper_size [--out docs/paper_size.md]

Writes a fake capture of 512 cameras, 1,024 lights and 5,000 frames (`benchmarks.paper_capture`), has Snakemake plan it,
from nothing and with what decides its jobs done, and measures that. What jobs take is config/curves/job_costs.csv at
that size (`benchmarks.paper_costs`); the schedule is simulated on 1, 16 and 256 nodes (`benchmarks.schedule`). Writes
the page, and beside it, into results/paper_size, the tables.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd

from benchmarks.paper_capture import PaperSize, write_finished, write_project
from benchmarks.paper_costs import StageCost, stage_costs
from benchmarks.paper_page import Planning, paper_page
from benchmarks.schedule import Cluster, Job, Schedule, read_graph, simulate
from pipeline.base.files import write_table
from pipeline.base.yaml_files import read_yaml
from pipeline.budget.job_costs import CHUNKED, TABLE, read_costs
from pipeline.config.loading import Project, load_project
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_size import job_size
from pipeline.workflow.shared_images import (
    SHARES,
    inspected_tables,
    joined_size,
    score_tables,
    size_of_share,
)
from pipeline.workflow.shared_photographs import size_of_calibration

ROOT, SUBJECT, PRESET = Path(__file__).resolve().parents[1], "paper", "config/presets/gpu.yaml"
TARGET = f"results/{SUBJECT}/metrics.csv"

NODES = (1, 16, 256)
"""Numbers of nodes of the simulated clusters, each with what the Slurm profile asks for at most."""

UNPLANNED = ("pack_shards", "train_avatar", "score_images", "evaluate_avatar")
"""Stages after the plan of effects. What those before it write decides the number of their jobs."""


def snakemake(folder: Path, *words: str) -> tuple[str, Planning]:
    """Snakemake in a process of its own: what it prints, and what that took."""
    command = [sys.executable, "-m", "snakemake", "--cores", "16", *words, "--configfile", PRESET, "--", TARGET]
    with tempfile.TemporaryFile("w+") as printed, tempfile.TemporaryFile("w+") as said:
        started = time.monotonic()
        running = subprocess.Popen(command, cwd=folder, stdout=printed, stderr=said)
        _, status, used = os.wait4(running.pid, 0)
        running.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0), said.seek(0)
        text, errors = printed.read(), said.read()
    if running.returncode:
        raise SystemExit(errors[-2000:])
    table = (text + errors).rpartition("Job stats:")[2]
    rows = dict(re.findall(r"^(\w+) +(\d+)$", table, flags=re.MULTILINE))
    jobs = {rule: int(count) for rule, count in rows.items() if rule != "total"}
    wall = time.monotonic() - started
    return text, Planning(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, jobs)


def write_done(folder: Path, summary: str) -> None:
    """Stages up to the plan of effects, done, and all at the same time: none is newer than what it was made of.

    Args:
        folder: of the project.
        summary: what `snakemake --summary` says of a run from nothing.
    """
    rows = [line.split("\t") for line in summary.splitlines() if line.startswith("results/")]
    write_finished(folder, [path for path, _, rule, *_ in rows if rule not in UNPLANNED], SUBJECT)
    now = time.time()
    for path in (folder / "results").rglob("*"):
        os.utime(path, (now, now))


@contextlib.contextmanager
def working_in(folder: Path):
    """The working folder, for functions whose paths are relative to the project."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def costs_of(folder: Path, jobs: dict[str, int]) -> dict[str, StageCost]:
    """Costs of the stages, as the workflow asks for them."""
    with working_in(folder):
        files = JobFiles(paper_project(), SUBJECT)
        size, chunk = job_size(files), replace(files, chunk="0000")
        joining = {"index_capture": inspected_tables(files), "evaluate_avatar": score_tables(files)}
        own = dict.fromkeys(jobs, size) | dict.fromkeys(CHUNKED, job_size(chunk))
        own |= {rule: size_of_share(rule, chunk) for rule in SHARES}
        own |= {stage: joined_size(files, tables) for stage, tables in joining.items()}
        own |= {stage: size_of_calibration(stage, files) for stage in ("calibrate_cameras", "calibrate_lights")}
        return stage_costs(size, own, jobs, read_costs(TABLE), Cluster(1).cores)


def paper_project() -> Project:
    """The configuration of the project in this folder, with the preset."""
    preset = read_yaml(Path(PRESET))
    return load_project({**read_yaml(Path("config/config.yaml")), **preset}, preset, Path("config/subjects"))


def schedules(dot: str, costs: dict[str, StageCost]) -> dict[tuple[int, str], Schedule]:
    """Simulated runs by number of nodes, and for low, middle and high costs."""
    rules, before = read_graph(dot)
    found = {}
    for nodes in NODES:
        for end in ("low", "middle", "high"):
            jobs = {
                n: Job(rule, costs[rule].threads, costs[rule].mem_mb, getattr(costs[rule].wall_s, end), before[n])
                for n, rule in rules.items()
            }
            found[nodes, end] = simulate(jobs, Cluster(nodes, queue=max(100, 2 * nodes)))
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs/paper_size.md", help="page to write")
    parser.add_argument("--tables", type=Path, default=ROOT / "results/paper_size", help="folder of the tables")
    options, size = parser.parse_args(), PaperSize()
    with tempfile.TemporaryDirectory(prefix="paper_size_") as made:
        folder = Path(made, "project")
        write_project(ROOT, folder, size, SUBJECT)
        _, fresh = snakemake(folder, "--dry-run", "--quiet", "rules")
        write_done(folder, snakemake(folder, "--summary")[0])
        _, whole = snakemake(folder, "--dry-run", "--quiet", "rules")
        dot, _ = snakemake(folder, "--dag", "dot")
        jobs = dict(Counter(read_graph(dot)[0].values()))
        jobs.pop("all", None)
        costs = costs_of(folder, jobs)
    runs = schedules(dot, costs)
    write_table(options.tables / "stages.csv", pd.json_normalize([{"stage": n, **asdict(c)} for n, c in costs.items()]))
    rows = [{"nodes": n, "costs": end, "wall_s": run.wall_s, "busy": run.busy} for (n, end), run in runs.items()]
    write_table(options.tables / "schedules.csv", pd.DataFrame(rows))
    options.out.write_text(paper_page(size, fresh, whole, costs, runs))
    print(options.out.read_text())


if __name__ == "__main__":
    main()
