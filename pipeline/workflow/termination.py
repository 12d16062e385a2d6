"""Stopping a workflow by a signal to Snakemake alone.

On SIGTERM Snakemake starts nothing more, but leaves running stages to themselves.
"""

from __future__ import annotations

import os
import signal
from types import FrameType

import psutil

STAGES = "pipeline.stages."
"""How the module of a stage begins, as the command lines of the rules name it."""


def pass_sigterm_on() -> None:
    """Hand each SIGTERM that this process gets to the stages that run below it, too.

    Batch systems send it to Snakemake alone and SIGKILL soon after; training writes its checkpoint in between. The
    shells around the stages are left out: they end with their stage, so that Snakemake hears of its end.
    """
    before = signal.getsignal(signal.SIGTERM)

    def hand_on(number: int, frame: FrameType | None) -> None:
        for stage in running_stages(os.getpid()):
            stage.terminate()
        if callable(before):
            before(number, frame)

    signal.signal(signal.SIGTERM, hand_on)


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
