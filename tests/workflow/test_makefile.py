"""What make hands on to Snakemake, and what it runs itself."""

from __future__ import annotations

import os
import subprocess

import pytest


@pytest.fixture
def dry_run(repo_root):
    """Everything that make would run for its arguments."""
    # Tests may themselves be run by make, whose flags a make below it would take over.
    own = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}

    def run(*arguments: str) -> str:
        command = ["make", "--dry-run", *arguments]
        done = subprocess.run(command, cwd=repo_root, env=own, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.mark.parametrize(
    ("target", "command"),
    [
        ("results/subjectA/metrics.csv", "snakemake --cores 2  -- 'results/subjectA/metrics.csv'"),
        ("results/subjectA/viewer", "snakemake --cores 2  -- 'results/subjectA/viewer/index.html'"),
        ("results/subjectA/report", "snakemake --cores 2  -- 'results/subjectA/report/index.html'"),
        ("results/subjectA/report/index.html", "snakemake --cores 2  -- 'results/subjectA/report/index.html'"),
        ("scaling", "python -m benchmarks.bench_scaling --out results/scaling"),
        ("growth", "python -m benchmarks.bench_scaling --out results/scaling"),
        ("docs", "python -m mkdocs build --strict"),
        ("effects", "--jobs 2 --out results/effects_comparison.csv"),
    ],
)
def test_target_ends_in_one_command(dry_run, target, command):
    printed = dry_run(target)
    assert printed.strip().endswith(command)
    assert sum(printed.count(run) for run in ("snakemake --cores", "-m benchmarks.", "-m mkdocs")) == 1


def test_detector_of_a_fresh_copy_is_installed_from_its_own_list(dry_run):
    """Without Snakemake, which has no rule for the list."""
    printed = dry_run("--always-make", "detect")
    assert "-m pip install --requirement .venv-detect/requirements.txt" in printed
    assert "envs/detect.yaml > .venv-detect/requirements.txt" in printed
    assert "snakemake" not in printed


@pytest.mark.parametrize("changed", ["pyproject.toml", "envs/lock.txt", "envs/lock-cuda.txt"])
def test_changed_requirement_or_lock_installs_the_first_lock_that_pip_can(dry_run, changed):
    printed = dry_run("--what-if", changed, ".venv/.ready").replace("\\\n", " ")
    installs = [line for line in printed.splitlines() if "pip install" in line]
    locks, project = installs
    tried = [part.split("-r ")[1].strip() for part in locks.split("||")[:-1]]
    assert tried == ["envs/lock.txt", "envs/lock-cuda.txt"]
    assert locks.count("--require-hashes") == 2 and "false" in locks.split("||")[-1]
    assert "--no-deps --no-build-isolation --editable ." in project


def test_locks_to_install_can_be_chosen(dry_run):
    printed = dry_run("LOCKS=envs/lock-cuda.txt", "--what-if", "pyproject.toml", ".venv/.ready")
    assert printed.count("--require-hashes") == 1
    assert "-r envs/lock-cuda.txt" in printed


def test_lock_runs_the_script_that_makes_them(dry_run):
    assert dry_run("lock", "UPGRADE=--upgrade").strip().endswith(".ci/lock_versions.py --upgrade")
