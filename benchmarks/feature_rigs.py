"""Photographed rigs as input of calibrate_cameras without any board: colour images, lenses, and one given distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import pandas as pd

from benchmarks.photographed_rigs import CALISCOPE_SIZE, CHECKERBOARD_SIZE, caliscope_frames
from pipeline.base.files import write_json, write_table
from pipeline.geometry.cameras import Camera, write_cameras

IMAGES = {"transfer": "srgb", "black_level": 0.0, "downsample_from_sensor": 1}

EVERY = 14
"""One of so many frames of the videos of 111."""


def prepare_webcams(
    data: Path, folder: Path, lenses: Mapping[str, Camera], metres: float, intrinsics: str
) -> dict[str, Path]:
    """Frames of some of caliscope's webcams: arguments of calibrate_cameras.

    Args:
        lenses: cameras that take part, with their intrinsics; the first and the last are `metres` apart.
        intrinsics: estimate, refine or known.
    """
    views = [
        _write_view(folder, name, number, image)
        for name in lenses
        for number, image in caliscope_frames(data, name, EVERY)
    ]
    return _write_index(folder, views, lenses, CALISCOPE_SIZE, metres, intrinsics)


def prepare_stereo_pair(
    data: Path, folder: Path, lenses: Mapping[str, Camera], metres: float, intrinsics: str
) -> dict[str, Path]:
    """Photographs of OpenCV's stereo pair, left and right: arguments of calibrate_cameras."""
    views = [
        _write_view(folder, side, int(path.stem[-2:]), cv2.imread(str(path)))
        for side in ("left", "right")
        for path in sorted(data.glob(f"{side}[0-9][0-9].jpg"))
    ]
    return _write_index(folder, views, lenses, CHECKERBOARD_SIZE, metres, intrinsics)


def _write_view(folder: Path, camera: str, number: int, image: cv2.typing.MatLike) -> dict[str, object]:
    path = folder / camera / f"{number:03d}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)
    return {"camera": camera, "view": number, "path": f"{camera}/{path.name}", "digest": ""}


def _write_index(
    folder: Path, views: Sequence[Mapping[str, object]], lenses: Mapping[str, Camera], size: tuple[int, int],
    metres: float, intrinsics: str,
) -> dict[str, Path]:  # fmt: skip
    names = list(lenses)
    write_cameras(folder / "lenses.json", lenses)
    table = {"camera": names, "sensor_width": size[0], "sensor_height": size[1]}
    write_table(folder / "index/cameras.parquet", pd.DataFrame(table))
    section = {"method": "features", "intrinsics": intrinsics, "views": list(views), "images": IMAGES}
    section["distance"] = {"first": names[0], "second": names[-1], "metres": metres}
    if intrinsics != "estimate":
        section["lenses_from"] = {"format": "cameras_json", "path": "lenses.json"}
    write_json(folder / "index/calibration_cameras.json", section)
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}
