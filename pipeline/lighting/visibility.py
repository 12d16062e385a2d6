"""Visibility of lights from a posed mesh, by shadow rays at any scale. Embree (Wald et al. 2014) answers them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from pipeline.lighting.embree import EmbreeMesh
from pipeline.lighting.ray_kernels import aim
from pipeline.lighting.shadow_rays import Rays, Receivers

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


FARTHEST = 8.0
"""Length of a ray to a distant light in half extents: the whole scene lies within 2 sqrt(3) of any of its points."""


ENDLESS = np.float32(1e37)
"""Length of a ray that goes on until it meets something."""


class Occluders:
    """A triangle mesh to cast shadow rays against. Both sides of a face occlude; faces without area never do.

    Building costs milliseconds, so a tree is built per frame. Building and asking release the interpreter's lock.

    Attributes:
        center, half_extent: of the mesh; its scene in Embree is centred, the half extent 1.
        mesh: that scene.
    """

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        """Build the scene of a mesh.

        Raises:
            ValueError: if a vertex is not finite (Embree would silently lose its faces), or there are no faces.
        """
        if not len(faces) or not np.isfinite(vertices).all():
            raise ValueError(f"expected faces with finite vertices, found {len(faces)} faces")
        used = vertices[np.bincount(faces.ravel(), minlength=len(vertices)) > 0]
        # Along rows: along columns, NumPy takes seven times as long.
        rows = np.ascontiguousarray(used.T, np.float64)
        low, high = rows.min(1), rows.max(1)
        self.center = (low + high) / 2
        self.half_extent = float((high - low).max() / 2) or 1.0
        self.mesh = EmbreeMesh(self.scaled(vertices).astype(np.float32), faces)

    def scaled(self, points: Float[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3"]:
        """Points in Embree's scene: centred, the half extent 1."""
        return (np.asarray(points, np.float64) - self.center) / self.half_extent

    def aim(
        self,
        receivers: Receivers,
        lights: Float64[np.ndarray, "m 3"],
        distant: bool = False,
        *,
        chosen: Int[np.ndarray, " n"] | None = None,
        block: range = range(0),
    ) -> Rays:
        """Rays from receivers to lights above the horizon of the receiver's face.

        A light on or below it is hidden by the face itself, on open meshes as well: known without a ray.

        Args:
            lights: positions, or with `distant` unit directions towards them.
            chosen: index of each receiver's light; or, if not given,
            block: lights that all receivers are joined with.
        """
        rays = Rays.room_for(len(receivers) * (len(block) if chosen is None else 1))
        chosen = np.empty(0, np.int32) if chosen is None else chosen
        return rays.first(
            aim(
                receivers.points, receivers.normals, lights, distant, chosen, block.start, *self.frame, *rays.arrays()
            )
        )  # fmt: skip

    @property
    def frame(self) -> tuple[np.ndarray, float, float, float, float]:
        """Arguments from `center` to `farthest` of the kernels that write rays in Embree's scene."""
        return self.center, self.half_extent, ORIGIN_OFFSET, LIGHT_CLEARANCE, FARTHEST

    def occluded(self, rays: Rays) -> Int[np.ndarray, " r"]:
        """Embree's answer per ray: -1 where it meets nothing."""
        return self.mesh.occluded(rays.origins, rays.directions, rays.lengths)

    def visible(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        lights: Float[np.ndarray, "*#rows 3"],
    ) -> tuple[Bool[np.ndarray, " n"], int]:
        """Trace whether each point sees its light, and tell the number of rays it took.

        Args:
            points: on the mesh.
            face_normals: outward unit normals of the points' faces.
            lights: positions, one per point or one [3] for all.
        """
        rays = self._rays(points, face_normals, lights)
        seen = np.zeros(len(points), bool)
        seen[rays.rows[:, 0]] = self.occluded(rays) == -1
        return seen, len(rays.rows)

    def first_hits(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        lights: Float[np.ndarray, "*#rows 3"],
    ) -> Float64[np.ndarray, " n"]:
        """Distance from each point to the first surface on its way to the light.

        Infinite if there is none.

        NaN where the light is below the horizon.
        """
        rays, found = self._rays(points, face_normals, lights), np.full(len(points), np.nan)
        face, distance, _ = self.mesh.nearest(rays.origins, rays.directions, rays.lengths)
        found[rays.rows[:, 0]] = np.where(face >= 0, distance.astype(np.float64) * self.half_extent, np.inf)
        return found

    def first_faces(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """The first face on the way from each point, and where it is hit (barycentric).

        -1 if there is none.

        Also -1 for directions below the horizon of the point's face.
        """
        face, at = np.full(len(points), -1, np.int32), np.zeros((len(points), 3), np.float32)
        rows = np.flatnonzero(np.einsum("nd,nd->n", directions, face_normals) > 0)
        origins = self.scaled(points[rows]) + ORIGIN_OFFSET * face_normals[rows]
        ways, lengths = directions[rows].astype(np.float32), np.full(len(rows), ENDLESS)
        face[rows], _, hit = self.mesh.nearest(origins.astype(np.float32), ways, lengths)
        u, v = hit.T
        at[rows] = np.stack([1 - u - v, u, v], 1)
        return face, at

    def _rays(self, points: np.ndarray, face_normals: np.ndarray, lights: np.ndarray) -> Rays:
        chosen = np.arange(len(points)) if lights.ndim == 2 else np.zeros(len(points), np.int64)
        arrays = (np.ascontiguousarray(array, np.float64) for array in (points, face_normals, np.atleast_2d(lights)))
        points, face_normals, lights = arrays
        return self.aim(Receivers(points, face_normals), lights, chosen=chosen)
