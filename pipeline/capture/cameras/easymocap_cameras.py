"""Reading cameras from EasyMocap's folder of intri.yml and extri.yml.

Source: the mytools.camera_utils of zju3dv/EasyMocap and its page on calibration. Poses are camera-from-world, x right,
y down, z forward, in metres: `R_` is a Rodrigues vector, `Rot_` the same as a matrix, `T_` the translation. `K_` and
`dist_` (older: `D_`) go to OpenCV's functions, so pixels are counted from their centres and half a pixel is added. Its
writers print six digits. `H_` and `W_`, the size, are often absent: then K is taken for one of the sensor's size.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.cameras.camera_formats import SourceImage, camera_from_lens, finite_numbers
from pipeline.capture.cameras.file_storage import open_storage, values
from pipeline.capture.cameras.opencv_lenses import opencv_lens
from pipeline.geometry.cameras import Camera

INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"

SAME_ROTATION = 1e-4
"""Largest difference between the entries of a rotation given twice: six digits each are good to 1e-6."""


def is_easymocap(folder: Path) -> bool:
    """Tell whether a folder has both files."""
    return all((folder / name).is_file() for name in (INTRINSICS, EXTRINSICS))


def read_easymocap(folder: Path, cameras: Mapping[str, tuple[int, int]], complaints: Complaints) -> list[SourceImage]:
    """The cameras under `names`. Those that are none of the capture's may be anything.

    Args:
        cameras: their sensors' width and height, for files without a size.

    Raises:
        InputError: if one of the files is none.
    """
    lenses, poses = (_contents(folder / name) for name in (INTRINSICS, EXTRINSICS))
    names = lenses.get("names")
    if not isinstance(names, list) or not names:
        raise InputError(f"{INTRINSICS}: names: expected a list of cameras, found {names or 'none'}")
    found = []
    for name in names:
        camera = None
        with complaints.collecting():
            if name in cameras:
                camera = _camera(f"camera {name}", name, lenses, poses, cameras[name])
        found.append(SourceImage(name, name, camera))
    return found


def _contents(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise InputError(f"expected {INTRINSICS} and {EXTRINSICS} in the folder, found no {file.name}")
    try:
        return values(open_storage(file))
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from error


def _camera(
    where: str, name: str, lenses: Mapping[str, Any], poses: Mapping[str, Any], sensor: tuple[int, int]
) -> Camera:
    try:
        size = tuple(_whole(lenses, f"{key}_{name}", side) for key, side in zip("WH", sensor, strict=True))
        dist = f"dist_{name}" if f"dist_{name}" in lenses else f"D_{name}"
        lens = opencv_lens(lenses, f"K_{name}", dist, size)
        return camera_from_lens(_rotation(name, poses), finite_numbers(poses, f"T_{name}", (3,)), lens)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _whole(lenses: Mapping[str, Any], key: str, otherwise: int) -> int:
    if key not in lenses:
        return otherwise
    size = float(finite_numbers(lenses, key, ()))
    if size % 1:
        raise InputError(f"{key}: expected a whole number of pixels, found {size}")
    return int(size)


def _rotation(name: str, poses: Mapping[str, Any]) -> np.ndarray:
    """From the vector, as EasyMocap reads it, or the matrix where there is no vector."""
    vector, matrix = f"R_{name}", f"Rot_{name}"
    if vector not in poses and matrix in poses:
        return finite_numbers(poses, matrix, (3, 3))
    R = cv2.Rodrigues(finite_numbers(poses, vector, (3,)))[0]
    if matrix in poses and np.abs(finite_numbers(poses, matrix, (3, 3)) - R).max() > SAME_ROTATION:
        raise InputError(f"{vector}, {matrix}: expected the same rotation twice, found two; remove the wrong one")
    return R
