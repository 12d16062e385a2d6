"""Seconds that subjects take from their capture to the table, in two checkouts, one after the other.

`python -m benchmarks.bench_subjects --checkouts ../before . --subjects subjectA walker` makes metrics.csv of each
subject anew, in each checkout, on two cores with nothing else running. Kernels are compiled before, as they are when
the project is installed. Results that lie there are removed, and so are captures that the subject synthesises. Prints
a line of JSON for each run: seconds in all and by rule, and the PSNR of all test images.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

from pipeline.base.finished_jobs import finished_jobs

CAPTURES = {"walker": "../shared/captures"}
"""Folders of the captures that are not synthetic."""

GOALS = {"table": "results/{subject}/metrics.csv", "capture": "captures/{subject}/capture.yaml"}
"""What is made."""

COMPILE = """
import importlib.util as util, subprocess, sys
module = "pipeline.avatar.training.compile_kernels"
if util.find_spec(module):
    subprocess.run([sys.executable, "-m", module], check=True)
"""


def seconds_by_rule(results: Path) -> dict[str, float]:
    """Wall seconds of each rule, summed over its jobs, from Snakemake's benchmarks."""
    seconds: dict[str, float] = {}
    for job in finished_jobs(results / "benchmarks"):
        seconds[job.stage] = round(seconds.get(job.stage, 0.0) + job.wall_s, 1)
    return seconds


def run(checkout: Path, subject: str, cores: int, settings: Path | None, goal: str) -> dict[str, object]:
    """Make the table of a subject anew, by settings of its own or, for the time it takes, by those given."""
    results, own = checkout / "results" / subject, checkout / "config" / "subjects" / f"{subject}.yaml"
    if settings and not own.exists():
        shutil.copyfile(settings, own)
        try:
            return run(checkout, subject, cores, None, goal)
        finally:
            own.unlink()
    shutil.rmtree(results, ignore_errors=True)
    words = [GOALS[goal].format(subject=subject), "--cores", str(cores), "--quiet", "all"]
    if subject in CAPTURES:
        words += ["--config", f"captures={CAPTURES[subject]}"]
    else:
        shutil.rmtree(checkout / "captures" / subject, ignore_errors=True)
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve())}
    subprocess.run([sys.executable, "-c", COMPILE], cwd=checkout, env=environment, check=True, capture_output=True)
    started = time.monotonic()
    subprocess.run([sys.executable, "-m", "snakemake", *words], cwd=checkout, env=environment, check=True)
    seconds = time.monotonic() - started
    found: dict[str, object] = {"seconds": round(seconds, 1)}
    if goal == "table":
        table = pd.read_csv(results / "metrics.csv")
        psnr = float(table[(table.split == "test") & (table.lit == "all")].psnr_db.iloc[0])
        found["psnr_db"] = round(psnr, 3)
    return found | {"rules": seconds_by_rule(results)}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkouts", type=Path, nargs="+", required=True, help="folders of the project, in order")
    parser.add_argument("--subjects", nargs="+", required=True)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--goal", choices=GOALS, default="table")
    parser.add_argument("--settings", type=Path, help="file for a subject that has none in config/subjects")
    args = parser.parse_args()
    for subject in args.subjects:
        for checkout in args.checkouts:
            found = run(checkout, subject, args.cores, args.settings, args.goal)
            print(json.dumps({"subject": subject, "checkout": checkout.resolve().name, **found}), flush=True)


if __name__ == "__main__":
    main()
