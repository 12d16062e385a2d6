"""A job on a Slurm cluster that is cancelled, or whose time is up: it writes where it is, ends, and goes on later.

The stage is a short one, so what is measured is what Slurm, its plugin and the rules make of a signal; `test_slurm.py`
cancels a training. It takes two minutes: `make slurm-test` runs it, `make test` leaves it out.
"""

from __future__ import annotations

import subprocess
import sys
import time

import psutil
import pytest

from tests.support.workflow.slurm_cluster import SlurmCluster

pytestmark = [pytest.mark.slurm, pytest.mark.usefixtures("slurm"), pytest.mark.timeout(1800)]

TARGET = "captures/tiny/capture.yaml"
PROFILE = ("--profile", "workflow/profiles/slurm", "--max-threads", "2", "--resources", "mem_mb=8000", "runtime=60")
DEADLINE_S = 600
"""Ten times what a run takes: for machines that do much else."""

STAGE = """
import signal, sys, time
from pathlib import Path

def stop(number, frame):
    for other in SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    time.sleep(1)
    Path("checkpoint").write_text(str(number))
    sys.exit(128 + number)

SIGNALS = (signal.SIGTERM, signal.SIGINT)
for number in SIGNALS:
    signal.signal(number, stop)
if Path("checkpoint").exists():
    out = Path(sys.argv[sys.argv.index("--out") + 1])
    out.mkdir(parents=True, exist_ok=True)
    (out / "capture.yaml").write_text("goes on")
    sys.exit()
Path("started").touch()
time.sleep(600)
"""
"""A stage that, as training does, writes where it is on the first signal, and goes on from there afterwards."""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with SlurmCluster(tmp_path_factory.mktemp("cluster"), nodes=1) as cluster:
        yield cluster


def cancel(cluster, number):
    cluster.run("scancel", number)


def end_its_time(cluster, number):
    """Slurm counts limits in minutes; it looks after them every half one."""
    assert not cluster.run("scontrol", "update", f"jobid={number}", "timelimit=1")


@pytest.mark.parametrize(("stop", "state"), [(cancel, "CANCELLED"), (end_its_time, "TIMEOUT")])
def test_stopped_job_leaves_a_checkpoint_and_nothing_running_and_goes_on(
    copy_of_project, cluster, tmp_path, stop, state
):
    workflow = copy_of_project(tmp_path / "project").with_own_code()
    (workflow.folder / "pipeline/stages/synthesize_capture.py").write_text(STAGE)
    before = {job.number for job in cluster.jobs()}
    command = [sys.executable, "-m", "snakemake", *PROFILE, "--", TARGET]
    log = tmp_path / "log"
    with open(log, "w") as output:
        run = subprocess.Popen(
            command, cwd=workflow.folder, env={**cluster.environment, "PYTHONPATH": str(workflow.folder)},
            stdout=output, stderr=output,
        )  # fmt: skip
    try:
        wait(lambda: (workflow.folder / "started").exists() or run.poll() is not None)
        assert run.poll() is None, log.read_text()
        (first,) = [job for job in cluster.jobs() if job.number not in before]
        stop(cluster, first.number)
        wait(lambda: job_of(cluster, first.number).state == state)
        assert (workflow.folder / "checkpoint").read_text() == "15"
        assert not running(cluster, first.number)
        assert run.wait(DEADLINE_S) == 0, log.read_text()
    finally:
        run.terminate()
        run.wait(DEADLINE_S)
    assert (workflow.folder / TARGET).read_text() == "goes on"
    states = [job.state for job in cluster.jobs() if job.number not in before]
    assert states == [state, "COMPLETED"]


def wait(done):
    last = time.monotonic() + DEADLINE_S
    while not done():
        assert time.monotonic() < last
        time.sleep(0.1)


def job_of(cluster, number):
    return next(job for job in cluster.jobs() if job.number == number)


def running(cluster, number):
    """Processes of a job, found by their environment."""
    found = []
    for process in psutil.process_iter():
        try:
            variables = process.environ()
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
        ours = variables.get("SLURM_CONF") == cluster.environment["SLURM_CONF"]
        if ours and variables.get("SLURM_JOB_ID") == number and process.status() != "zombie":
            found.append(process.cmdline())
    return found
