"""Hold the simulated schedule of `benchmarks.schedule` against a run on a Slurm cluster.

    python -m benchmarks.bench_schedule --log snakemake.log --results results/tiny --nodes 2 --cores 2 --mem-mb 8000

A finished run says how long each of its jobs' commands took, in its benchmarks, and Snakemake's log how long the run
did. The same jobs, with these times, are simulated on as many nodes, and so is a run whose jobs take what
config/curves/job_costs.csv expects; and the time between two jobs is found with which the simulation would have been
right. Writes results/scaling/schedule_check.csv. Run it in the project's folder, with the configuration of the run,
such as `chunk_frames=2`, behind `--`.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pandas as pd
import yaml

from benchmarks.schedule import Cluster, Job, read_graph, simulate
from pipeline.base.files import write_table
from pipeline.base.finished_jobs import finished_jobs
from pipeline.base.yaml_files import read_yaml
from pipeline.budget.job_costs import CHUNKED, TABLE, read_costs
from pipeline.config.loading import load_project
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_requests import THREAD_SHARE, memory_mb, useful_threads
from pipeline.workflow.job_size import job_size
from pipeline.workflow.shared_images import SHARES

STAMP = re.compile(r"^\[(\w{3} \w{3} +\d+ \d\d:\d\d:\d\d \d{4})\]$", re.MULTILINE)
"""Line above each job that Snakemake tells of."""

OVERHEAD_STEP_S = 0.1


def measured_seconds(results: Path) -> dict[str, float]:
    """Wall seconds of a job's command, by stage, the mean of its jobs."""
    found: dict[str, list[float]] = {}
    for job in finished_jobs(results / "benchmarks"):
        found.setdefault(job.stage, []).append(job.wall_s)
    return {stage: sum(taken) / len(taken) for stage, taken in found.items()}


def wall_seconds(log: str) -> float:
    """Seconds from the first job that a log tells of to its last line with a time."""
    times = [datetime.strptime(each, "%a %b %d %H:%M:%S %Y") for each in STAMP.findall(log)]
    if len(times) < 2:
        raise SystemExit("expected the log of a run with jobs, found no times in it")
    return (times[-1] - times[0]).total_seconds()


def jobs_of(dot: str, files: JobFiles, cores: int, seconds: Mapping[str, float]) -> dict[int, Job]:
    """Jobs of a graph, each with the time of its stage, or what is expected of it where none is given."""
    rules, before = read_graph(dot)
    whole, chunk = job_size(files), job_size(replace(files, chunk=files.chunks[0]))
    costs, jobs = read_costs(TABLE), {}
    for number, rule in rules.items():
        stage = SHARES.get(rule, rule)
        size = chunk if stage in CHUNKED else whole
        threads = min(useful_threads(stage, size), cores)
        terms = costs[stage, "seconds"]
        expected = terms.expected(size) / (1 + THREAD_SHARE * (threads - 1))
        memory = memory_mb(stage, size, threads, 1)
        jobs[number] = Job(rule, threads, memory, seconds.get(stage, expected), before[number])
    return jobs


def explaining_overhead(jobs: Mapping[int, Job], cluster: Cluster, wall_s: float) -> float:
    """Seconds between two jobs with which a simulated run takes so long, to a tenth."""
    low, high = 0.0, wall_s
    while high - low > OVERHEAD_STEP_S:
        middle = (low + high) / 2
        longer = simulate(jobs, replace(cluster, overhead_s=middle)).wall_s > wall_s
        low, high = (low, middle) if longer else (middle, high)
    return low


def graph(target: str, changes: Sequence[str]) -> str:
    """What Snakemake prints of all jobs of a target."""
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--forceall", "--dag", "dot"]
    command += [*(["--config", *changes] if changes else []), "--", target]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--log", type=Path, required=True, help="what Snakemake printed of the run")
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of the run")
    parser.add_argument("--nodes", type=int, default=2, help="nodes of the cluster")
    parser.add_argument("--cores", type=int, default=2, help="processors of a node")
    parser.add_argument("--mem-mb", type=int, default=8000, help="megabytes of a node")
    parser.add_argument("--out", type=Path, default=Path("results/scaling/schedule_check.csv"), help="table to write")
    parser.add_argument("config", nargs="*", help="configuration of the run, key=value")
    options = parser.parse_args()
    subject, took = options.results.name, measured_seconds(options.results)
    dot, wall_s = graph(f"{options.results}/metrics.csv", options.config), wall_seconds(options.log.read_text())
    changes = {key: yaml.safe_load(value) for key, _, value in (word.partition("=") for word in options.config)}
    project = load_project({**read_yaml(Path("config/config.yaml")), **changes}, changes, Path("config/subjects"))
    cluster, rows = Cluster(options.nodes, options.cores, options.mem_mb), []
    for times, seconds in (("as measured", took), ("as expected", {})):
        jobs = jobs_of(dot, JobFiles(project, subject), options.cores, seconds)
        found = {"simulated_s": round(simulate(jobs, cluster).wall_s), "run_s": round(wall_s)}
        rows.append({"jobs_take": times, **found, "overhead_s": round(explaining_overhead(jobs, cluster, wall_s), 1)})
    table = pd.DataFrame(rows)
    write_table(options.out, table)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
