"""Locks that a killed run left behind.

Snakemake's locks are files, which outlive a run that was killed or went down with its machine: the next one would have
to be told, by `--unlock`, that nobody holds them. So each run also holds a lock of the system, which all runs share
and which ends with its process. Where nobody else holds that, the files are nobody's.
"""

from __future__ import annotations

import fcntl
import os
import socket
from pathlib import Path

_held: list[int] = []
"""Descriptors of this process' locks, which the system gives up when it ends."""


def remove_dead_locks(folder: Path) -> bool:
    """Remove locks whose holders no longer live, and be known as a run that does from then on.

    They stay where another run lives, where one of those that left them was on another machine, for file systems do not
    tell all of them of each other's locks, and where there are no locks of the system. Then Snakemake says what to do.

    Args:
        folder: Snakemake's, `.snakemake`.

    Returns:
        Whether there were any to remove.
    """
    try:
        folder.mkdir(exist_ok=True)
        descriptor = os.open(folder / "runs.lock", os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return False
    _held.append(descriptor)
    try:
        alone, host = _alone(descriptor), socket.gethostname()
        hosts = {host, *os.pread(descriptor, 65536, 0).decode(errors="replace").split()}
        left = list((folder / "locks").glob("*.lock")) if alone else []
        dead = left if hosts == {host} else []
        for path in dead:
            path.unlink(missing_ok=True)
        if alone and dead == left:
            hosts = {host}
            os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, "".join(f"{name}\n" for name in sorted(hosts)).encode(), 0)
        fcntl.flock(descriptor, fcntl.LOCK_SH)
    except OSError:
        return False
    return bool(dead)


def _alone(descriptor: int) -> bool:
    """Whether no other run holds the lock; this one then holds it for itself."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
