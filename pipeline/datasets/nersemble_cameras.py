"""Cameras and colours of NeRSemble: one lens for all, a pose and a polynomial of each.

Its benchmark has a lens of each camera.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from pipeline.base.color import POLYNOMIALS
from pipeline.base.errors import Complaints, InputError, listed
from pipeline.datasets.layout import json_key
from pipeline.geometry.cameras import Camera

log = logging.getLogger(__name__)

CALIBRATION, COLORS = "calibration/camera_params.json", "calibration/color_calibration.json"

SENSOR = (2200, 3208)
"""Width and height, pixels, of the images as recorded, which intrinsics of the release are for."""

MIDDLE = 0.25
"""Share of the image's side by which a principal point may be off its middle."""

Size = tuple[int, int]


def camera_names(path: Path, wanted: Collection[str]) -> list[str]:
    """Names of the calibrated cameras, or of the `wanted` ones.

    Raises:
        InputError: if one of these is not there.
    """
    names = sorted(json_key(path, "world_2_cam"))
    if absent := sorted(set(wanted) - set(names)):
        raise InputError(f"import_capture.cameras: expected some of {listed(names, 20)}, found {listed(absent)}")
    return [name for name in names if not wanted or name in wanted]


def read_nersemble_cameras(
    path: Path, sizes: Mapping[str, Size], complaints: Complaints
) -> tuple[dict[str, Camera], str]:
    """Cameras of camera_params.json at the images' size, in the set's world; and K's own size.

    `world_2_cam` is camera-from-world of OpenCV's axes, metres. Images are free of distortion. K counts from the
    image's corner: the set's programs scale it without a shift.

    Args:
        path: the file.
        sizes: width and height of each camera's images.
        complaints: gets what is wrong with the file.
    """
    poses, given, lenses, cameras = json_key(path, "world_2_cam"), json_key(path, "intrinsics"), {}, {}
    for name, size in sizes.items():
        entry = given.get(name) if isinstance(given, dict) else given
        pose, lenses[name] = _matrix(poses.get(name), (4, 4)), _matrix(entry, (3, 3))
        if pose is None or lenses[name] is None:
            key, found = ("world_2_cam", poses.get(name)) if pose is None else ("intrinsics", entry)
            complaints.add(path.name, f"{key} of {name}", expected="a matrix of finite numbers", found=f"{found!r:.80}")
            del lenses[name]
            continue
        cameras[name] = Camera(pose[:3, :3], pose[:3, 3], lenses[name], np.zeros(5), *size)
    calibrated, said = calibrated_size(path, {name: sizes[name] for name in lenses}, lenses)
    for name, K in lenses.items():
        size = sizes[name]
        scale = (
            np.array([[size[0] / calibrated[0]], [size[1] / calibrated[1]], [1.0]]) if calibrated else np.ones((3, 1))
        )
        scaled = K * scale
        if np.abs(scaled[:2, 2] / size - 0.5).max() > MIDDLE:
            expected = f"a principal point near the middle of the {size[0]} x {size[1]} pixels of camera {name}"
            hint = f"K is taken for images of {SENSOR[0]} x {SENSOR[1]} pixels, or of those that are there"
            complaints.add(path.name, "intrinsics", expected=expected, found=f"{K[0, 2]:g}, {K[1, 2]:g}", hint=hint)
        camera = cameras[name]
        cameras[name] = Camera(camera.R, camera.t, scaled, camera.dist, *size)
    return cameras, said


def calibrated_size(
    path: Path, sizes: Mapping[str, Size], lenses: Mapping[str, Float64[np.ndarray, "3 3"]]
) -> tuple[Size | None, str]:
    """Size of the images that K is of, the sensor's or None for those that are there, and why.

    It is the one that puts principal points nearest to the middle.
    """
    off = {
        place: float(np.mean([np.abs(K[:2, 2] / (place or sizes[name]) - 0.5).mean() for name, K in lenses.items()]))
        for place in (SENSOR, None)
    } if lenses else {SENSOR: 0.0}  # fmt: skip
    names = {SENSOR: f"{SENSOR[0]} x {SENSOR[1]}", None: "the images that are there"}
    said = ", ".join(f"{value:.3f} of a side if K is of {names[place]}" for place, value in off.items())
    log.info("%s: principal points are off the middle by %s", path, said)
    best = min(off, key=lambda place: off[place])
    return best, f"K is of {names[best]}: principal points are off the middle by {said}"


def read_nersemble_colors(
    path: Path, names: Collection[str], complaints: Complaints
) -> dict[str, Float64[np.ndarray, "3 columns"]]:
    """Of each camera the polynomial of linear colours: 3 rows, a column for each term."""
    colors = {}
    for name in names:
        given = json_key(path, name)
        columns = len(given[0]) if isinstance(given, list) and given and isinstance(given[0], list) else 0
        matrix = _matrix(given, (3, columns))
        if matrix is None or columns not in POLYNOMIALS:
            expected = f"3 rows of finite numbers, as many as {', '.join(map(str, POLYNOMIALS))}"
            complaints.add(path.name, name, expected=expected, found=f"{given!r:.80}")
            continue
        colors[name] = matrix
    return colors


def _matrix(content: Any, shape: tuple[int, int]) -> np.ndarray | None:
    try:
        matrix = np.asarray(content, np.float64)
    except (TypeError, ValueError):
        return None
    return matrix if matrix.shape == shape and np.isfinite(matrix).all() else None
