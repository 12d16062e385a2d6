"""Level lines of the rest pose's coordinates, drawn on the posed surface.

They read like a grid at any mesh density.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import DEPTH_STEP_M, draw_depth
from pipeline.geometry.surface_points import SurfacePoints

LINES_ACROSS = 30
"""Lines over the longest extent of the rest pose: a hand's breadth on a body."""


def level_lines(vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]) -> SurfacePoints:
    """Both ends of every piece of the level lines, alternating.

    Planes of equal x, y or z of the rest pose cut faces there.
    """
    step = np.ptp(vertices, axis=0).max() / LINES_ACROSS
    corners, weights = [np.zeros((0, 2, 3), np.int64)], [np.zeros((0, 2, 3))]
    for axis in range(3):
        # Off the vertices, which often lie on round numbers.
        height = (vertices[faces, axis] - vertices[:, axis].min()) / step + 0.4937
        low, high = np.ceil(height.min(1)).astype(int), np.floor(height.max(1)).astype(int)
        for level in range(low.min(), high.max() + 1):
            cut = np.flatnonzero((low <= level) & (level <= high))
            above = height[cut] > level
            crossing = above != np.roll(above, -1, axis=1)
            cut, crossing = cut[crossing.sum(1) == 2], crossing[crossing.sum(1) == 2]
            first = np.nonzero(crossing)[1].reshape(-1, 2)
            second = (first + 1) % 3
            a, b = (np.take_along_axis(height[cut], corner, 1) for corner in (first, second))
            share = (level - a) / (b - a)
            ends = np.zeros((len(cut), 2, 3))
            np.put_along_axis(ends, first[..., None], 1 - share[..., None], 2)
            np.put_along_axis(ends, second[..., None], share[..., None], 2)
            corners.append(np.repeat(faces[cut][:, None], 2, axis=1))
            weights.append(ends)
    return SurfacePoints(np.concatenate(corners).reshape(-1, 3), np.concatenate(weights).reshape(-1, 3))


def seen_lines(
    lines: SurfacePoints, camera: Camera, vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "f 3"]
) -> Float64[np.ndarray, "pieces 2 2"]:
    """Pieces of `level_lines` that face the camera and that nothing hides: their ends, pixels."""
    a, b, c = np.moveaxis(vertices[lines.corners[::2]], 1, 0)
    facing = (np.cross(b - a, c - a) * (camera.center - a)).sum(1) > 0
    ends = lines.carried(vertices).reshape(-1, 2, 3)[facing]
    pixels, depth = camera.project(ends)
    middle = pixels.mean(1)
    inside = (depth > 0).all(1) & (middle > 0).all(1) & (middle < [camera.width, camera.height]).all(1)
    pixels, middle, depth = pixels[inside], middle[inside].astype(np.int64), depth[inside].mean(1)
    nearest = draw_depth(camera, vertices, faces)[middle[:, 1], middle[:, 0]]
    return pixels[depth < nearest + DEPTH_STEP_M]
