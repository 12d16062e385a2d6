"""Children that fail, stand still or take too long, and a watchdog that says where a process stands."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import psutil
import pytest

from pipeline.base import watchdog
from pipeline.base.watched_child import ChildFailed, processor_seconds, run_watched

PATIENCE_S = 60
"""Until a killed process is gone, on a machine that does much else."""


def child(code: str, *arguments: str) -> list[str]:
    return [sys.executable, "-c", code, *arguments]


def test_child_that_ends_well_leaves_its_result(tmp_path) -> None:
    run_watched(child("import sys; open(sys.argv[1], 'w').write('done')", str(tmp_path / "result")))
    assert (tmp_path / "result").read_text() == "done"


def test_child_that_fails_is_not_repeated(tmp_path) -> None:
    code = "import sys; open(sys.argv[1], 'a').write('x'); sys.exit('no such mesh')"
    with pytest.raises(ChildFailed, match=r"found 1:\nno such mesh"):
        run_watched(child(code, str(tmp_path / "starts")))
    assert (tmp_path / "starts").read_text() == "x"


def test_child_that_stands_still_once_is_started_again(tmp_path) -> None:
    code = (
        "import pathlib, sys, time\npath = pathlib.Path(sys.argv[1])\nseen = path.exists()\npath.touch()\n"
        "time.sleep(0 if seen else 1000)"
    )
    start = time.monotonic()
    run_watched(child(code, str(tmp_path / "seen")), stall_s=1.0)
    assert time.monotonic() - start < 60


def assert_end(pids) -> None:
    """Hold that processes have ended, or do as soon as they get to run: SIGKILL ends none before its turn."""
    until = time.monotonic() + PATIENCE_S
    while alive := [pid for pid in pids if is_running(pid)]:
        assert time.monotonic() < until, alive
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_stuck_children_are_ended_with_all_that_they_started(tmp_path) -> None:
    code = (
        "import subprocess, sys, time\n"
        "print(subprocess.Popen(['sleep', '1000']).pid, file=open(sys.argv[1], 'a'))\ntime.sleep(1000)"
    )
    with pytest.raises(ChildFailed, match="no processor time for 1 s, 2 times"):
        run_watched(child(code, str(tmp_path / "pids")), stall_s=1.0)
    pids = [int(line) for line in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 2
    assert_end(pids)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_child_ends_with_a_parent_that_is_ended(tmp_path, repo_root, number) -> None:
    path = tmp_path / "pid"
    inner = f"import os, time; open({str(path)!r}, 'w').write(f'{{os.getpid()}}\\n'); time.sleep(1000)"
    code = "import sys\nfrom pipeline.base.watched_child import run_watched\n"
    code += f"run_watched([sys.executable, '-c', {inner!r}])"
    with subprocess.Popen(child(code), cwd=repo_root) as parent:
        while not (path.exists() and path.read_text()):
            assert parent.poll() is None
            time.sleep(0.02)
        parent.send_signal(number)
    assert_end([int(path.read_text())])


def test_busy_child_is_ended_at_its_limit() -> None:
    with pytest.raises(ChildFailed, match="longer than 2 s, 1 times"):
        run_watched(child("while True: pass"), stall_s=30.0, limit_s=2.0, attempts=1)


def test_processor_time_counts_what_children_use() -> None:
    before = processor_seconds(os.getpid())
    subprocess.run(child("import time\nwhile time.process_time() < 0.3: pass"), check=True)
    assert processor_seconds(os.getpid()) - before > 0.25
    assert processor_seconds(2**22 + 1) == 0.0


def test_process_that_stands_still_prints_its_stack() -> None:
    code = (
        "import sys, time\nfrom pipeline.base.watchdog import watched\n"
        "def waits_for_ever():\n    time.sleep(4)\nwith watched(sys.stderr, 1.0): waits_for_ever()"
    )
    printed = subprocess.run(child(code), capture_output=True, text=True, check=True).stderr
    assert "in waits_for_ever" in printed


def test_what_holds_the_interpreters_lock_is_seen_too() -> None:
    """From 0.5 to 2.5 s; the timer goes off 0.8 and 1.6 s after the last look before that."""
    code = (
        "import ctypes, sys, time\nfrom pipeline.base.watchdog import watched\n"
        "def holds_the_lock():\n    time.sleep(0.5)\n    ctypes.PyDLL(None).sleep(2)\n"
        "with watched(sys.stderr, 0.4): holds_the_lock()"
    )
    printed = subprocess.run(child(code), capture_output=True, text=True, check=True).stderr
    assert "in holds_the_lock" in printed


def test_stacks_are_printed_after_silence_and_not_while_there_is_work(monkeypatch) -> None:
    """Looks, a second from each to the next, see no work for three seconds once."""
    looks = iter([0.0, 10.0, 10.01, 10.02, 10.03, 20.0, 20.01])
    printed, timers, ended, used = [], [], threading.Event(), []

    def look(pid: int) -> float:
        used.append(next(looks))
        if len(used) == 7:
            ended.set()
        return used[-1]

    clock = SimpleNamespace(monotonic=lambda: float(len(used)), thread_time=lambda: 0.0)
    monkeypatch.setattr(watchdog, "processor_seconds", look)
    monkeypatch.setattr(watchdog, "time", clock)
    monkeypatch.setattr(watchdog.faulthandler, "dump_traceback", lambda output: printed.append(used[-1]))
    monkeypatch.setattr(watchdog.faulthandler, "dump_traceback_later", lambda after, **_: timers.append(after))
    monkeypatch.setattr(ended, "wait", lambda seconds: None)
    watchdog._look_after(sys.stderr, 3.0, ended)
    assert printed == [10.03]
    assert timers == 7 * [watchdog.HELD * 3.0]
