"""Files of a capture that may lie in zip archives, and images that are frames of a video.

`image/cam1.zip/cam1/000000.avif` names a member of an archive, `images/cam1.mp4/000012` a frame, counted from 0, and
`alpha/cam1.mp4/000012.red` its first channel, for masks.
"""

from __future__ import annotations

import re
import zipfile
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.errors import InputError
from pipeline.capture.video_frames import VIDEO_SUFFIXES, read_video_frame, video_facts
from pipeline.capture.zip_members import ZipMembers

OPEN_ARCHIVES = 512
"""Archives that a process keeps open: more than any public stage has cameras, with one of images and one of masks each.
The list of an archive's members takes a tenth of a second to read, a member a millisecond."""

HOLDER = re.compile(rf"\.(zip|{'|'.join(suffix[1:] for suffix in VIDEO_SUFFIXES)})/", re.IGNORECASE)
"""Where the name of a file that holds others may end in a path."""

RED = ".red"
"""End of the name of a frame of which the first channel alone is read."""


def split_member(path: Path) -> tuple[Path, str] | None:
    """The archive or video that a path leads through, and its member or frame; None without one."""
    text = Path(path).as_posix()
    for found in HOLDER.finditer(text):
        if (holder := Path(text[: found.end() - 1])).is_file():
            return holder, text[found.end() :]
    return None


def holder_of(path: Path) -> Path:
    """The file on the disk that holds what a path names: archive, video, or the file itself."""
    found = split_member(path)
    return Path(path) if found is None else found[0]


def is_there(path: Path) -> bool:
    """True for a file, a member of an archive, and a frame that a video's header counts."""
    found = split_member(path)
    if found is None:
        return Path(path).is_file()
    holder, member = found
    if not is_video(holder):
        return member in _opened(holder, holder.stat().st_mtime_ns)
    number = frame_number(member)
    return number is not None and number < video_facts(holder).frames


def is_video(holder: Path) -> bool:
    """True for a video, by its name."""
    return holder.suffix.lower() in VIDEO_SUFFIXES


def frame_number(member: str) -> int | None:
    """Number of a video's frame by what a path has after the video; None if it is none."""
    number = member.removesuffix(RED)
    return int(number) if number.isascii() and number.isdecimal() else None


def members(archive: Path) -> frozenset[str]:
    """Names of an archive's files.

    Raises:
        InputError: if it is no zip archive.
    """
    return frozenset(_opened(archive, archive.stat().st_mtime_ns).names())


def read_bytes(path: Path) -> bytes:
    """Content of a file or an archive's member; of a video's frame, its pixels as a .bmp file.

    Raises:
        InputError: if it cannot be read.
    """
    try:
        found = split_member(path)
        if found is None:
            return Path(path).read_bytes()
        archive, member = found
        if is_video(archive):
            return _frame_bytes(archive, member)
        return _opened(archive, archive.stat().st_mtime_ns).read(member)
    except KeyError as error:
        raise InputError(f"{path}: expected a member of {archive.name}, found none of that name") from error
    except (OSError, zipfile.BadZipFile) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: expected a readable file, found: {reason}") from error


def _frame_bytes(video: Path, member: str) -> bytes:
    number = frame_number(member)
    if number is None:
        raise KeyError(member)
    pixels = read_video_frame(video, number)
    return cv2.imencode(".bmp", np.ascontiguousarray(pixels[..., 2]) if member.endswith(RED) else pixels)[1].tobytes()


@lru_cache(maxsize=OPEN_ARCHIVES)
def _opened(archive: Path, _changed_ns: int) -> ZipMembers:
    try:
        return ZipMembers(archive)
    except zipfile.BadZipFile as error:
        raise InputError(f"{archive}: expected a zip archive, found none: {error}") from error
