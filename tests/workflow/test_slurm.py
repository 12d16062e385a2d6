"""The workflow on a real Slurm cluster of two nodes, with jobs that are cancelled and a node that is lost.

It takes minutes, most of which jobs wait to be looked at: `make slurm-test` runs it, `make test` leaves it out.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from contextlib import contextmanager
from datetime import datetime
from itertools import combinations

import pytest

from tests.support.workflow.slurm_cluster import SlurmCluster

pytestmark = [pytest.mark.slurm, pytest.mark.usefixtures("slurm"), pytest.mark.timeout(7200)]

TARGET = "results/tiny/metrics.csv"
PROFILE = ("--profile", "workflow/profiles/slurm", "--max-threads", "2", "--resources", "mem_mb=8000", "runtime=60")
"""The profile, and what its nodes have: two processors and 8 GB."""

DEADLINE_S = 1800
"""Six times what a run takes: for machines that do much else."""

CHUNKED = ("track_mesh", "trace_irradiance", "pack_shards")
"""Rules with a job for each of the three chunks."""

SHARED, IMAGES = ("inspect_images", "score_images"), "chunk_images: 12\n"
"""Rules that share the images of two and one chunks, of ten each; on one machine one job handles all."""


@pytest.fixture(scope="module")
def local(copy_of_project, stage_server, tmp_path_factory):
    """The project after a run in three chunks on this machine."""
    workflow = copy_of_project(tmp_path_factory.mktemp("local") / "project").with_stages_of(stage_server)
    workflow.append("config/subjects/tiny.yaml", "chunk_frames: 2\n")
    done = workflow.snakemake("--", TARGET)
    assert done.returncode == 0, done.stdout
    return workflow


class ClusterRun:
    """Snakemake, which hands the jobs of a project to a cluster."""

    def __init__(self, workflow, cluster, *words):
        self.folder, self.cluster = workflow.folder, cluster
        self.checkpoint = self.folder / "results/tiny/avatars/full/checkpoint.safetensors"
        self.log = self.folder / "snakemake.log"
        command = [sys.executable, "-m", "snakemake", *PROFILE, *words, "--", TARGET]
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                command, cwd=self.folder, env={**cluster.environment, "PYTHONPATH": str(self.folder)}, stdout=log,
                stderr=log,
            )  # fmt: skip

    def training_with_checkpoint(self):
        """The job that trains, as soon as it has written a checkpoint."""
        last = time.monotonic() + DEADLINE_S
        while not self.checkpoint.exists():
            assert self.process.poll() is None and time.monotonic() < last, self.log.read_text()
            time.sleep(0.02)
        return self.jobs("train_avatar")[-1]

    def jobs(self, rule):
        """The cluster's jobs of a rule, in the order in which they were handed in."""
        return [job for job in self.cluster.jobs() if re.match(rf"rule_{rule}(_|$)", job.rule)]

    def finish(self):
        """What was printed by the run, which has to succeed."""
        code = self.process.wait(DEADLINE_S)
        assert code == 0, self.log.read_text()
        return self.log.read_text()


@contextmanager
def started(workflow, cluster, *words):
    """A run that is ended with its block."""
    run = ClusterRun(workflow, cluster, *words)
    try:
        yield run
    finally:
        run.process.terminate()
        run.process.wait(DEADLINE_S)


@pytest.fixture(scope="module")
def cancelled(local, copy_of_project, tmp_path_factory):
    """A run on two nodes from nothing, whose training was cancelled: the run, and the jobs of each rule."""
    workflow = copy_of_project(tmp_path_factory.mktemp("slurm") / "project")
    workflow.append("config/subjects/tiny.yaml", f"chunk_frames: 2\n{IMAGES}")
    with SlurmCluster(tmp_path_factory.mktemp("cluster")) as cluster, started(workflow, cluster) as run:
        cluster.run("scancel", run.training_with_checkpoint().number)
        run.finish()
        yield workflow, {rule: run.jobs(rule) for rule in (*CHUNKED, *SHARED, "train_avatar", "evaluate_avatar")}


def metrics(workflow):
    return (workflow.folder / TARGET).read_bytes()


def training_log(workflow):
    return (workflow.folder / "results/tiny/logs/train_avatar.full.log").read_text()


def side_by_side(jobs):
    """Pairs of nodes, or twice the same, on which two of the jobs ran at the same time."""
    times = [(job.node, *(datetime.fromisoformat(each) for each in (job.started, job.ended))) for job in jobs]
    return {(a[0], b[0]) for a, b in combinations(times, 2) if a[1] < b[2] and b[1] < a[2]}


def test_two_nodes_give_the_bytes_of_one_machine(local, cancelled):
    assert metrics(cancelled[0]) == metrics(local)


def test_chunks_run_on_both_nodes_side_by_side(cancelled):
    pairs = {}
    for rule in CHUNKED:
        jobs = cancelled[1][rule]
        assert [job.state for job in jobs] == ["COMPLETED"] * 3, jobs
        pairs[rule] = side_by_side(jobs)
    assert all(pairs.values()), pairs
    # Two processors hold two of the three chunks, unless what was before them kept one node.
    assert any(first != second for found in pairs.values() for first, second in found), pairs


def test_two_jobs_share_the_images(cancelled):
    for rule in SHARED:
        assert [job.state for job in cancelled[1][rule]] == ["COMPLETED"] * 2, rule


def test_cancelled_training_goes_on_from_its_checkpoint(cancelled):
    workflow, jobs = cancelled
    assert [job.state for job in jobs["train_avatar"]] == ["CANCELLED", "COMPLETED"]
    assert [job.state for job in jobs["evaluate_avatar"]] == ["COMPLETED"]
    assert int(re.search(r"continuing after (\d+) steps", training_log(workflow))[1]) >= 10


def test_training_goes_on_after_its_node_is_lost(local, cancelled, tmp_path):
    workflow = cancelled[0].copied(tmp_path / "project")
    with SlurmCluster(tmp_path / "cluster") as cluster, started(workflow, cluster, "--forcerun", "train_avatar") as run:
        lost = run.training_with_checkpoint()
        cluster.lose_node(lost.node)
        run.finish()
        first, second = run.jobs("train_avatar")
    assert (first.state, second.state) == ("NODE_FAIL", "COMPLETED")
    assert first.node == lost.node != second.node
    assert int(re.search(r"continuing after (\d+) steps", training_log(workflow))[1]) >= 10
    assert metrics(workflow) == metrics(local)


def test_training_on_two_nodes_is_a_job_of_the_workflow(local, cancelled, tmp_path):
    """Of one process each, which does whole steps: to the bytes of one machine."""
    workflow = cancelled[0].copied(tmp_path / "project")
    words = ("--forcerun", "train_avatar", "--config", "training_nodes=2", "training_processes=1")
    with SlurmCluster(tmp_path / "cluster") as cluster, started(workflow, cluster, *words) as run:
        run.finish()
        (job,) = run.jobs("train_avatar")
    assert (job.state, job.node) == ("COMPLETED", "n[1-2]")
    assert metrics(workflow) == metrics(local)
