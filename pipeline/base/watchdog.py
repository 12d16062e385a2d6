"""Watchdog for whole stages: one that stands still prints the stacks of its threads.

Standing still means using no processor time for long.
"""

from __future__ import annotations

import faulthandler
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from pipeline.base.watched_child import processor_seconds

SILENT_S = 600.0
"""Seconds without processor time after which stacks are printed. Reading from a slow file system stays far below."""

LOOKS = 20
"""Looks at the processor time within that span."""

WORK_S = 0.05
"""Processor seconds, without the looks' own, that count as work. Five ticks of the clock that they are counted in."""


@contextmanager
def watched(output: TextIO, silent_s: float = SILENT_S) -> Iterator[None]:
    """Print the stacks of all threads to `output` whenever the block stands still.

    Standing still means hardly any processor time, that of child processes included, within `silent_s`. The timer is
    faulthandler's, a thread that needs no interpreter lock, so that a library that waits for ever while it holds the
    lock is seen, too. Nothing is ended: the log then says what is waited for.
    """
    ended = threading.Event()
    postponing = threading.Thread(target=_postpone, args=(output, silent_s, ended), daemon=True, name="watchdog")
    postponing.start()
    try:
        yield
    finally:
        ended.set()
        postponing.join()
        faulthandler.cancel_dump_traceback_later()


def _postpone(output: TextIO, silent_s: float, ended: threading.Event) -> None:
    """Set the timer anew as long as the process works."""
    postponed_at = -WORK_S
    while not ended.is_set():
        used = processor_seconds(os.getpid()) - time.thread_time()
        if used >= postponed_at + WORK_S:
            try:
                faulthandler.dump_traceback_later(silent_s, repeat=True, file=output)
            except RuntimeError:  # No memory for its thread: the block goes on unwatched.
                return
            postponed_at = used
        ended.wait(silent_s / LOOKS)
