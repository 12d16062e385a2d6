"""Cameras that track, at the resolution of the images."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera, read_cameras

CAMERA_COLUMNS = ("camera", "test_camera")
"""Columns of the table of images that say which cameras there are."""


def image_cameras(path: Path, images: pd.DataFrame, downsample: float, use_test_cameras: bool) -> dict[str, Camera]:
    """Calibrated cameras of the index at image resolution, sorted by name.

    Held-out ones are left out unless `use_test_cameras`. Of `images`, `CAMERA_COLUMNS` are looked at.
    Raises:
        InputError: if one is not calibrated, or fewer than two are left.
    """
    calibrated = read_cameras(path)
    wanted = images if use_test_cameras else images[~images.test_camera]
    names = sorted(wanted.camera.unique())
    missing = [name for name in names if name not in calibrated]
    if missing:
        raise InputError(f"{path}: cameras: expected every camera of the capture, found none for {', '.join(missing)}")
    if len(names) < 2:
        raise InputError(
            f"index/images.parquet: expected at least 2 cameras for triangulation, found {len(names)} "
            f"({'' if use_test_cameras else 'without held-out ones; '}add cameras, or hold fewer out)"
        )
    return {name: calibrated[name].downsampled(float(downsample)) for name in names}
