"""A pose as the networks see it.

Points of the tracked surface, moved back by the root's transform (RFGCA 3).

The points stand for the papers' 3D keypoints. They are points of the tracked mesh, which was fitted to the keypoints,
because every posed frame has them: also those whose keypoints nobody saw, templates without joints, and poses that were
never filmed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64, Int64
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.geometry.surface_points import spread_vertices
from pipeline.geometry.texels import Atlas, face_vertices

FEWEST_POINTS = 4
"""Three points fix a rigid motion; a fourth is what may move."""


def body_points(atlas: Atlas, count: int) -> Int64[np.ndarray, " points"]:
    """Vertices spread evenly over the template."""
    return spread_vertices(atlas.rest_vertices.astype(np.float64), count)


def face_points(atlas: Atlas, face: Sequence[float], count: int) -> Int64[np.ndarray, " points"]:
    """Vertices spread evenly over the part of the template that `face` declares.

    Args:
        atlas: for its template at rest.
        face: x, y, z of the middle and a radius, metres, on the template at rest.
        count: at most so many.

    Raises:
        InputError: if these are not four numbers, or hold too little of the template.
    """
    if len(face) != 4 or face[3] <= 0:
        raise InputError(f"--face: expected x y z and a radius above 0 [m], found {list(face)}")
    rest = atlas.rest_vertices.astype(np.float64)
    inside = np.flatnonzero(np.linalg.norm(rest - np.array(face[:3]), axis=1) < face[3])
    chosen = inside[spread_vertices(rest[inside], count)] if len(inside) else inside
    if len(chosen) < FEWEST_POINTS:
        low, high = (np.round(corner, 2).tolist() for corner in (rest.min(0), rest.max(0)))
        raise InputError(
            f"--face: expected at least {FEWEST_POINTS} vertices of the template inside {list(face)}, found "
            f"{len(chosen)}; the template at rest reaches from {low} to {high} m"
        )
    return chosen


def labelled_face(atlas: Atlas, count: int) -> Int64[np.ndarray, " points"]:
    """Vertices spread evenly over the face that the template labels, or else over its head.

    Fewer than `FEWEST_POINTS`, or none, if it labels neither.
    """
    inside = face_vertices(atlas.regions)
    rest = atlas.rest_vertices.astype(np.float64)
    return inside[spread_vertices(rest[inside], count)] if len(inside) else inside


def pose_offsets(
    rest: Float[np.ndarray, "points 3"], posed: Float[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points 3"]:
    """Motion of each point, in units of their extent, less the motion of all together.

    That motion, the root's, is the rigid one that brings the posed points nearest to those at rest (Kabsch 1976). So
    the result knows of no place in the world and no way the subject faces. The extent is the root mean square distance
    from the points' middle at rest.
    """
    still, moved = (points.astype(np.float64) - points.astype(np.float64).mean(0) for points in (rest, posed))
    back = Rotation.align_vectors(still, moved)[0]
    extent = max(float(np.sqrt((still**2).sum(1).mean())), np.finfo(np.float32).tiny)
    return (back.apply(moved) - still) / extent
