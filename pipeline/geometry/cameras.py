"""Pinhole cameras with OpenCV's five distortion coefficients, in this project's pixel convention."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json


@dataclass(frozen=True)
class Camera:
    """One calibrated camera; see `pipeline.base.conventions` for frames and pixel centres.

    Attributes:
        R, t: camera-from-world rotation and translation (metres).
        K: intrinsics in pixels of a `width` x `height` image.
        dist: k1 k2 p1 p2 k3; zeros for an undistorted image.
    """

    R: Float64[np.ndarray, "3 3"]
    t: Float64[np.ndarray, " 3"]
    K: Float64[np.ndarray, "3 3"]
    dist: Float64[np.ndarray, " 5"]
    width: int
    height: int

    @property
    def center(self) -> Float64[np.ndarray, " 3"]:
        """Centre of projection in the world, metres."""
        return -self.R.T @ self.t

    def downsampled(self, factor: int | float) -> Camera:
        """The same camera for images `factor` times smaller (conventions: intrinsics divide exactly)."""
        K = self.K / np.array([[factor], [factor], [1.0]])
        return replace(self, K=K, width=round(self.width / factor), height=round(self.height / factor))

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points [..., 3] in metres to (pixels [..., 2], depth [...] in metres).

        Depths of zero or less are returned as they are; their pixels are meaningless. Differentiable by hand only.
        """
        in_camera = points @ self.R.T + self.t
        depth = in_camera[..., 2]
        x, y = np.moveaxis(in_camera[..., :2] / depth[..., None], -1, 0)
        k1, k2, p1, p2, k3 = self.dist
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([xd, yd, np.ones_like(xd)], -1) @ self.K.T[:, :2], depth

    def undistort(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels [N, 2] of the distorted image to normalised image coordinates (x/z, y/z) [N, 2]."""
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
        # K and the pixels share one convention, so OpenCV's pixel centres cancel out here.
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        return cv2.undistortPoints(points, self.K, self.dist, criteria=criteria).reshape(-1, 2)

    def ray_directions(self, pixels: np.ndarray) -> np.ndarray:
        """Unit directions [N, 3] in the world, from `center` through pixels [N, 2]."""
        xy = self.undistort(pixels)
        directions = np.concatenate([xy, np.ones((len(xy), 1))], 1) @ self.R
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def opencv_K(self) -> Float64[np.ndarray, "3 3"]:
        """Intrinsics for OpenCV functions, whose first pixel centre is (0, 0)."""
        K = self.K.copy()
        K[:2, 2] -= PIXEL_CENTER
        return K


def write_cameras(path: Path, cameras: Mapping[str, Camera]) -> None:
    """Write `{"cameras": {id: {R, t, K, dist, width, height}}}`, at sensor resolution."""
    content = {
        name: {
            "R": c.R.tolist(), "t": c.t.tolist(), "K": c.K.tolist(), "dist": c.dist.tolist(),
            "width": c.width, "height": c.height,
        }
        for name, c in cameras.items()
    }  # fmt: skip
    write_json(path, {"cameras": content})


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read what `write_cameras` wrote.

    Raises:
        InputError: naming the camera and the key, if one is missing or has the wrong shape.
    """
    content = read_json(path)
    entries = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: expected at least one camera under 'cameras', found none")
    return {name: _camera_from(f"{path}: camera {name}", entry) for name, entry in entries.items()}


def _camera_from(where: str, entry: object) -> Camera:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected the keys R, t, K, dist, width, height, found {entry!r}")
    arrays = {}
    for key, shape in {"R": (3, 3), "t": (3,), "K": (3, 3), "dist": (5,)}.items():
        try:
            arrays[key] = np.asarray(entry.get(key), dtype=np.float64)
        except (TypeError, ValueError):  # Text, or rows of unequal length.
            arrays[key] = np.array(np.nan)
        if arrays[key].shape != shape or not np.isfinite(arrays[key]).all():
            raise InputError(f"{where}: {key}: expected {shape} finite numbers, found {entry.get(key)}")
    for key in ("width", "height"):
        if not isinstance(entry.get(key), int) or entry[key] <= 0:
            raise InputError(f"{where}: {key}: expected a positive number of pixels, found {entry.get(key)}")
    return Camera(**arrays, width=entry["width"], height=entry["height"])
