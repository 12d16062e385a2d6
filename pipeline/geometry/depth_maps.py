"""Depth of a mesh as a camera sees it, and points seen well enough to compare colours."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.raster_kernels import fill_depth

LEAST_COSINE = 0.3
"""Between a surface and the way to the camera; below it (72 degrees) a pixel covers three times its own width."""

DEPTH_STEP_M = 0.05
"""Depths of neighbouring pixels on one surface differ by less: at `LEAST_COSINE` it is three pixel widths on the
subject per pixel, 30 mm at a centimetre per pixel, and rounding of the posed mesh."""


def draw_depth(
    camera: Camera, vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> Float32[np.ndarray, "height width"]:
    """Depth of the nearest surface at each pixel's centre, metres; infinite where there is none.

    Triangles that reach behind the camera are left out.
    """
    return fill_depth(*camera.project(vertices), faces, camera.height, camera.width)


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
