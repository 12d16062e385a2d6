"""Hold what jobs ask for against what they took.

    python -m benchmarks.bench_requests --results results/walker --config captures=../shared/captures \
        --measured results/scaling/shared_images.csv results/scaling/scored_images.csv

Of a finished run, whose benchmarks say what each job took, and of jobs that other benchmarks measured at sizes that no
run has. Memory is asked for with a margin, and with what the two Snakemake processes take beside a cluster's job; what
was used is the stage's own, and the same added to it. Writes results/scaling/requests.csv: a row for each job.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import pandas as pd
import yaml

from benchmarks.bench_job_costs import SECONDS
from pipeline.base.files import write_table
from pipeline.base.finished_jobs import finished_jobs
from pipeline.base.yaml_files import read_yaml
from pipeline.budget.job_costs import CHUNKED
from pipeline.budget.job_size import JobSize
from pipeline.config.loading import load_project
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_requests import SNAKEMAKE_MB, memory_mb, minutes, useful_threads
from pipeline.workflow.job_size import job_size, unknown_size


def run_jobs(results: Path, files: JobFiles, cores: int) -> list[dict]:
    """Jobs of a finished run, with what each asked for and took."""
    rows = []
    for job in finished_jobs(results / "benchmarks"):
        stage = job.stage
        if stage in SECONDS and not math.isnan(job.peak_mb):
            size = job_size(replace(files, chunk=files.chunks[0]) if stage in CHUNKED else files)
            threads = min(useful_threads(stage, size), cores)
            asked = {"asked_mb": memory_mb(stage, size, threads, 1), "asked_min": minutes(stage, size, threads, 1)}
            used = {"used_mb": job.peak_mb, "used_min": job.wall_s / 60}
            name = " ".join([stage, *(word for word in job.words if word.isdigit())])
            rows.append({"of": files.subject, "job": name, **asked, **used})
    return rows


def measured_jobs(path: Path) -> list[dict]:
    """Jobs of a benchmark's table, with what the workflow would ask for at their sizes."""
    rows, sizes = [], set(JobSize.__dataclass_fields__)
    for row in pd.read_csv(path).to_dict("records"):
        size = replace(unknown_size(), **{name: value for name, value in row.items() if name in sizes})
        asked = memory_mb(row["stage"], size, size.threads, 1)
        job = f"{row['stage']}, {row['job']} of {row['images']} images of {row['pixels']} pixels"
        rows.append({"of": row["subject"], "job": job, "asked_mb": asked, "used_mb": row["mb"]})
    return rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--results", type=Path, nargs="*", default=[], help="results/SUBJECT of finished runs")
    parser.add_argument("--measured", type=Path, nargs="*", default=[], help="tables of jobs that benchmarks wrote")
    parser.add_argument("--cores", type=int, default=2, help="of these runs")
    parser.add_argument("--config", nargs="*", default=[], help="configuration of these runs, key=value")
    parser.add_argument("--out", type=Path, default=Path("results/scaling/requests.csv"), help="table to write")
    options, rows = parser.parse_args(), []
    changes = {key: yaml.safe_load(value) for key, _, value in (word.partition("=") for word in options.config)}
    project = load_project({**read_yaml(Path("config/config.yaml")), **changes}, changes, Path("config/subjects"))
    for results in options.results:
        rows += run_jobs(results, JobFiles(project, results.name), options.cores)
    for path in options.measured:
        rows += measured_jobs(path)
    table = pd.DataFrame(rows)
    table["stage_ratio"] = (table.asked_mb - SNAKEMAKE_MB) / table.used_mb
    table["ratio"] = table.asked_mb / (table.used_mb + SNAKEMAKE_MB)
    write_table(options.out, table)
    print(table.round(2).to_string(index=False))


if __name__ == "__main__":
    main()
