"""Lock on what a stage writes: one that outlived its workflow overwrites no newer result.

The lock is the system's, on a hidden file beside the output: it ends with the process that holds it, however that ends.
"""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.base.errors import InputError

_own: list[tuple[Path, int]] = []
"""Files of the locks of this process, and the descriptors that hold them."""


@contextmanager
def output_locked(out: Path, job: str) -> Iterator[None]:
    """Keep others from the same job with the same output while the block runs.

    Where the file system knows no locks, or the folder around the output cannot be written to, nothing is kept.

    Args:
        out: file or folder that is written.
        job: what writes it; other jobs may write into the same folder at the same time.

    Raises:
        InputError: if another process holds the lock, with its number and machine.
    """
    out = Path(out).absolute()
    path = out.parent / f".{out.name}.{job}.lock"
    descriptor = _locked(path)
    if descriptor is None:
        yield
        return
    _own.append((path, descriptor))
    try:
        yield
    finally:
        _own.remove((path, descriptor))
        if _same_file(path, descriptor):
            path.unlink()
        os.close(descriptor)


def require_own_output() -> None:
    """Refuse to go on if a lock of this process was deleted: another may have started since.

    Raises:
        InputError: if it was.
    """
    for path, descriptor in _own:
        if not _same_file(path, descriptor):
            raise InputError(
                f"{path}: expected the lock of this process, {os.getpid()}, found none or another's; what it was "
                "writing may belong to a newer run, so nothing more is written"
            )


def _locked(path: Path) -> int | None:
    """A descriptor that holds the lock; None where there are no locks."""
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None  # If the output cannot be written either, the stage says so.
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 200).decode(errors="replace").strip()
            os.close(descriptor)
            raise InputError(
                f"{path}: expected no other process at work on the same output, found {holder or 'one'}; "
                "wait for it, or end it"
            ) from None
        except OSError:
            os.close(descriptor)
            return None
        if _same_file(path, descriptor):
            os.truncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            return descriptor
        os.close(descriptor)  # Its holder deleted it between the two calls.


def _same_file(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False
