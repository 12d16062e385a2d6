"""A workflow that is asked to end by a signal to Snakemake alone, as batch systems do."""

from __future__ import annotations

import subprocess
import time

import psutil
import pytest

TARGET = "captures/tiny/capture.yaml"
PATIENCE_S = 300
"""Far more than the start of Snakemake takes: for machines that do much else."""

STAGE = """
import signal, sys, time
from pathlib import Path

def say(number, frame):
    Path("stopped").write_text("checkpoint written")
    sys.exit(143)

signal.signal(signal.SIGTERM, say)
Path("started").touch()
time.sleep(600)
"""
"""A stage that, as training does, writes something on SIGTERM and ends."""


@pytest.fixture
def running(copy_of_project, tmp_path):
    """A workflow whose first stage runs."""
    workflow = copy_of_project(tmp_path / "project").with_own_code()
    (workflow.folder / "pipeline/stages/synthesize_capture.py").write_text(STAGE)
    with open(tmp_path / "log", "w") as log:
        process = subprocess.Popen(workflow.command("--", TARGET), cwd=workflow.folder, stdout=log, stderr=log)
    last = time.monotonic() + PATIENCE_S
    while not (workflow.folder / "started").exists() and process.poll() is None and time.monotonic() < last:
        time.sleep(0.05)
    assert process.poll() is None, (tmp_path / "log").read_text()
    below = psutil.Process(process.pid).children(recursive=True)
    yield workflow.folder, process, below
    for left in [child for child in below if child.is_running()]:
        left.kill()
    process.kill()
    process.wait()


def test_sigterm_reaches_the_stage_and_snakemake_ends_after_it(running):
    folder, process, below = running
    process.terminate()
    assert process.wait(60) != 0
    assert (folder / "stopped").read_text() == "checkpoint written"
    assert not [child for child in below if child.is_running()]


def test_what_a_killed_run_had_locked_is_free_again(running):
    folder, process, below = running
    process.kill()
    process.wait()
    for left in [child for child in below if child.is_running()]:
        left.kill()
    assert list((folder / ".snakemake/locks").iterdir())
    (folder / "pipeline/stages/synthesize_capture.py").write_text("raise SystemExit('reached')")
    again = subprocess.run(process.args, cwd=folder, capture_output=True, text=True, check=False)
    said = again.stdout + again.stderr
    assert "LockException" not in said and "reached" in said
