"""Which points of a posed mesh see which lights: shadow rays through Embree (Wald et al. 2014), at any scale."""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Float64, Int

ORIGIN_OFFSET = 64 * 2.0**-23
"""How far above its face a ray starts, relative to the scene's half extent: 7.6e-6, or 7 micrometres on a body.

Embree computes in float32 on the scene scaled to [-1, 1], where neighbouring numbers are 2^-23 apart or closer.
Rounding moves each coordinate of the corners and of the origin by at most 2^-24, so the origin leaves its face's plane
by at most 2 x sqrt(3) x 2^-24 = 1.7 x 2^-23; the plane distance that Embree computes from them adds a handful of
roundings of numbers up to 2, another 8 x 2^-23 or so. 64 leaves a factor of six. Along the face's own (geometric)
normal all of the offset is clearance; along a shading normal at angle a to it only cos(a) would be, so the geometric
one is used. The price: what occludes from closer than the offset is not seen."""

LIGHT_CLEARANCE = 16 * 2.0**-23
"""Share of the way to a light that a ray leaves out at its end: a lamp's own housing is no occluder, and float32
distances are good to a few 2^-23."""


class Occluders:
    """A triangle mesh to cast shadow rays against. Both sides of a face occlude; faces without area never do.

    Building costs milliseconds, so a scene is built per frame. Queries may run from several threads at once: Embree
    releases the interpreter's lock.
    """

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        """Raises:
        ValueError: if a vertex is not finite (Embree would silently lose its faces), or there are no faces.
        """
        if not len(faces) or not np.isfinite(vertices).all():
            raise ValueError(f"expected faces with finite vertices, found {len(faces)} faces")
        used = vertices[np.unique(faces)].astype(np.float64)
        self.center = (used.min(0) + used.max(0)) / 2
        self.half_extent = float(np.ptp(used, axis=0).max() / 2) or 1.0
        self._scene = EmbreeScene(robust=True)
        scaled = self._scaled(vertices)
        TriangleMesh(self._scene, np.ascontiguousarray(scaled[faces]))
        # The first query builds the tree; done here so that threads find it built.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 1, 0]], np.float32), query="OCCLUDED")

    def _scaled(self, points: np.ndarray) -> Float[np.ndarray, "n 3"]:
        return ((points.astype(np.float64) - self.center) / self.half_extent).astype(np.float32)

    def visible(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        lights: Float[np.ndarray, "*#rows 3"],
    ) -> tuple[Bool[np.ndarray, " n"], int]:
        """Whether each point sees its light, and the number of rays it took.

        A light on or below the horizon of the point's face is hidden by that face: known without a ray.

        Args:
            points: on the mesh.
            face_normals: outward unit normals of the points' faces (geometric, not smoothed; see `ORIGIN_OFFSET`).
            lights: positions, one per point or one [3] for all.
        """
        above = np.flatnonzero(((lights - points) * face_normals).sum(-1) > 0)
        seen = np.zeros(len(points), bool)
        if len(above):
            origins, directions, distances = self._rays(points[above], face_normals[above], _rows(lights, above))
            seen[above] = self._scene.run(origins, directions, dists=distances, query="OCCLUDED") == -1
        return seen, len(above)

    def first_hits(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        lights: Float[np.ndarray, "*#rows 3"],
    ) -> Float64[np.ndarray, " n"]:
        """Distance from each point to the first surface on its way to the light; infinite if there is none."""
        origins, directions, distances = self._rays(points, face_normals, lights)
        # embreex writes the hits into the array of lengths that it is given; a ray without one keeps its length.
        hits = np.asarray(self._scene.run(origins, directions, dists=distances.copy(), query="DISTANCE"))
        return np.where(hits < distances, hits.astype(np.float64) * self.half_extent, np.inf)

    def _rays(
        self, points: np.ndarray, face_normals: np.ndarray, lights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Origins, unit directions and lengths in Embree's scaled scene, float32."""
        origins = (points.astype(np.float64) - self.center) / self.half_extent + ORIGIN_OFFSET * face_normals
        way = (np.asarray(lights, np.float64) - self.center) / self.half_extent - origins
        distances = np.linalg.norm(way, axis=1)
        directions = way / np.maximum(distances, np.finfo(np.float64).tiny)[:, None]
        lengths = distances * (1 - LIGHT_CLEARANCE)
        return origins.astype(np.float32), directions.astype(np.float32), lengths.astype(np.float32)


def _rows(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return values[rows] if values.ndim == 2 else values
