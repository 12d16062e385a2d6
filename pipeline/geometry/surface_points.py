"""Points spread over a template's surface: each fixed to a face, or vertices of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.seeds import generator_for
from pipeline.geometry.mesh import area_vectors


@dataclass(frozen=True)
class SurfacePoints:
    """Points on faces: vertex indices of the face's corners and the weights of these."""

    corners: Int64[np.ndarray, "points 3"]
    barycentric: Float64[np.ndarray, "points 3"]

    def __len__(self) -> int:
        return len(self.corners)

    def carried(self, values: Float64[np.ndarray, "*batch vertices 3"]) -> Float64[np.ndarray, "*batch points 3"]:
        """Values at vertices, interpolated."""
        return (values[..., self.corners, :] * self.barycentric[:, :, None]).sum(-2)


def spread_points(
    vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"], count: int
) -> SurfacePoints:
    """`count` points, evenly by area, drawn at random.

    One in each of `count` equal parts of the faces' summed area.
    """
    random = generator_for("spread_points", count)
    area = np.linalg.norm(area_vectors(vertices, faces), axis=1).cumsum()
    face = np.searchsorted(area, (np.arange(count) + random.random(count)) / count * area[-1])
    u, v = np.sqrt(random.random(count)), random.random(count)
    return SurfacePoints(faces[np.minimum(face, len(faces) - 1)], np.stack([1 - u, u * (1 - v), u * v], 1))


def at_vertices(vertices: Int64[np.ndarray, " points"]) -> SurfacePoints:
    """Points that are vertices."""
    return SurfacePoints(np.repeat(vertices[:, None], 3, 1), np.tile([1.0, 0.0, 0.0], (len(vertices), 1)))


def spread_vertices(vertices: Float64[np.ndarray, "vertices 3"], count: int) -> Int64[np.ndarray, " chosen"]:
    """Up to `count` vertices spread evenly over the surface.

    Farthest-point sampling, from the first vertex on.
    """
    chosen = [0]
    distance2 = ((vertices - vertices[0]) ** 2).sum(1)
    while len(chosen) < min(count, len(vertices)) and distance2.max() > 0:
        chosen.append(int(distance2.argmax()))
        distance2 = np.minimum(distance2, ((vertices - vertices[chosen[-1]]) ** 2).sum(1))
    return np.array(sorted(chosen), np.int64)
