"""One training on two nodes of a Slurm cluster: the bytes of one process, lost processes, cancelled jobs, lost nodes.

The avatar is a small sheet; `test_slurm.py` has the workflow. It takes two minutes: `make slurm-test` runs it, `make
test` leaves it out.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time

import psutil
import pytest

from pipeline.config.flags import flags
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet_subject import sheet_frames, sheet_images, stage_arguments, write_subject
from tests.support.workflow.slurm_cluster import SlurmCluster

pytestmark = [pytest.mark.slurm, pytest.mark.usefixtures("slurm"), pytest.mark.timeout(1800)]

SETTINGS = TrainAvatar(
    shading="transfer", deferred="on",
    steps=400, steps_together=2, cameras_per_step=3, checkpoint_every=40, log_every=1, preview_every=0, device="cpu",
)  # fmt: skip
"""Two steps together: each of two processes does one of them whole, so nothing is summed in another order."""

DEADLINE_S = 300
"""Ten times what a training takes: for machines that do much else."""

ON_TWO = "--nodes=2 --ntasks=2 --ntasks-per-node=1 --cpus-per-task=1"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Three nodes, of which one may be lost."""
    with SlurmCluster(tmp_path_factory.mktemp("cluster"), nodes=3) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheet")
    write_subject(folder, sheet_images(sheet_frames(), (-0.2, -0.1, 0.1, 0.2)), shadow=True)
    return folder


def command(subject, out):
    words = [word for name, value in stage_arguments(subject).items() for word in (f"--{name}", str(value))]
    words += [*flags(SETTINGS), "--out", str(out), "--processes", "1"]
    return [sys.executable, "-m", "pipeline.stages.train_avatar", *words]


@pytest.fixture(scope="module")
def alone(subject, repo_root):
    """The avatar of one process on this machine."""
    out = subject / "alone"
    subprocess.run(command(subject, out), cwd=repo_root, env={**os.environ, "OMP_NUM_THREADS": "1"}, check=True)
    return (out / "avatar.safetensors").read_bytes()


class Training:
    """A job that trains on two nodes."""

    def __init__(self, cluster, subject, out, repo_root):
        self.cluster, self.out = cluster, out
        self.log = out.parent / f"{len(list(out.parent.glob('*.log')))}.log"
        self.environment = {**cluster.environment, "PYTHONPATH": str(repo_root), "OMP_NUM_THREADS": "1"}
        wrapped = f"srun {ON_TWO} --kill-on-bad-exit=1 {shlex.join(command(subject, out))}"
        words = f"--parsable --no-requeue --mem=4000 {ON_TWO} --output={self.log}".split()
        words += [f"--chdir={repo_root}", f"--wrap={wrapped}"]
        done = subprocess.run(["sbatch", *words], env=self.environment, capture_output=True, text=True, check=True)
        self.number = done.stdout.strip()

    @property
    def state(self):
        (job,) = [job for job in self.cluster.jobs() if job.number == self.number]
        return job.state

    def wait_for_checkpoint(self):
        self._wait(lambda: (self.out / "checkpoint.safetensors").exists())
        assert self.state == "RUNNING", self.log.read_text()

    def ended(self):
        """The state in which it ends."""
        self._wait(lambda: self.state not in ("PENDING", "RUNNING", "COMPLETING"))
        return self.state

    def processes(self):
        """Those that train, by their rank."""
        found = {}
        for process in psutil.process_iter():
            try:
                variables = process.environ()
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
            if variables.get("SLURM_JOB_ID") == self.number and "RANK" in variables:
                found[int(variables["RANK"])] = process
        return found

    def printed(self):
        return self.log.read_text()

    def _wait(self, ready):
        last = time.monotonic() + DEADLINE_S
        while not ready():
            assert time.monotonic() < last, self.printed()
            time.sleep(0.02)


@pytest.fixture
def train(cluster, subject, repo_root, tmp_path):
    """A function: starts a training; its folder is the same each time."""
    return lambda: Training(cluster, subject, tmp_path / "avatar", repo_root)


def continued(printed):
    return [int(step) for step in re.findall(r"continuing after (\d+) steps", printed)]


def test_two_nodes_give_the_bytes_of_one_process(alone, train):
    job = train()
    assert job.ended() == "COMPLETED", job.printed()
    assert "2 x cpu" in job.printed() and not continued(job.printed())
    assert (job.out / "avatar.safetensors").read_bytes() == alone


@pytest.mark.parametrize("rank", [0, 1])
def test_lost_process_is_started_again_from_the_checkpoint(alone, train, rank):
    job = train()
    job.wait_for_checkpoint()
    job.processes()[rank].kill()
    assert job.ended() == "COMPLETED", job.printed()
    assert continued(job.printed())[0] >= SETTINGS.checkpoint_every
    assert (job.out / "avatar.safetensors").read_bytes() == alone


def test_signal_lets_all_write_where_they_are_and_the_next_job_goes_on(alone, train):
    """As `--signal=TERM@120` sends it before the time is up: to what srun has started, and not to srun."""
    job = train()
    job.wait_for_checkpoint()
    job.cluster.run("scancel", "--signal=TERM", job.number)
    assert job.ended() == "FAILED"
    stopped = re.search(r"stopped after (\d+) of 400 steps", job.printed())
    assert stopped, job.printed()
    again = train()
    assert again.ended() == "COMPLETED", again.printed()
    assert continued(again.printed()) == [int(stopped[1])]
    assert (again.out / "avatar.safetensors").read_bytes() == alone


def test_job_after_a_cancelled_one_goes_on_from_the_checkpoint(alone, train):
    """srun, which is cancelled too, lets nothing finish its round."""
    job = train()
    job.wait_for_checkpoint()
    job.cluster.run("scancel", job.number)
    assert job.ended() == "CANCELLED"
    again = train()
    assert again.ended() == "COMPLETED", again.printed()
    assert continued(again.printed())[0] >= SETTINGS.checkpoint_every
    assert (again.out / "avatar.safetensors").read_bytes() == alone


def test_job_of_a_lost_node_fails_and_the_next_goes_on_on_others(alone, train):
    job = train()
    job.wait_for_checkpoint()
    job.cluster.lose_node("n2")
    assert job.ended() in ("NODE_FAIL", "FAILED"), job.printed()
    again = train()
    assert again.ended() == "COMPLETED", again.printed()
    assert continued(again.printed())[0] >= SETTINGS.checkpoint_every
    assert (again.out / "avatar.safetensors").read_bytes() == alone
