"""Check that the binary tables of a COLMAP model are whole.

pycolmap does not ask: past the end of a truncated file it takes what lies in memory for numbers of cameras, poses and
names, or never returns. Layouts (little endian) from COLMAP's reconstruction_io_binary.cc.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pycolmap

from pipeline.base.errors import InputError

POINT_BYTES = 24
"""Of an image: two doubles and the number of its point in space."""


class _Cursor:
    """A place in a file's bytes."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """The values here. Raises struct.error past the end."""
        values = struct.unpack_from(f"<{layout}", self.content, self.at)
        self.at += struct.calcsize(f"<{layout}")
        return values


def _pass_camera(cursor: _Cursor) -> None:
    _id, model, _width, _height = cursor.take("IiQQ")
    lens = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId(model), 1.0, 1, 1)
    cursor.take(f"{len(lens.params)}d")


def _pass_image(cursor: _Cursor) -> None:
    cursor.take("I7dI")
    cursor.at = cursor.content.index(b"\0", cursor.at) + 1
    (points,) = cursor.take("Q")
    cursor.at += POINT_BYTES * points


def _pass_rig(cursor: _Cursor) -> None:
    _id, sensors = cursor.take("II")
    if sensors:
        cursor.take("iI")
    for _ in range(sensors - 1):
        _type, _sensor, has_pose = cursor.take("iIB")
        cursor.take("7d" if has_pose else "")


def _pass_frame(cursor: _Cursor) -> None:
    *_, images = cursor.take("II7dI")
    for _ in range(images):
        cursor.take("iIQ")


RECORDS: dict[str, Callable[[_Cursor], None]] = {
    "cameras": _pass_camera,
    "images": _pass_image,
    "rigs": _pass_rig,
    "frames": _pass_frame,
}


def check_whole(file: Path) -> None:
    """Check that a table (cameras.bin, images.bin, rigs.bin or frames.bin) is whole.

    Raises:
        InputError: if it ends before its last record does.
    """
    cursor = _Cursor(file.read_bytes())
    try:
        for _ in range(cursor.take("Q")[0]):
            RECORDS[file.stem](cursor)
        whole = cursor.at <= len(cursor.content)
    except (struct.error, ValueError):  # ValueError: no end of a name, or no camera model of this number.
        whole = False
    if not whole:
        found = f"{len(cursor.content)} bytes that end before the last of them"
        raise InputError(f"{file.name}: expected all {file.stem} of a COLMAP model, found {found}; copy it again")
