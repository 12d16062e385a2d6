"""Writing a file or a folder whole or not at all, and never over what is somebody else's."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.output_lock import require_own_output

UNFINISHED = ".unfinished."
"""Prefix of the folders in which files are written: none of them has the suffix of a file, so no pattern of files finds
what lies in them."""

HELD = ".held"
"""File of such a folder that its process keeps locked; the system drops the lock with the process."""

WRITTEN_BY = ".written_by"
"""File of a folder that is replaced as a whole: it names the stage that may do so."""


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a file that becomes `path` only on success.

    It lies in a hidden folder beside `path`, on the same file system, and is renamed once its content is on the disk: a
    reader never sees half a file, and neither a killed stage nor a power cut leaves one under the final name. What a
    killed process left is removed by the next one that writes into the same folder.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with workplace(path.parent) as place:
        temporary = place / path.name
        yield temporary
        require_own_output()
        _flush(temporary)
        os.replace(temporary, path)
        _flush(path.parent)


@contextmanager
def written_folder(path: Path, writer: str) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path` only on success.

    The old folder is renamed away before it is deleted: a killed stage leaves one of the two, or none, never a part.

    Args:
        path: the folder. A link to one is followed.
        writer: the stage; it may replace an empty folder, or one that it wrote itself.

    Raises:
        InputError: at once, if there is something else.
    """
    require_own_folder(path, writer)
    target = Path(path).resolve()
    target.parent.mkdir(parents=True, exist_ok=True)
    with workplace(target.parent) as place:
        temporary = place / target.name
        temporary.mkdir()
        (temporary / WRITTEN_BY).write_text(f"{writer}\n")
        yield temporary
        require_own_output()
        require_own_folder(path, writer)
        _flush_all(temporary)
        if target.exists():
            os.rename(target, place / ".replaced")
        os.rename(temporary, target)
        _flush(target.parent)


def require_own_folder(path: Path, writer: str) -> None:
    """Refuse a path at which there is something that the writer did not write.

    Raises:
        InputError: if the path is a file, or a folder with content that does not say it was written by this writer.
    """
    path, expected = Path(path), f"expected no folder, an empty one, or one that {writer} wrote"
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: {expected}, found a file; name another folder")
    names = sorted(os.listdir(path)) if path.is_dir() else []
    if names and not (path / WRITTEN_BY).is_file():
        raise InputError(f"{path}: {expected}, found {_shown(names)}; move it away or name another folder")
    if names and (found := (path / WRITTEN_BY).read_text().strip()) != writer:
        raise InputError(f"{path}: {expected}, found one that {found} wrote; name another folder")


def _shown(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" ... ({len(names)} in all)" if len(names) > 3 else "")


@contextmanager
def workplace(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder in `folder` that is gone afterwards.

    At the latest the next writer removes it.
    """
    _sweep(folder.absolute())
    with ExitStack() as stack:
        with _folder_locked(folder, fcntl.LOCK_SH):
            place = Path(tempfile.mkdtemp(prefix=_new(), dir=folder))
            try:
                held = stack.enter_context(open(place / HELD, "w"))
                _lock(held.fileno())
                # Under the name that is swept only once it is locked: nobody takes it for left over.
                place = place.rename(folder / f"{UNFINISHED}{place.name.removeprefix(_new())}")
            except BaseException:
                shutil.rmtree(place, ignore_errors=True)
                raise
        try:
            yield place
        finally:
            shutil.rmtree(place, onerror=_raise_unless_gone)


def _flush(path: Path) -> None:
    """Have a file's content, or the names in a folder, on the disk before anything else happens; 2 ms each."""
    if path.is_symlink():
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():  # Some file systems flush no folders.
            raise
    finally:
        os.close(descriptor)


def _flush_all(folder: Path) -> None:
    """Have all that a folder holds on the disk: at once where Linux' syncfs is, for 2 ms each add up."""
    syncfs = getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None)
    if syncfs is None:
        for content in [*folder.rglob("*"), folder]:
            _flush(content)
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        if syncfs(descriptor):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(folder))
    finally:
        os.close(descriptor)


def _raise_unless_gone(call: object, path: str, error: tuple) -> None:
    """Let pass that another writer sweeps at the same time, as it may once the file that is held is gone."""
    if not isinstance(error[1], FileNotFoundError):
        raise error[1]


@cache
def _sweep(folder: Path) -> None:
    """Remove what killed processes left in a folder; once per process."""
    for left in folder.glob(f"{UNFINISHED}*"):
        try:
            with open(left / HELD, "r+") as held:
                dead = _lock(held.fileno())
        except FileNotFoundError:  # Killed while it tidied up, or still at it.
            dead = True
        except OSError:
            dead = False
        if dead:
            shutil.rmtree(left, ignore_errors=True)
    if not next(folder.glob(f"{_new()}*"), None):
        return
    with _folder_locked(folder, fcntl.LOCK_EX | fcntl.LOCK_NB) as alone:
        for left in folder.glob(f"{_new()}*") if alone else ():  # Nobody is between making a folder and naming it.
            shutil.rmtree(left, ignore_errors=True)


def _new() -> str:
    """Prefix of folders that are not held yet; with the machine, as the lock of a folder may not reach others."""
    return f".new.{socket.gethostname()}."


@contextmanager
def _folder_locked(folder: Path, how: int) -> Iterator[bool]:
    """Hold a lock of a folder while the block runs; False if it cannot be had."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        yield False
        return
    try:
        yield _lock(descriptor, how)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, how: int = fcntl.LOCK_EX | fcntl.LOCK_NB) -> bool:
    """Take a lock that ends with the process; False if another has it, or the file system knows none."""
    try:
        fcntl.flock(descriptor, how)
    except OSError:
        return False
    return True
