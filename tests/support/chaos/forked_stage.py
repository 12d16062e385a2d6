"""A stage's command in a forked child: without the seconds of importing, with limits, and killed at any write.

This process imports the libraries and the stages' modules once (`prepare`); a child runs a stage as `python -m` does.
"""

from __future__ import annotations

import gc
import importlib
import os
import resource
import runpy
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TextIO

from pipeline import STAGES
from tests.support.workflow.stage_server import LIBRARIES

ALLOWED_S = 300.0
"""Seconds that a stage of tiny may take, ten times what the longest takes on a busy core."""

POLL_S = 0.01

MOST_BYTES = 16 << 30
"""Address space of a stage: more than any needs of tiny, and less than would bring the machine down."""

WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
CHANGES = {"os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "os.link", "os.symlink", "shutil.rmtree"}
"""Names that Python audits changes of the file system under (https://docs.python.org/3/library/audit_events.html)."""


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (minus the signal's number), what it printed, and whether it had to be ended."""

    code: int
    printed: str
    hung: bool = False

    @property
    def defect(self) -> bool:
        """True if it ended by an exception or a signal."""
        return self.code < 0 or "Traceback (most recent call last)" in self.printed


def prepare() -> None:
    """Import what stages work with, once."""
    # Python's own folder may be closed to a child: a codec is imported when a file is first opened with it.
    for name in (*LIBRARIES, "encodings.utf_8_sig", "snakemake.cli", *(f"pipeline.stages.{stage}" for stage in STAGES)):
        importlib.import_module(name)
    gc.collect()
    gc.freeze()  # A child that collected what it shares with this process would copy it all.


@dataclass(frozen=True)
class Started:
    """A forked stage that is running."""

    pid: int
    log: Path

    def ended(self, allowed_s: float = ALLOWED_S) -> Ended:
        """Wait for the end, and end it after a while. What this process does not see, as it is paused, is no wait."""
        waited = 0.0
        while True:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return Ended(os.waitstatus_to_exitcode(status), self.printed())
            time.sleep(POLL_S)
            waited += POLL_S
            if waited > allowed_s:
                os.killpg(self.pid, signal.SIGKILL)
                os.waitpid(self.pid, 0)
                return Ended(-signal.SIGKILL, self.printed(), hung=True)

    def printed(self) -> str:
        """What it has printed so far."""
        return self.log.read_text(errors="replace")


def start(stage: str, words: Sequence[str], folder: Path, before: Callable[[], None] | None = None) -> Started:
    """Start `python -m pipeline.stages.STAGE WORDS` in a folder.

    Args:
        stage: its module's name.
        words: of its command line.
        folder: the working folder.
        before: run in the child first: limits, environment, hooks.
    """
    return _forked(lambda: _run_module(f"pipeline.stages.{stage}", words, before), folder, folder / f".{stage}.log")


def start_snakemake(words: Sequence[str], folder: Path, python: str = sys.executable) -> Started:
    """Start `PYTHON -m snakemake WORDS` in a folder; its jobs are started with that Python, too."""

    def call() -> int:
        import snakemake.cli

        sys.executable, sys.path[0] = python, str(folder)
        snakemake.cli.main(["--cores", "2", *words])
        return 0

    return _forked(call, folder, folder / ".snakemake.log")


def _forked(call: Callable[[], int], folder: Path, log: Path) -> Started:
    """A child, with a group of its own, that calls a function in a folder and exits with what that returns."""
    descriptor = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o666)
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if not pid:
        code = 1
        try:
            os.setsid()
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            for target in (1, 2):
                os.dup2(descriptor, target)
            sys.stdout = _printer(1, "replace")
            sys.stderr = sys.__stderr__ = _printer(2, "backslashreplace")
            os.chdir(folder)
            code = _exit_code(call)
        finally:
            os._exit(code)
    os.close(descriptor)
    return Started(pid, log)


def run(
    stage: str,
    words: Sequence[str],
    folder: Path,
    before: Callable[[], None] | None = None,
    allowed_s: float = ALLOWED_S,
) -> Ended:
    """The ended command of `start`."""
    return start(stage, words, folder, before).ended(allowed_s)


def _printer(descriptor: int, errors: str) -> TextIO:
    return os.fdopen(descriptor, "w", encoding="utf-8", errors=errors, closefd=False)


def _exit_code(call: Callable[[], int]) -> int:
    code = 1
    try:
        code = call()
    except SystemExit as stopped:
        code = stopped.code if isinstance(stopped.code, int) else int(stopped.code is not None)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def _run_module(module: str, words: Sequence[str], before: Callable[[], None] | None) -> int:
    """Run a module as `python -m` does."""
    sys.argv = [find_spec(module).origin, *words]
    sys.modules.pop(module, None)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    if before is not None:
        before()
    runpy.run_module(module, run_name="__main__", alter_sys=True)
    return 0


def count_changes(folder: Path, counted: Callable[[int], None]) -> Callable[[], None]:
    """For `before`: call a function with 1, 2, ... just before each change of files in a folder.

    Counted are Python's own calls: opening for writing, renaming, making and removing. What libraries write by
    themselves lies between them.
    """
    inside, number = f"{folder}{os.sep}", 0

    def hook(event: str, arguments: tuple) -> None:
        nonlocal number
        if event == "open":
            path, _, opened = arguments
            changes = isinstance(opened, int) and bool(opened & WRITES) and isinstance(path, (str, os.PathLike))
        else:
            path, changes = arguments[0] if arguments else None, event in CHANGES
            if event in ("os.remove", "os.rmdir") and isinstance(arguments[-1], int) and arguments[-1] >= 0:
                path = os.path.join(os.readlink(f"/proc/self/fd/{arguments[-1]}"), path)
        if changes and isinstance(path, (str, os.PathLike)) and os.path.abspath(path).startswith(inside):
            number += 1
            counted(number)

    return lambda: sys.addaudithook(hook)


def killed_at(folder: Path, place: int) -> Callable[[], None]:
    """For `before`: end the process by SIGKILL just before its n-th change of files in a folder."""

    def kill(number: int) -> None:
        if number == place:
            os.kill(os.getpid(), signal.SIGKILL)

    return count_changes(folder, kill)
