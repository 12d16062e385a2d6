"""Files of a capture that may lie in zip archives.

`image/cam1.zip/cam1/000000.avif` names a member of one.
"""

from __future__ import annotations

import zipfile
from functools import lru_cache
from pathlib import Path, PurePosixPath

from pipeline.base.errors import InputError

OPEN_ARCHIVES = 256
"""Archives that a process keeps open: more than any public stage has cameras. The list of an archive's members takes a
tenth of a second to read, a member a millisecond."""


def split_member(path: Path) -> tuple[Path, str] | None:
    """The archive that a path leads through, and its member; None without one."""
    for parent in Path(path).parents:
        if parent.suffix.lower() == ".zip" and parent.is_file():
            return parent, PurePosixPath(Path(path).relative_to(parent)).as_posix()
    return None


def holder_of(path: Path) -> Path:
    """The file on the disk that holds what a path names: an archive, or the file itself."""
    found = split_member(path)
    return Path(path) if found is None else found[0]


def is_there(path: Path) -> bool:
    """True for a file, and for a member of an archive."""
    found = split_member(path)
    return Path(path).is_file() if found is None else found[1] in members(found[0])


def members(archive: Path) -> frozenset[str]:
    """Names of an archive's files.

    Raises:
        InputError: if it is no zip archive.
    """
    return _members(archive, archive.stat().st_mtime_ns)


def read_bytes(path: Path) -> bytes:
    """Content of a file or of an archive's member.

    Raises:
        InputError: if it cannot be read.
    """
    try:
        found = split_member(path)
        if found is None:
            return Path(path).read_bytes()
        archive, member = found
        # Threads may share an archive: its file has a lock.
        return _opened(archive, archive.stat().st_mtime_ns).read(member)
    except KeyError as error:
        raise InputError(f"{path}: expected a member of {archive.name}, found none of that name") from error
    except (OSError, zipfile.BadZipFile) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: expected a readable file, found: {reason}") from error


@lru_cache(maxsize=OPEN_ARCHIVES)
def _opened(archive: Path, _changed_ns: int) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(archive)
    except zipfile.BadZipFile as error:
        raise InputError(f"{archive}: expected a zip archive, found none: {error}") from error


@lru_cache(maxsize=OPEN_ARCHIVES)
def _members(archive: Path, changed_ns: int) -> frozenset[str]:
    return frozenset(name for name in _opened(archive, changed_ns).namelist() if not name.endswith("/"))
