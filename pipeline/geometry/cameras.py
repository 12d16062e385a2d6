"""Calibrated cameras with a lens, in this project's pixel convention, and their file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.geometry.lens import Lens
from pipeline.geometry.lenses import BROWN_CONRADY, LENSES

PINHOLE_TERMS = ("f", "aspect", "cx", "cy")
"""The first of a camera's intrinsics, before the terms of its lens. f = fx and aspect = fy / fx: pixels are nearly
square, which is a prior on one number."""

LEAST_COSINE = 1e-9
"""Cosine of the angle from the optical axis up to which a ray counts as 90 degrees off, with no place on the plane
z = 1: float64 leaves that place six digits here, and none soon after."""


@dataclass(frozen=True)
class Camera:
    """One calibrated camera; see `pipeline.base.conventions` for frames and pixel centres.

    Attributes:
        R, t: camera-from-world rotation and translation (metres).
        K: intrinsics in pixels of a `width` x `height` image.
        dist: the coefficients of the lens, in the order of its `terms`; zeros for a lens without faults.
        lens: its model; an undistorted image has `BROWN_CONRADY` and zeros.
    """

    R: Float64[np.ndarray, "3 3"]
    t: Float64[np.ndarray, " 3"]
    K: Float64[np.ndarray, "3 3"]
    dist: Float64[np.ndarray, " terms"]
    width: int
    height: int
    lens: Lens = BROWN_CONRADY

    def __post_init__(self) -> None:
        """Check the number of coefficients.

        Raises:
            ValueError: if the lens has another.
        """
        if np.shape(self.dist) != (len(self.lens.terms),):
            expected = f"the coefficients {', '.join(self.lens.terms)} of a {self.lens.name} lens"
            raise ValueError(f"dist: expected {expected}, found numbers of shape {np.shape(self.dist)}")

    @property
    def center(self) -> Float64[np.ndarray, " 3"]:
        """Centre of projection in the world, metres."""
        return -self.R.T @ self.t

    def downsampled(self, factor: int | float) -> Camera:
        """The same camera for images `factor` times smaller.

        Intrinsics divide exactly (conventions).
        """
        K = self.K / np.array([[factor], [factor], [1.0]])
        return replace(self, K=K, width=round(self.width / factor), height=round(self.height / factor))

    def pinhole(self) -> Camera:
        """The same camera with no distortion: that of undistorted images."""
        return replace(self, dist=BROWN_CONRADY.no_distortion(), lens=BROWN_CONRADY)

    def intrinsics(self) -> Float64[np.ndarray, " intrinsics"]:
        """`PINHOLE_TERMS`, then the terms of the lens: what `project_with_jacobian` takes."""
        K = self.K
        return np.array([K[0, 0], K[1, 1] / K[0, 0], K[0, 2], K[1, 2], *self.dist])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points [..., 3] in metres to (pixels [..., 2], depth [...] in metres).

        Depths of zero or less are returned as they are. The pixels of a point that the camera does not see (`sees`) are
        meaningless. `project_with_derivative` also has the derivatives.
        """
        in_camera = points @ self.R.T + self.t
        distorted = self.lens.distort(in_camera, self.dist)
        return np.concatenate([distorted, np.ones_like(distorted[..., :1])], -1) @ self.K.T[:, :2], in_camera[..., 2]

    def project_with_derivative(
        self, points: Float64[np.ndarray, "n 3"]
    ) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2 3"]]:
        """Pixels of world points, and their derivatives by the points."""
        intrinsics = np.broadcast_to(self.intrinsics(), (len(points), len(PINHOLE_TERMS) + len(self.dist)))
        pixels, _, by_point = project_with_jacobian(self.lens, intrinsics, points @ self.R.T + self.t)
        return pixels, by_point @ self.R

    def sees(self, points: np.ndarray) -> np.ndarray:
        """Mask [...] of world points [..., 3] that the lens images, in the image or beside it."""
        return self.lens.sees(points @ self.R.T + self.t, self.dist)

    def undistort(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels [N, 2] of the distorted image to normalised image coordinates (x/z, y/z) [N, 2].

        NaN where a pinhole has no image: at rays of 90 degrees and more from the optical axis, and beyond the lens's
        field of view. `ray_directions` is for these.
        """
        rays = self.lens.undistort(pixels, self.K, self.dist)
        if self.lens.perspective:
            return np.ascontiguousarray(rays[:, :2])
        z = rays[:, 2:]
        return rays[:, :2] / np.where(z > LEAST_COSINE, z, np.nan)

    def ray_directions(self, pixels: np.ndarray) -> np.ndarray:
        """Unit directions [N, 3] in the world, from `center` through pixels [N, 2].

        NaN where the lens sees nothing.
        """
        directions = self.lens.undistort(pixels, self.K, self.dist) @ self.R
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def opencv_K(self) -> Float64[np.ndarray, "3 3"]:
        """Intrinsics for OpenCV functions, whose first pixel centre is (0, 0)."""
        K = self.K.copy()
        K[:2, 2] -= PIXEL_CENTER
        return K


def project_with_jacobian(
    lens: Lens, intrinsics: Float64[np.ndarray, "n intrinsics"], in_camera: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2 intrinsics"], Float64[np.ndarray, "n 2 3"]]:
    """Pixels of points in camera coordinates, and their derivatives.

    By `Camera.intrinsics` and by the point.
    """
    f, aspect, cx, cy = intrinsics[:, : len(PINHOLE_TERMS)].T
    fy = f * aspect
    distorted, by_point, by_terms = lens.jacobian(in_camera, intrinsics[:, len(PINHOLE_TERMS) :], np.stack([f, fy], 1))
    x, y = distorted.T
    zero, one = np.zeros_like(f), np.ones_like(f)
    by_pinhole = np.stack([np.stack([x, zero, one, zero], 1), np.stack([aspect * y, f * y, zero, one], 1)], 1)
    return np.stack([f * x + cx, fy * y + cy], -1), np.concatenate([by_pinhole, by_terms], -1), by_point


def write_cameras(path: Path, cameras: Mapping[str, Camera]) -> None:
    """Write `{"cameras": {id: {R, t, K, dist, width, height}}}`, at sensor resolution.

    A lens other than `BROWN_CONRADY` adds the key `lens`.
    """
    content = {
        name: {
            "R": c.R.tolist(), "t": c.t.tolist(), "K": c.K.tolist(), "dist": c.dist.tolist(),
            "width": c.width, "height": c.height, **({} if c.lens is BROWN_CONRADY else {"lens": c.lens.name}),
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
    name = entry.get("lens", BROWN_CONRADY.name)
    if not isinstance(name, str) or name not in LENSES:
        raise InputError(f"{where}: lens: expected one of {', '.join(LENSES)}, found {name!r}")
    lens, arrays = LENSES[name], {}
    for key, shape in {"R": (3, 3), "t": (3,), "K": (3, 3), "dist": (len(lens.terms),)}.items():
        try:
            arrays[key] = np.asarray(entry.get(key), dtype=np.float64)
        except (TypeError, ValueError):  # Text, or rows of unequal length.
            arrays[key] = np.array(np.nan)
        if arrays[key].shape != shape or not np.isfinite(arrays[key]).all():
            raise InputError(f"{where}: {key}: expected {shape} finite numbers, found {entry.get(key)}")
    for key in ("width", "height"):
        if not isinstance(entry.get(key), int) or entry[key] <= 0:
            raise InputError(f"{where}: {key}: expected a positive number of pixels, found {entry.get(key)}")
    return Camera(**arrays, width=entry["width"], height=entry["height"], lens=lens)
