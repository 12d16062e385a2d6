"""Cameras and colours of BecomingLit: one lens for all, a pose and a colour matrix of each."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.datasets.layout import json_key
from pipeline.geometry.cameras import Camera

BLACK_LIGHT = 4 / 255
"""Linear light that the set's loader subtracts after the colour matrix."""

MIDDLE = 0.25
"""Share of the image's side by which the principal point may be off its middle."""


def camera_names(root: Path, wanted: Collection[str]) -> list[str]:
    """Names of the calibrated cameras, or of the `wanted` ones.

    Raises:
        InputError: if one of these is not there.
    """
    names = sorted(json_key(root / "calibration/camera_calibration.json", "world_to_cam"))
    if absent := sorted(set(wanted) - set(names)):
        raise InputError(f"import_capture.cameras: expected some of {listed(names, 20)}, found {listed(absent)}")
    return [name for name in names if not wanted or name in wanted]


def read_shared_lens(path: Path, sizes: dict[str, tuple[int, int]], complaints: Complaints) -> dict[str, Camera]:
    """Cameras of camera_calibration.json, in the set's world.

    One K for all, counted from the image's corner, as the set's loader scales it without a shift; camera-from-world in
    metres; images are free of distortion.
    """
    shared, poses = json_key(path, "cam_data"), json_key(path, "world_to_cam")
    fx, fy, cx, cy = (_number(shared, key) for key in ("fx", "fy", "cx", "cy"))
    K, cameras = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), {}
    if not np.isfinite(K).all():
        complaints.add(path.name, "cam_data", expected="the numbers fx, fy, cx, cy", found=repr(shared))
    for name, (width, height) in sizes.items():
        pose = _matrix(poses[name], (4, 4))
        if pose is None:
            found = repr(poses[name])
            complaints.add(path.name, f"world_to_cam {name}", expected="4 x 4 finite numbers", found=found)
            continue
        if np.abs(np.array([cx / width, cy / height]) - 0.5).max() > MIDDLE:
            expected = f"a principal point near the middle of the {width} x {height} pixels of camera {name}"
            hint = "K is that of images as they are released, 2200 x 3208 pixels"
            complaints.add(path.name, "cam_data", expected=expected, found=f"{cx:g}, {cy:g}", hint=hint)
        cameras[name] = Camera(pose[:3, :3], pose[:3, 3], K, np.zeros(5), width, height)
    return cameras


def read_colors(
    path: Path, names: Collection[str], complaints: Complaints
) -> dict[str, Float64[np.ndarray, "3 4"]]:  # fmt: skip
    """Of each camera the matrix of linear colours, and the light that is subtracted after it."""
    colors = {}
    for name in names:
        matrix = _matrix(json_key(path, name), (3, 3))
        if matrix is None:
            complaints.add(path.name, name, expected="3 x 3 finite numbers", found="others")
            continue
        colors[name] = np.concatenate([matrix, np.full((3, 1), -BLACK_LIGHT)], axis=1)
    return colors


def _number(content: Any, key: str) -> float:
    value = content.get(key) if isinstance(content, dict) else None
    return float(value) if isinstance(value, int | float) else np.nan


def _matrix(content: Any, shape: tuple[int, int]) -> np.ndarray | None:
    try:
        matrix = np.asarray(content, np.float64)
    except (TypeError, ValueError):
        return None
    return matrix if matrix.shape == shape and np.isfinite(matrix).all() else None
