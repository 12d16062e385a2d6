"""Masks as signed distances to their outline, and the same from a mesh drawn into a view.

Drawn and given masks go through one distance transform, so that its half-pixel biases cancel when they are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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

CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
"""A pixel and its four neighbours."""

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
        binary: whether no pixel of the masks is partly covered; what is compared with them has to be rounded, too.
    """

    camera: Camera
    mask: Bool[np.ndarray, "frames height width"]
    distance: Float32[np.ndarray, "frames height width"]
    usable: Bool[np.ndarray, " frames"]
    binary: bool

    def at(self, frames: np.ndarray) -> View:
        """The view in some of the frames."""
        return replace(self, mask=self.mask[frames], distance=self.distance[frames], usable=self.usable[frames])

    def drawn(
        self, vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
    ) -> UInt8[np.ndarray, "height width"]:
        """The mask that this view would have of a mesh, 0..255."""
        coverage = draw_silhouette(self.camera, vertices, faces)
        return np.where(coverage >= HALF_COVERED, 255, 0).astype(np.uint8) if self.binary else coverage


def signed_distance(mask: UInt8[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Distance to the outline of `mask` in pixels, positive inside, clipped to `FARTHEST_PX`.

    Coverage places the outline within a pixel: one of coverage c, 0..1, is c - 1/2 from it, as for an edge along rows
    or columns (Gustavson and Strand, "Anti-aliased Euclidean distance transform", 2011). Counting pixels of at least
    half coverage instead would count all ties as inside: a fifth of a pixel too much where masks were halved in size.
    """
    inside = mask >= HALF_COVERED
    full = (mask == 255).astype(np.uint8)
    # Pixels that the outline passes, and full ones beside empty ones.
    beside_empty = cv2.erode((mask > 0).astype(np.uint8), CROSS, borderType=cv2.BORDER_REPLICATE) == 0
    edge = (mask > 0) & ((full == 0) | beside_empty)
    if not edge.any():
        return np.full(mask.shape, FARTHEST_PX if inside.any() else -FARTHEST_PX, np.float32)
    away, nearest = cv2.distanceTransformWithLabels(
        (~edge).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE, labelType=cv2.DIST_LABEL_PIXEL
    )
    offset = np.zeros(nearest.max() + 1, np.float32)
    offset[nearest[edge]] = mask[edge] / np.float32(255) - np.float32(0.5)
    distance = np.where(inside, away, -away) + offset[nearest]
    return cv2.GaussianBlur(np.clip(distance, -FARTHEST_PX, FARTHEST_PX).astype(np.float32), (0, 0), SMOOTHING_PX)


def view_from_masks(camera: Camera, masks: Sequence[UInt8[np.ndarray, "height width"] | None]) -> View:
    """Signed distances of one camera's masks; None where a frame has none."""
    distance = np.zeros((len(masks), camera.height, camera.width), np.float32)
    usable = np.array([mask is not None and bool((mask >= HALF_COVERED).any()) for mask in masks])
    inside = np.zeros(distance.shape, bool)
    for frame in np.flatnonzero(usable):
        distance[frame], inside[frame] = signed_distance(masks[frame]), masks[frame] >= HALF_COVERED
    binary = all(np.isin(masks[frame], (0, 255)).all() for frame in np.flatnonzero(usable))
    return View(camera, inside, distance, usable, binary)


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
    """Intersection over union of drawn and given masks per frame, all views pooled.

    NaN for a frame without masks.
    """
    common, either = np.zeros(len(vertices)), np.zeros(len(vertices))
    for view in views:
        for frame in np.flatnonzero(view.usable):
            drawn = view.drawn(vertices[frame], faces) >= HALF_COVERED
            given = view.mask[frame]
            common[frame] += (drawn & given).sum()
            either[frame] += (drawn | given).sum()
    return np.where(either > 0, common / np.maximum(either, 1), np.nan)
