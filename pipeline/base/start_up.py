"""Settings of a process that have to come before a stage imports what it works with.

Importing torch and what comes with it makes some hundred thousand objects that live as long as the process. Python
looks through all of them, again and again, while they come, and once more when the process ends: a second of four.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys


def use_one_blas_thread() -> None:
    """Have OpenBLAS work on one thread, here, unless NumPy is imported, and in what is started.

    With another number of threads OpenBLAS adds in another order, and results differ in the last digits from machine
    to machine. Matrices of stages are small, or sparse and summed elsewhere.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"


def pause_collection() -> None:
    """Stop collecting, if Python was started to run a module that it has not found yet.

    `python -m` says so by an `argv[0]` of -m (https://docs.python.org/3/using/cmdline.html#cmdoption-m).
    """
    if sys.argv[0] == "-m":
        gc.disable()


def end_by_interrupts() -> None:
    """Let SIGINT end the process at once while it imports, if Python runs a module.

    There is nothing to tidy up yet, and half a page of what was being imported tells nobody anything. Where it is
    ignored it stays so.
    """
    if sys.argv[0] == "-m" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def resume_collection() -> None:
    """Collect again what comes from here on, if collection was paused.

    When the process ends nothing is collected: it gives all back anyway.
    """
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
        atexit.register(gc.freeze)
