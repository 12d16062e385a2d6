"""Reading cameras from caliscope's array of cameras, and from what it writes for aniposelib.

Source: the class CameraArray of mprib/caliscope at ddda95b. Its cameras are OpenCV's: x right, y down,
z forward, camera-from-world, the rotation as a Rodrigues vector or, in older files, as a matrix. Lengths are those of
the board that it was given, metres. Its pixels are counted from their centres, as those of the OpenCV functions that it
calls: half a pixel is added. Distortion is k1 k2 p1 p2 k3, of a fisheye k1 k2 k3 k4.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.errors import Complaints, InputError
from pipeline.capture.cameras.camera_formats import SourceImage, SourceLens, camera_from_lens, finite_numbers
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

PREFIX = "cam_"
"""Of a camera's video, and of its section in a file for aniposelib: cam_0 is camera 0."""


def read_caliscope(file: Path, cameras: Collection[str], complaints: Complaints) -> list[SourceImage]:
    """All cameras of the file, of which `0` and `cam_0` are one camera.

    Those that are none of the capture's have no pose, and may be anything.

    Raises:
        InputError: if the file is no TOML, or has no cameras.
    """
    found = []
    for key, entry in _entries(file).items():
        number = key.removeprefix(PREFIX)
        named = [name for name in dict.fromkeys((number, PREFIX + number)) if name in cameras]
        camera = None
        with complaints.collecting():
            if len(named) > 1:
                raise InputError(f"camera {key}: expected one camera of this name, found {' and '.join(named)}")
            if named:
                camera = _camera(f"camera {key}", entry)
        name = named[0] if named else key
        found.append(SourceImage(name, name, camera))
    return found


def is_caliscope(path: Path) -> bool:
    """Tell whether this is a file of caliscope's."""
    if path.suffix.lower() != ".toml":
        return False
    try:
        return bool(_entries(path))
    except InputError:
        return False


def _entries(file: Path) -> dict[str, Any]:
    try:
        content = tomllib.loads(file.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:  # ValueError: not TOML, or not text.
        raise InputError(f"{file}: expected a TOML file, found: {error}") from error
    inner = content.get("cameras", {key: entry for key, entry in content.items() if key.startswith(PREFIX)})
    if not isinstance(inner, dict) or not inner:
        raise InputError("cameras: expected sections cameras.0, cameras.1 ... or cam_0, cam_1 ..., found none")
    return inner


def _camera(where: str, entry: Any) -> Camera:
    try:
        if not isinstance(entry, dict):
            raise InputError(f"expected a section, found {entry!r}")
        if entry.get("rotation_count", 0) != 0:
            hint = "calibrate without turning the pictures, or give the camera in another format"
            raise InputError(f"rotation_count: expected 0, found {entry['rotation_count']}; {hint}")
        model = FISHEYE if entry.get("fisheye", False) else BROWN_CONRADY
        K, t = finite_numbers(entry, "matrix", (3, 3)), finite_numbers(entry, "translation", (3,))
        dist, size = finite_numbers(entry, "distortions", (len(model.terms),)), finite_numbers(entry, "size", (2,))
        if np.any(size % 1) or np.any(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != [0, 0, 0, 0, 1]):
            raise InputError(f"size, matrix: expected whole pixels and no skew, found {size.tolist()}, {K.tolist()}")
        terms = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2] + PIXEL_CENTER, "cy": K[1, 2] + PIXEL_CENTER}
        terms |= dict(zip(model.terms, dist.tolist(), strict=True))
        width, height = map(int, size)
        return camera_from_lens(_rotation(entry), t, SourceLens(model, terms, width, height))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _rotation(entry: Mapping[str, Any]) -> np.ndarray:
    """The rotation, from a Rodrigues vector (a list or a column) or a matrix."""
    rows = entry.get("rotation")
    if isinstance(rows, list) and len(rows) == 3 and all(isinstance(row, list) and len(row) == 3 for row in rows):
        return finite_numbers(entry, "rotation", (3, 3))
    return cv2.Rodrigues(finite_numbers(entry, "rotation", (3,)))[0]
