"""Tests of a copy of the project in a forked child, which finds the libraries imported."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import re
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

POLL_S = 0.02

OWN = ("pipeline", "tests", "docs", "benchmarks")
"""Packages of the project: a child imports its own, from the copy."""

FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


@dataclass(frozen=True)
class Tried:
    """How tests ended: pytest's exit code, None if they had to be ended; seconds; the first that failed; output."""

    code: int | None
    seconds: float
    failed: str
    printed: str


def prepare(libraries: Iterable[str]) -> None:
    """Import what tests work with, once, and nothing of the project itself."""
    for name in ("pytest", *libraries):
        importlib.import_module(name)
    gc.collect()
    gc.freeze()  # A child that collected what it shares with this process would copy it all.


def run_tests(copy: Path, tests: list[str], scratch: Path, allowed_s: float, own_kernels: bool = False) -> Tried:
    """Run tests of a copy up to the first that fails.

    Args:
        copy: of the project; the working folder.
        tests: files, folders or names.
        scratch: for the tests' files and the log; it is emptied.
        allowed_s: after which everything that was started is ended. What this process does not see, as it is paused
            together with its children, does not count.
        own_kernels: keep compiled kernels with the scratch, not with the copy.
    """
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    log, began = scratch / "log", time.monotonic()
    sys.stdout.flush()
    pid = os.fork()
    if not pid:
        _child(copy, tests, scratch, log, own_kernels)
    waited, code = 0.0, None
    while waited < allowed_s:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            code = os.waitstatus_to_exitcode(status)
            break
        time.sleep(POLL_S)
        waited += POLL_S
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # Also what the tests have left running.
    if code is None:
        os.waitpid(pid, 0)
    printed = log.read_text(errors="replace")
    failed = FAILED.search(printed)
    return Tried(code, time.monotonic() - began, failed.group(1) if failed else "", printed)


def _child(copy: Path, tests: list[str], scratch: Path, log: Path, own_kernels: bool) -> None:
    """Run pytest in this process, which ends with its exit code."""
    code = 70
    try:
        os.setsid()
        descriptor = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o666)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        _enter(copy)
        if own_kernels:
            import numba

            os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = str(scratch / "kernels")
        import pytest

        options = ["-x", "-q", "--tb=line", "-p", "no:cacheprovider", "-p", "no:xdist", "--basetemp", f"{scratch}/tmp"]
        code = int(pytest.main([*options, *tests]))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def _enter(copy: Path) -> None:
    """Make a copy of the project the one that this process and those it starts import."""
    for name in [name for name in sys.modules if name.partition(".")[0] in OWN]:
        del sys.modules[name]
    os.chdir(copy)
    inherited = [path for path in sys.path if path and not (Path(path) / "pipeline").is_dir()]
    sys.path[:] = [str(copy), *inherited]
    os.environ["PYTHONPATH"] = str(copy)
    importlib.invalidate_caches()
