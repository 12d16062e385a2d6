"""Depth of a mesh as a camera sees it, and points seen well enough to compare colours."""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from pipeline.geometry.cameras import Camera

LEAST_COSINE = 0.3
"""Between a surface and the way to the camera; below it (72 degrees) a pixel covers three times its own width."""

DEPTH_STEP_M = 0.05
"""Depths of neighbouring pixels on one surface differ by less: at `LEAST_COSINE` it is three pixel widths on the
subject per pixel, 30 mm at a centimetre per pixel, and rounding of the posed mesh."""


@numba.njit(cache=True)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _fill_depth(corners, depths, height, width):
    """Least depth over the triangles [N, 3, 2] that contain each pixel's centre; 1/depth is linear in the image."""
    nearest = np.full((height, width), np.inf, np.float32)
    for n in range(corners.shape[0]):
        x, y = corners[n, :, 0], corners[n, :, 1]
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if not np.isfinite(area) or area == 0.0:
            continue
        first_row, last_row = max(int(np.ceil(y.min() - 0.5)), 0), min(int(np.floor(y.max() - 0.5)), height - 1)
        first_column, last_column = max(int(np.ceil(x.min() - 0.5)), 0), min(int(np.floor(x.max() - 0.5)), width - 1)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                px, py = column + 0.5, row + 0.5
                inverse, within = 0.0, True
                for a in range(3):
                    b, c = (a + 1) % 3, (a + 2) % 3
                    share = ((x[c] - x[b]) * (py - y[b]) - (y[c] - y[b]) * (px - x[b])) / area
                    if share < 0:
                        within = False
                        break
                    inverse += share / depths[n, a]
                if within:
                    nearest[row, column] = min(nearest[row, column], 1.0 / inverse)
    return nearest


def draw_depth(
    camera: Camera, vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> Float32[np.ndarray, "height width"]:
    """Depth of the nearest surface at each pixel's centre, metres; infinite where there is none.

    Triangles that reach behind the camera are left out.
    """
    pixels, depth = camera.project(vertices)
    front = (depth[faces] > 0).all(1)
    return _fill_depth(pixels[faces][front], depth[faces][front], camera.height, camera.width)


def seen_well(
    camera: Camera,
    depth_map: Float32[np.ndarray, "height width"],
    points: Float64[np.ndarray, "points 3"],
    normals: Float64[np.ndarray, "points 3"],
    step_m: float = DEPTH_STEP_M,
) -> Bool[np.ndarray, " points"]:
    """Points that a camera sees, away from other surfaces.

    They face the camera, and around their pixel (3 x 3) the depth map shows their own surface only: what is within
    `step_m` of their depth.
    """
    pixels, depth = camera.project(points)
    way = camera.center - points
    facing = (way * normals).sum(1) > LEAST_COSINE * np.linalg.norm(way, axis=1)
    inside = (pixels > 1).all(1) & (pixels < [camera.width - 1, camera.height - 1]).all(1)
    seen = np.flatnonzero(facing & inside & (depth > 0))
    column, row = np.floor(pixels[seen]).astype(np.int64).T
    own = np.ones(len(seen), bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            own &= np.abs(depth_map[row + down, column + right] - depth[seen]) < step_m
    result = np.zeros(len(points), bool)
    result[seen[own]] = True
    return result
