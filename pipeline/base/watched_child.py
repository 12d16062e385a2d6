"""Watched child processes: one that stands still is ended and tried again."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from functools import partial

import psutil

from pipeline.base.parent_death import end_with

log = logging.getLogger("watched_child")

STALL_S = 60.0
"""Seconds without any processor time after which a child counts as stuck.

A starved process still gets a share of each scheduling period, which even under a hundred competitors is below a
second.
"""

LIMIT_S = 3600.0
"""Seconds after which a child that does use the processor is ended all the same."""

POLL_S = 1.0
"""Pause between two looks at a child's processor time; its end is noticed at once."""

ATTEMPTS = 2


class ChildFailed(Exception):
    """A child process failed, or stood still in every attempt. The message says which and what it printed."""


def run_watched(
    command: Sequence[str], stall_s: float = STALL_S, limit_s: float = LIMIT_S, attempts: int = ATTEMPTS
) -> None:
    """Run a program until it ends well; one that stands still or takes too long is run again.

    Args:
        command: path of the program and its arguments. It has to be safe to run again.
        stall_s: seconds without processor time that count as standing still.
        limit_s: seconds for one attempt.
        attempts: how often it is started at most.

    Raises:
        ChildFailed: if it exits with a code other than 0 (not tried again: it would fail again), or if no attempt came
            to an end.
    """
    for attempt in range(1, attempts + 1):
        # A session of its own, so that what the child started ends with it. Signals to this process' group miss it.
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            start_new_session=True, preexec_fn=partial(end_with, os.getpid()),
        )  # fmt: skip
        try:
            stuck = _wait(child, stall_s, limit_s)
        finally:
            # A child that ended by itself has left its group; one that is stuck or abandoned leaves nothing behind.
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
            said = child.communicate()[1].decode(errors="replace").strip()
        if stuck is None and child.returncode == 0:
            return
        if stuck is None:
            raise ChildFailed(f"{' '.join(command)}: expected exit code 0, found {child.returncode}:\n{said}")
        log.warning("%s: %s (attempt %d of %d)", " ".join(command), stuck, attempt, attempts)
    raise ChildFailed(f"{' '.join(command)}: {stuck}, {attempts} times")


def _wait(child: subprocess.Popen, stall_s: float, limit_s: float) -> str | None:
    """Wait for the child: None once it has ended, or the reason why it has to be ended."""
    start = last_progress = time.monotonic()
    used = 0.0
    while True:
        try:
            child.wait(min(POLL_S, stall_s / 4))
            return None
        except subprocess.TimeoutExpired:
            now, used_before, used = time.monotonic(), used, processor_seconds(child.pid)
        if used > used_before:
            last_progress = now
        if now - last_progress > stall_s:
            return f"used no processor time for {stall_s:g} s"
        if now - start > limit_s:
            return f"took longer than {limit_s:g} s"


def processor_seconds(pid: int) -> float:
    """Processor time that a process and all below it have used; 0 for a process that is gone."""
    try:
        family = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
        return sum(sum(process.cpu_times()[:4]) for process in family)
    except psutil.NoSuchProcess:
        return 0.0
