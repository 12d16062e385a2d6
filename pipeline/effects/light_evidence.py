"""Cheap measurements for effects of light: distant occluders, and lights that are near."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas
from pipeline.lighting.visibility import Occluders

PosedFrame = tuple[np.ndarray, Float64[np.ndarray, "_ 3"]]
"""Posed vertices [v, 3] of a frame and the positions of its lit lights (at least one)."""


def texel_points(
    atlas: Atlas, vertices: np.ndarray, texels: np.ndarray
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Posed points of some texels and unit normals of their faces, float64.

    Normals are zero for a face without area.
    """
    corners = vertices.astype(np.float64)[atlas.corners[texels]]
    points = (corners * atlas.barycentric[texels, :, None]).sum(1)
    triangles = np.arange(3 * len(texels)).reshape(-1, 3)
    return points, unit_or(area_vectors(corners.reshape(-1, 3), triangles), 0.0)


@dataclass(frozen=True)
class FacingPairs:
    """Random pairs of a texel and a light that it faces. `blocked`: those that are from afar."""

    texels: Int64[np.ndarray, " n"]
    blocked: Bool[np.ndarray, " n"]


def facing_pairs(
    atlas: Atlas, frames: Iterable[PosedFrame], local_radius: float, pairs_per_frame: int, random: np.random.Generator
) -> FacingPairs:
    """Draw pairs of a texel and a light that it faces, and find those blocked from afar.

    Blocked are those by a surface further than `local_radius`: what blocks from nearer is shape that the local frame
    and normal already stand for.
    """
    found: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(0, np.int64), np.zeros(0, bool))]
    for vertices, positions in frames:
        texels = random.integers(atlas.texel_count, size=pairs_per_frame)
        points, normals = texel_points(atlas, vertices, texels)
        lights = positions[random.integers(len(positions), size=pairs_per_frame)]
        above = ((lights - points) * normals).sum(1) > 0
        if above.any():
            hits = Occluders(vertices, atlas.faces).first_hits(points[above], normals[above], lights[above])
            found.append((texels[above], (hits > local_radius) & np.isfinite(hits)))
    return FacingPairs(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))


def falloff_spread(
    atlas: Atlas, frames: Iterable[PosedFrame], points_per_frame: int, random: np.random.Generator, percentile: float
) -> float:
    """Unevenness of lights: a percentile of |L(v) / L(centre) - 1| over texels v and lit lights.

    L is I / d^2, so intensities cancel; the centre is the mean of the texels drawn. 0 if there are no frames.
    """
    deviations = []
    for vertices, positions in frames:
        points, _ = texel_points(atlas, vertices, random.integers(atlas.texel_count, size=points_per_frame))
        from_center = ((positions - points.mean(0)) ** 2).sum(1)
        from_point = ((positions - points[:, None]) ** 2).sum(2)
        deviations.append(np.abs(from_center / np.maximum(from_point, np.finfo(np.float64).tiny) - 1).ravel())
    return float(np.percentile(np.concatenate(deviations), percentile)) if deviations else 0.0
