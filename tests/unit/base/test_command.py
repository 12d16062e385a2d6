"""How a stage's command ends: by what its `run` raises."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.stopping import Stopped


@pytest.mark.parametrize(
    ("raised", "code", "printed"),
    [
        (InputError("a.csv: expected rows"), 1, "error: a.csv: expected rows\n"),
        (Stopped("stopped after 3 steps", signal.SIGTERM), 143, "stopped after 3 steps\n"),
        (Stopped("stopped after 3 steps", signal.SIGINT), 130, "stopped after 3 steps\n"),
    ],
)
def test_says_why_and_exits_with_a_code(monkeypatch, capsys, raised, code, printed):
    def run() -> None:
        raise raised

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as ended:
        run_as_command(run)
    assert ended.value.code == code
    assert capsys.readouterr().err == printed


def test_interrupts_end_a_stage_by_one_line_after_it_has_tidied_up(monkeypatch, capsys):
    """Two of them, as a terminal and Snakemake send: the second does not disturb what the first has begun."""
    tidied = []

    def run() -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        finally:
            os.kill(os.getpid(), signal.SIGINT)
            tidied.append(True)

    monkeypatch.setattr(sys, "argv", ["stage"])
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(SystemExit) as ended:
            run_as_command(run)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert (ended.value.code, tidied) == (128 + signal.SIGINT, [True])
    (line,) = capsys.readouterr().err.splitlines()
    assert "the same command starts anew" in line


def test_interrupts_that_are_ignored_stay_so(monkeypatch):
    def run() -> None:
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(sys, "argv", ["stage"])
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        run_as_command(run)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("words", [["--promise", "a=b"], ["--promise=a=b"], ["--estimate", "a=b"]])
def test_flag_under_its_old_name_is_understood(monkeypatch, words):
    seen = []

    def run(*, estimate: str) -> None:
        """Note it.

        Args:
            estimate: any text.
        """
        seen.append(estimate)

    monkeypatch.setattr(sys, "argv", ["stage", *words])
    run_as_command(run, renamed={"--promise": "--estimate"})
    assert seen == ["a=b"]


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (OSError(28, "No space left on device", "a.arrow"), "No space left on device: 'a.arrow'"),
        (MemoryError("Unable to allocate 1 TiB"), "out of memory: Unable to allocate 1 TiB"),
    ],
)
def test_what_the_system_refuses_is_one_line(monkeypatch, capsys, raised, said):
    def run() -> None:
        raise raised

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as ended:
        run_as_command(run)
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and said in line


def test_output_of_a_stage_is_locked_while_it_runs(monkeypatch, tmp_path):
    seen = []

    def run(*, out: Path, chunk: int) -> None:
        """Look.

        Args:
            out: folder.
            chunk: number.
        """
        seen.extend(path.name for path in tmp_path.iterdir())

    monkeypatch.setattr(sys, "argv", ["stage.py", "--out", str(tmp_path / "shards"), "--chunk", "3"])
    run_as_command(run)
    assert seen == [".shards.stage.0003.lock"]
    assert not list(tmp_path.iterdir())


def test_threads_that_cannot_start_are_want_of_memory(monkeypatch, capsys):
    def run() -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as ended:
        run_as_command(run)
    assert ended.value.code == 1
    assert capsys.readouterr().err.startswith("error: out of memory: can't start new thread;")


def test_other_runtime_errors_are_defects(monkeypatch):
    def run() -> None:
        raise RuntimeError("shapes differ")

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(RuntimeError, match="shapes differ"):
        run_as_command(run)


@pytest.mark.parametrize("mib", [6])
def test_trace_irradiance_with_little_memory_says_so_at_once(tmp_path, repo_root, mib):
    """Left to itself it stood still, in Arrow, or crashed, in Embree."""
    code = "import resource, psutil, pipeline.stages.trace_irradiance as stage\n"
    code += f"allowed = psutil.Process().memory_info().vms + ({mib} << 20)\n"
    code += "resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))\nstage.main()"
    words = [
        word for name in ("atlas", "tracking", "lights", "patterns", "frames", "out") for word in (f"--{name}", name)
    ]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=repo_root, capture_output=True, text=True, timeout=100
    )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert done.stderr.startswith("error: out of memory: expected at least 1024 MiB of address space"), done.stderr
