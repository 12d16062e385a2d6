"""Estimate of the time that a run has yet to take.

    python -m pipeline.workflow.time_left results/NAME/metrics.csv [--cores 16] [--config key=value]

Snakemake says in a dry run which jobs are left, also while a run is under way; job_costs.csv says how long they are
expected to take. The subject's jobs that are done tell by how much this machine is faster or slower than that.
"""

from __future__ import annotations

import argparse
import math
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from pipeline.base.errors import InputError
from pipeline.base.finished_jobs import finished_jobs
from pipeline.base.yaml_files import read_yaml
from pipeline.budget.job_costs import CHUNKED
from pipeline.config.loading import load_project
from pipeline.config.project import SECTIONS
from pipeline.workflow.job_files import RESULTS, JobFiles
from pipeline.workflow.job_requests import expected_seconds
from pipeline.workflow.job_size import job_size
from pipeline.workflow.shared_images import SHARES, size_of_share
from pipeline.workflow.shared_photographs import size_of_calibration

CONFIG = Path("config/config.yaml")


@dataclass(frozen=True)
class StageLeft:
    """Jobs of a stage that are left, those under way among them.

    Attributes:
        jobs: number of them.
        seconds: of one processor, that all of them are expected to take.
    """

    stage: str
    jobs: int
    seconds: float


def stage_of(rule: str) -> str | None:
    """The stage that a rule runs; None for a rule without one."""
    known = sorted(SECTIONS, key=len, reverse=True)
    return next((stage for stage in known if SHARES.get(rule, rule).startswith(stage)), None)


def stages_left(jobs: Mapping[str, int], files: JobFiles, pace: float = 1.0) -> list[StageLeft]:
    """Jobs that are left by stage, in data order.

    Args:
        jobs: rule -> number of jobs.
        files: of the subject.
        pace: seconds that jobs take here over those that are expected.
    """
    counts: dict[tuple[str, bool], int] = {}
    for rule, count in jobs.items():
        if (stage := stage_of(rule)) is not None:
            counts[stage, rule in SHARES] = counts.get((stage, rule in SHARES), 0) + count
    order = {stage: place for place, stage in enumerate(SECTIONS)}
    return [
        StageLeft(stage, count, pace * count * _seconds(stage, shared, files))
        for (stage, shared), count in sorted(counts.items(), key=lambda item: order[item[0][0]])
    ]


def pace_of(results: Path, files: JobFiles) -> float | None:
    """Seconds that finished jobs took over those that were expected; None if none is finished."""
    took = expected = 0.0
    for job in finished_jobs(results / "benchmarks"):
        if job.stage in SECTIONS and not math.isnan(job.cpu_s):
            took += job.cpu_s
            expected += _seconds(job.stage, False, files)
    return took / expected if took and expected else None


def planned_jobs(target: str, options: Sequence[str]) -> dict[str, int]:
    """Rules of a dry run, and how many jobs each would run.

    Raises:
        InputError: if Snakemake refuses, with what it says.
    """
    words = ["--cores", "1", "--dry-run", *options, "--", target]
    done = subprocess.run([sys.executable, "-m", "snakemake", *words], capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    if done.returncode:
        raise InputError(said.strip()[-2000:])
    rows = re.findall(r"^(\w+) +(\d+)$", said.rpartition("Job stats:")[2], flags=re.MULTILINE)
    return {rule: int(count) for rule, count in rows if rule != "total"}


def as_lines(left: Sequence[StageLeft], cores: int, pace: float | None) -> list[str]:
    """A table of what is left, and how long that takes at least."""
    if not left:
        return ["nothing is left"]
    lines = [f"{'stage':20} {'jobs':>6} {'minutes of a processor':>24}"]
    lines += [f"{each.stage:20} {each.jobs:6d} {each.seconds / 60:24.1f}" for each in left]
    hours = sum(each.seconds for each in left) / cores / 3600
    known = "no job is finished: as job_costs.csv expects"
    if pace is not None:
        known = f"finished jobs took {pace:.2g} of what was expected, and so should these"
    return [*lines, f"at least {60 * hours:.0f} min ({hours:.1f} h) on {cores} processors; {known}"]


def _seconds(stage: str, shared: bool, files: JobFiles) -> float:
    """Seconds of a processor that a job of a stage is expected to take."""
    chunk = replace(files, chunk=files.chunks[0])
    if shared:
        size = size_of_share(next(rule for rule, shares_of in SHARES.items() if shares_of == stage), chunk)
    else:
        size = job_size(chunk) if stage in CHUNKED else size_of_calibration(stage, files)
    return expected_seconds(stage, size)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", help="file that the run is to make: results/NAME/...")
    parser.add_argument("--cores", type=int, default=2, help="processors that work on it")
    parser.add_argument("--config", nargs="*", default=[], help="configuration of the run, key=value")
    asked = parser.parse_args()
    try:
        parts = Path(asked.target).parts
        if len(parts) < 3 or parts[0] != RESULTS:
            raise InputError(f"target: expected {RESULTS}/NAME/FILE, found {asked.target}")
        changes = {key: yaml.safe_load(value) for key, _, value in (word.partition("=") for word in asked.config)}
        project = load_project({**read_yaml(CONFIG), **changes}, changes, Path("config/subjects"))
        files = JobFiles(project, parts[1])
        jobs = planned_jobs(asked.target, ["--config", *asked.config] if asked.config else [])
        pace = pace_of(Path(RESULTS, parts[1]), files)
        print("\n".join(as_lines(stages_left(jobs, files, pace or 1.0), asked.cores, pace)))
    except InputError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
