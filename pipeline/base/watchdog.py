"""Watchdog for whole stages: one that stands still prints the stacks of its threads.

Standing still means using no processor time for long.
"""

from __future__ import annotations

import faulthandler
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from pipeline.base.watched_child import processor_seconds

SILENT_S = 600.0
"""Seconds without processor time after which stacks are printed. Reading from a slow file system stays far below."""

LOOKS = 20
"""Looks at the processor time within that span."""

HELD = 2.0
"""Such spans after which a timer without interpreter lock prints stacks, if no look was taken: a library holds the lock
for so long. Reading stacks without the lock crashes on a thread that runs just then; here none can."""

WORK_S = 0.05
"""Processor seconds, without the looks' own, that count as work. Five ticks of the clock that they are counted in."""


@contextmanager
def watched(output: TextIO, silent_s: float = SILENT_S) -> Iterator[None]:
    """Print the stacks of all threads to `output` whenever the block stands still.

    Standing still means hardly any processor time, that of child processes included, within `silent_s`. A thread looks
    after it. Should a library wait for ever while it holds the interpreter's lock, no thread can look; faulthandler's
    timer, which needs no lock, goes off then. Nothing is ended: the log says what is waited for.
    """
    ended = threading.Event()
    postponing = threading.Thread(target=_look_after, args=(output, silent_s, ended), daemon=True, name="watchdog")
    started = False
    with suppress(RuntimeError):  # No memory for its stack: the block goes on unwatched.
        postponing.start()
        started = True
    try:
        yield
    finally:
        ended.set()
        if started:
            postponing.join()
        faulthandler.cancel_dump_traceback_later()


def _look_after(output: TextIO, silent_s: float, ended: threading.Event) -> None:
    """Print stacks when the process has not worked for long; set the timer anew at each look."""
    worked, used_then = time.monotonic(), 0.0
    while not ended.is_set():
        used = processor_seconds(os.getpid()) - time.thread_time()
        if used >= used_then + WORK_S:
            worked, used_then = time.monotonic(), used
        elif time.monotonic() >= worked + silent_s:
            faulthandler.dump_traceback(output)
            worked = time.monotonic()
        try:
            faulthandler.dump_traceback_later(HELD * silent_s, repeat=True, file=output)
        except RuntimeError:  # No memory for its thread: the block goes on unwatched.
            return
        ended.wait(silent_s / LOOKS)
