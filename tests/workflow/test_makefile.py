"""What make hands on to Snakemake, and what it runs itself."""

from __future__ import annotations

import os
import subprocess

import pytest


@pytest.mark.parametrize(
    ("target", "command"),
    [
        ("results/subjectA/metrics.csv", "snakemake --cores 2  -- 'results/subjectA/metrics.csv'"),
        ("results/subjectA/report", "snakemake --cores 2  -- 'results/subjectA/report/index.html'"),
        ("results/subjectA/report/index.html", "snakemake --cores 2  -- 'results/subjectA/report/index.html'"),
        ("scaling", "python -m benchmarks.bench_scaling --out results/scaling"),
        ("growth", "python -m benchmarks.bench_scaling --out results/scaling"),
        ("effects", "python -m benchmarks.bench_effects --out results/effects_comparison.csv"),
    ],
)
def test_target_ends_in_one_command(repo_root, target, command):
    # Tests may themselves be run by make, whose flags a make below it would take over.
    own = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    done = subprocess.run(["make", "--dry-run", target], cwd=repo_root, env=own, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith(command)
    assert done.stdout.count("snakemake --cores") + done.stdout.count("-m benchmarks.") == 1
