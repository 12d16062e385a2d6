"""Stopping a workflow by a signal to Snakemake alone.

On SIGTERM and SIGINT Snakemake starts nothing more, but leaves running stages to themselves and waits for their end.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import FrameType

import psutil

STAGES = "pipeline.stages."
"""How the module of a stage begins, as the command lines of the rules name it."""


def pass_signals_on() -> None:
    """Hand each SIGTERM and SIGINT that this process gets to the stages that run below it, too.

    Batch systems send SIGTERM to Snakemake alone and SIGKILL soon after; training writes its checkpoint in between. The
    shells around the stages are left out: they end with their stage, so that Snakemake hears of its end. A SIGINT that
    is ignored, as in a script's background, stays so.
    """
    for number in (signal.SIGTERM, signal.SIGINT):
        before = signal.getsignal(number)
        if before != signal.SIG_IGN:
            signal.signal(number, partial(_hand_on, before))


def _hand_on(before: Callable[[int, FrameType | None], object] | int, number: int, frame: FrameType | None) -> None:
    """Signal all stages, then do what was done before."""
    for stage in running_stages(os.getpid()):
        with suppress(psutil.NoSuchProcess):
            stage.send_signal(number)
    if callable(before):
        before(number, frame)


def running_stages(pid: int) -> list[psutil.Process]:
    """Processes of stages below a process."""
    found = []
    for process in psutil.Process(pid).children(recursive=True):
        try:
            if any(word.startswith(STAGES) for word in process.cmdline()):
                found.append(process)
        except psutil.NoSuchProcess:
            continue
    return found
