"""Locks of killed runs: gone where nobody can hold them, kept where somebody may."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from pipeline.workflow import dead_runs

RUN = """
import sys, time
from pathlib import Path
from pipeline.workflow.dead_runs import remove_dead_locks
remove_dead_locks(Path(sys.argv[1]))
(Path(sys.argv[1]) / "locks").mkdir(exist_ok=True)
(Path(sys.argv[1]) / "locks/0.output.lock").write_text("results/a")
print("locked", flush=True)
time.sleep(600)
"""


@pytest.fixture
def run(tmp_path):
    """Another run, which holds a lock of Snakemake's on a file."""
    process = subprocess.Popen([sys.executable, "-c", RUN, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "locked\n"
    yield process
    process.kill()
    process.communicate()


@pytest.fixture(autouse=True)
def give_up(monkeypatch):
    """Give up this process' own locks after a test."""
    monkeypatch.setattr(dead_runs, "_held", [])
    yield
    for descriptor in dead_runs._held:
        os.close(descriptor)


def test_locks_go_with_their_holder_and_not_before(run, tmp_path):
    lock = tmp_path / "locks/0.output.lock"
    assert not dead_runs.remove_dead_locks(tmp_path) and lock.exists()
    os.close(dead_runs._held.pop())
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert dead_runs.remove_dead_locks(tmp_path) and not lock.exists()
    assert not dead_runs.remove_dead_locks(tmp_path)


def test_locks_of_another_machine_stay(run, tmp_path, monkeypatch):
    run.kill()
    run.wait()
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(dead_runs.socket, "gethostname", lambda: "elsewhere")
        assert not dead_runs.remove_dead_locks(tmp_path)
        os.close(dead_runs._held.pop())
    assert not dead_runs.remove_dead_locks(tmp_path), "the other machine's run may have locked files since"
    assert (tmp_path / "locks/0.output.lock").exists()


def test_a_folder_that_cannot_be_written_to_is_left_alone(tmp_path):
    (tmp_path / "file").write_text("")
    assert not dead_runs.remove_dead_locks(tmp_path / "file")
