"""Cameras of Goliath: K and T transposed, millimetres, pixels counted from their centres."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.errors import Complaints
from pipeline.datasets.layout import json_key
from pipeline.geometry.cameras import Camera

METRES_PER_UNIT = 0.001

DOWNSAMPLE = 2
"""Sensor pixels along a side of a shipped image's pixel: 2668 x 4096 against 1334 x 2048."""

MIDDLE = 0.25
"""Share of the sensor's side by which the principal point may be off its middle: K of another resolution is off by
a half or more."""

MODELS = {"projectionModel": "Pinhole", "distortionModel": "RadialAndTangential"}


def read_goliath_cameras(
    path: Path, sizes: Mapping[str, tuple[int, int]], complaints: Complaints, downsample: int = DOWNSAMPLE
) -> dict[str, Camera]:
    """Cameras of camera_calibration.json at sensor resolution, those that have images.

    K.T has its principal point from the centre of the first pixel, so half a pixel is added; T.T is camera-from-world,
    in millimetres; distortion is k1 k2 p1 p2, as its model says, though the set's own loader leaves it out.

    Args:
        sizes: width and height of each camera's images.
        downsample: sensor pixels along a side of an image's pixel.
    """
    entries = {str(entry.get("cameraId")): entry for entry in json_key(path, "KRT")}
    cameras = {}
    for name, (width, height) in sizes.items():
        if name not in entries:
            complaints.add(path.name, f"camera {name}", expected="an entry, as it has images", found="none")
            continue
        before = len(complaints.messages)
        size = (width * downsample, height * downsample)
        hint = f"images are taken for {downsample} times smaller than the sensor, as the set ships them"
        camera = _camera(path.name, name, entries[name], size, hint, complaints)
        if camera is not None and len(complaints.messages) == before:
            cameras[name] = camera
    return cameras


def calibrated_names(path: Path) -> list[str]:
    """Names of all cameras of camera_calibration.json."""
    return [str(entry.get("cameraId")) for entry in json_key(path, "KRT")]


def _camera(
    file: str, name: str, entry: dict[str, Any], size: tuple[int, int], resolution: str, complaints: Complaints
) -> Camera | None:
    key = f"camera {name}"
    for word, model in MODELS.items():
        if (found := entry.get(word, model)) != model:
            complaints.add(file, f"{key}: {word}", expected=model, found=repr(found), hint="undistort the images first")
    arrays = {}
    for word, shapes in {"K": [(3, 3)], "T": [(4, 4), (4, 3)], "distortion": [(4,), (5,)]}.items():
        try:
            arrays[word] = np.asarray(entry.get(word), np.float64)
        except (TypeError, ValueError):
            arrays[word] = np.zeros(0)
        if arrays[word].shape not in shapes or not np.isfinite(arrays[word]).all():
            complaints.add(file, f"{key}: {word}", expected=f"{shapes[0]} finite numbers", found=repr(entry.get(word)))
            return None
    K, T = arrays["K"].T, arrays["T"].T
    # Stored as they are meant, the last row and the last column change places.
    if not np.array_equal(K[2], [0, 0, 1]) or np.abs(arrays["T"][:3, 3:]).max(initial=0) > 0:
        expected = "K and T transposed: principal point and translation in the last row"
        complaints.add(file, key, expected=expected, found=f"K {entry['K']}, T {entry['T']}")
        return None
    off = np.abs(K[:2, 2] / size - 0.5).max()
    if off > MIDDLE:
        expected = f"a principal point near the middle of the sensor's {size[0]} x {size[1]} pixels"
        complaints.add(file, f"{key}: K", expected=expected, found=f"{K[0, 2]:g}, {K[1, 2]:g}", hint=resolution)
    K = K.copy()
    K[:2, 2] += PIXEL_CENTER
    dist = np.pad(arrays["distortion"], (0, 5 - len(arrays["distortion"])))
    return Camera(T[:3, :3].copy(), METRES_PER_UNIT * T[:3, 3], K, dist, *size)
