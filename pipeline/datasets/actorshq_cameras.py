"""Cameras of ActorsHQ: axis and angle, and lenses in shares of the image's size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pipeline.base.errors import Complaints, InputError
from pipeline.geometry.cameras import Camera

CALIBRATION = "calibration.csv"

COLUMNS = ("w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")

SAME_SHAPE = 0.01
"""Relative difference of two aspect ratios: whole pixels of images four times smaller make less."""


def read_actorshq_cameras(
    path: Path, sizes: Mapping[str, tuple[int, int]], complaints: Complaints
) -> dict[str, Camera]:  # fmt: skip
    """Cameras of calibration.csv that have images, at the images' size, in the set's world.

    The rotation turns the camera's axes (right, down, forward) into the world's. Lenses are shares of the image's size,
    and so are those of any scale. Images are free of distortion.

    Args:
        sizes: width and height of each camera's images.

    Raises:
        InputError: if the file is no table, or has other columns.
    """
    try:
        # Names with a space after each comma, as in the set's own description, are the same.
        table = pd.read_csv(path, skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a csv table, found: {error}") from error
    if missing := [column for column in ("name", *COLUMNS) if column not in table]:
        raise InputError(f"{path}: columns: expected name, {', '.join(COLUMNS)}, found no {', '.join(missing)}")
    rows, cameras = {str(row["name"]): row for _, row in table.iterrows()}, {}
    for name, (width, height) in sizes.items():
        if name not in rows:
            complaints.add(path.name, name, expected="a row, as it has images", found="none")
            continue
        try:
            values = rows[name][list(COLUMNS)].to_numpy(np.float64)
        except (TypeError, ValueError):
            values = np.full(len(COLUMNS), np.nan)
        if not np.isfinite(values).all() or values[:2].min() <= 0:
            complaints.add(path.name, name, expected="finite numbers", found=str(rows[name].to_dict()))
            continue
        w, h, *pose, fx, fy, px, py = values
        if abs(w / h / (width / height) - 1) > SAME_SHAPE:
            expected = f"the shape of its images, {width} x {height} pixels"
            complaints.add(path.name, f"{name}: w, h", expected=expected, found=f"{w:g} x {h:g}")
            continue
        R = Rotation.from_rotvec(pose[:3]).as_matrix().T
        K = np.array([[fx * width, 0, px * width], [0, fy * height, py * height], [0, 0, 1]])
        cameras[name] = Camera(R, -R @ np.array(pose[3:]), K, np.zeros(5), width, height)
    return cameras
