"""A workflow that is asked to end: by a signal to Snakemake alone, to its stage, or to all; and one that was killed."""

from __future__ import annotations

import os
import signal
import time
from itertools import product

import psutil
import pytest

from pipeline.workflow.termination import running_stages

TARGET = "captures/tiny/capture.yaml"
PATIENCE_S = 300
"""Far more than the start of Snakemake takes: for machines that do much else."""

STAGE = """
import signal, sys, time
from pathlib import Path

def stop(number, frame):
    for other in SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    time.sleep(0.3)
    with open("checkpoints", "a") as file:
        file.write(f"{number}\\n")
    sys.exit(128 + number)

SIGNALS = (signal.SIGTERM, signal.SIGINT)
for number in SIGNALS:
    signal.signal(number, stop)
with open("starts", "a") as file:
    file.write("start\\n")
time.sleep(600)
"""
"""A stage that, as training does, finishes and writes something on the first signal, and then ends."""


class Running:
    """A workflow whose only stage runs, until the block ends."""

    def __init__(self, workflow, starts):
        self.server, self.log = workflow.server, workflow.folder / "log"
        self.pid = self.server.start(["--cores", "2", "--", TARGET], workflow.folder, self.log)
        file, last = workflow.folder / "starts", time.monotonic() + PATIENCE_S
        while not (file.exists() and file.read_text().count("\n") == starts):
            assert time.monotonic() < last and psutil.Process(self.pid).status() != "zombie", self.log.read_text()
            time.sleep(0.05)
        self.below = psutil.Process(self.pid).children(recursive=True)

    def left(self):
        return [child for child in self.below if child.is_running() and child.status() != "zombie"]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self.left():
            process.kill()


@pytest.fixture
def workflow(copy_of_project, tmp_path):
    workflow = copy_of_project(tmp_path / "project").with_own_code()
    (workflow.folder / "pipeline/stages/synthesize_capture.py").write_text(STAGE)
    return workflow


def test_signals_to_anybody_end_all_and_the_same_command_goes_on(workflow):
    cases = list(product(("Snakemake", "the stage", "all"), (signal.SIGTERM, signal.SIGINT)))
    for starts, (whom, number) in enumerate(cases, 1):
        with Running(workflow, starts) as running:
            if whom == "all":
                os.killpg(running.pid, number)
            else:
                pids = [running.pid] if whom == "Snakemake" else [stage.pid for stage in running_stages(running.pid)]
                for pid in pids:
                    os.kill(pid, number)
            assert running.server.wait() != 0
            told = (workflow.folder / "checkpoints").read_text().split()
            assert told == [str(int(signalled)) for _, signalled in cases[:starts]], whom
            assert not running.left(), whom
            assert "Traceback" not in running.log.read_text(), running.log.read_text()
    said = goes_on(workflow)
    assert "LockException" not in said and "reached" in said


def test_what_a_killed_run_had_locked_is_free_again(workflow):
    with Running(workflow, 1) as running:
        os.kill(running.pid, signal.SIGKILL)
        running.server.wait()
    assert list((workflow.folder / ".snakemake/locks").iterdir())
    said = goes_on(workflow)
    assert "LockException" not in said and "reached" in said


def goes_on(workflow):
    """What the same command prints, whose stage says that it is run again."""
    (workflow.folder / "pipeline/stages/synthesize_capture.py").write_text("raise SystemExit('reached')")
    return workflow.snakemake("--", TARGET).stdout
