"""Garbage collection kept out of the way while a stage starts and ends.

Importing torch and what comes with it makes some hundred thousand objects that live as long as the process. Python
looks through all of them, again and again, while they come, and once more when the process ends: a second of four.
"""

from __future__ import annotations

import atexit
import gc
import sys


def pause_collection() -> None:
    """Stop collecting, if Python was started to run a module that it has not found yet.

    `python -m` says so by an `argv[0]` of -m (https://docs.python.org/3/using/cmdline.html#cmdoption-m).
    """
    if sys.argv[0] == "-m":
        gc.disable()


def resume_collection() -> None:
    """Collect again what comes from here on, if collection was paused.

    When the process ends nothing is collected: it gives all back anyway.
    """
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
        atexit.register(gc.freeze)
