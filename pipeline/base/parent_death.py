"""Children that end with their parent, however it ends."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""Option of Linux' prctl: the signal that a process gets when its parent ends (`man 2 prctl`)."""


def end_with_parent() -> None:
    """Have the system end this process, a child of `multiprocessing`, when its parent does.

    On Linux; elsewhere nothing.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        end_with(parent.pid)


def end_with(parent: int) -> None:
    """Have the system end this process when its parent, which has this number, does.

    On Linux; elsewhere nothing.
    """
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # It has ended already.
        os.kill(os.getpid(), signal.SIGKILL)
