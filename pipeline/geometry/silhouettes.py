"""Masks as signed distances to their outline, and the same from a mesh drawn into a view.

Drawn and given masks go through one distance transform, so that its half-pixel biases cancel when they are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from pipeline.geometry.cameras import Camera

SMOOTHING_PX = 0.7
"""Blur of the signed distance, about the staircase of a binary mask: its gradient then points across the outline."""

FARTHEST_PX = 30.0
"""Signed distances are clipped here: an outline further away is another limb's."""

HALF_COVERED = 128
"""Mask values from here on count as subject: coverage is rounded to 0..255."""

SUPERSAMPLING = 3
"""Samples per pixel and axis when the mesh is drawn: coverage is then good to a tenth of a pixel."""


@dataclass(frozen=True)
class View:
    """One camera's masks of all frames, as signed distances.

    Attributes:
        camera: at the masks' resolution.
        mask: at least half covered.
        distance: to the mask's outline, pixels, positive inside.
        usable: frames that have a mask with something in it.
    """

    camera: Camera
    mask: Bool[np.ndarray, "frames height width"]
    distance: Float32[np.ndarray, "frames height width"]
    usable: Bool[np.ndarray, " frames"]

    def at(self, frames: np.ndarray) -> View:
        """The view in some of the frames."""
        return View(self.camera, self.mask[frames], self.distance[frames], self.usable[frames])


def signed_distance(mask: UInt8[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Distance to the outline of `mask` in pixels, positive inside, clipped to `FARTHEST_PX`."""
    inside = (mask >= HALF_COVERED).astype(np.uint8)
    to_outside = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    to_inside = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # Pixel centres on either side of the outline are half a pixel from it, and 1 from each other.
    distance = np.where(inside > 0, to_outside - 0.5, 0.5 - to_inside)
    return cv2.GaussianBlur(np.clip(distance, -FARTHEST_PX, FARTHEST_PX).astype(np.float32), (0, 0), SMOOTHING_PX)


def view_from_masks(camera: Camera, masks: Sequence[UInt8[np.ndarray, "height width"] | None]) -> View:
    """Signed distances of one camera's masks; None where a frame has none."""
    distance = np.zeros((len(masks), camera.height, camera.width), np.float32)
    usable = np.array([mask is not None and bool((mask >= HALF_COVERED).any()) for mask in masks])
    inside = np.zeros(distance.shape, bool)
    for frame in np.flatnonzero(usable):
        distance[frame], inside[frame] = signed_distance(masks[frame]), masks[frame] >= HALF_COVERED
    return View(camera, inside, distance, usable)


@numba.njit(cache=True)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _fill_triangles(corners, height, width):
    """Pixels whose centre lies in any of the triangles [N, 3, 2], edges included."""
    filled = np.zeros((height, width), np.uint8)
    for n in range(corners.shape[0]):
        x, y = corners[n, :, 0], corners[n, :, 1]
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if not np.isfinite(area) or area == 0.0:
            continue
        sign = 1.0 if area > 0 else -1.0
        first_row, last_row = max(int(np.ceil(y.min() - 0.5)), 0), min(int(np.floor(y.max() - 0.5)), height - 1)
        first_column, last_column = max(int(np.ceil(x.min() - 0.5)), 0), min(int(np.floor(x.max() - 0.5)), width - 1)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                px, py = column + 0.5, row + 0.5
                within = True
                for a in range(3):
                    b = (a + 1) % 3
                    if sign * ((x[b] - x[a]) * (py - y[a]) - (y[b] - y[a]) * (px - x[a])) < 0:
                        within = False
                        break
                if within:
                    filled[row, column] = 1
    return filled


@numba.njit(cache=True)
@no_type_check
def _coverage(filled):
    """Share of each pixel's samples that are filled, 0..255."""
    coverage = np.empty((filled.shape[0] // SUPERSAMPLING, filled.shape[1] // SUPERSAMPLING), np.uint8)
    for row in range(coverage.shape[0]):
        for column in range(coverage.shape[1]):
            count = 0
            for i in range(SUPERSAMPLING):
                for j in range(SUPERSAMPLING):
                    count += filled[row * SUPERSAMPLING + i, column * SUPERSAMPLING + j]
            coverage[row, column] = int(255.0 * count / SUPERSAMPLING**2 + 0.5)
    return coverage


def draw_silhouette(
    camera: Camera, vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> UInt8[np.ndarray, "height width"]:
    """Coverage of each pixel by the mesh, 0..255. Triangles that reach behind the camera are left out."""
    pixels, depth = camera.project(vertices)
    corners = pixels[faces][(depth[faces] > 0).all(1)]
    size = camera.height * SUPERSAMPLING, camera.width * SUPERSAMPLING
    return _coverage(_fill_triangles(corners * SUPERSAMPLING, *size))


def silhouette_overlap(
    views: Sequence[View], vertices: Float64[np.ndarray, "frames vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> Float64[np.ndarray, " frames"]:
    """Intersection over union of drawn and given masks per frame, all views pooled; NaN for a frame without masks."""
    common, either = np.zeros(len(vertices)), np.zeros(len(vertices))
    for view in views:
        for frame in np.flatnonzero(view.usable):
            drawn = draw_silhouette(view.camera, vertices[frame], faces) >= HALF_COVERED
            given = view.mask[frame]
            common[frame] += (drawn & given).sum()
            either[frame] += (drawn | given).sum()
    return np.where(either > 0, common / np.maximum(either, 1), np.nan)
