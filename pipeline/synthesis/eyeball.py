"""Eyeballs of the procedural head: the union of two spheres, eyeball and cornea.

The cornea's centre lies towards the gaze. Everything here is in the eye's own frame: origin at the eyeball's centre,
gaze +z, metres. The template has a coarse mesh of an eye; photographed is a fine one with the spheres' own normals, so
that a glint lies where the mirror law of a sphere puts it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.conventions import PIXEL_CENTER

EYE_NAMES = ("left", "right")
EYE_CENTERS_M = np.array([[0.032, 0.010, 0.0625], [-0.032, 0.010, 0.0625]])
"""Of the eyeballs in the resting head."""

EYE_RADIUS_M, CORNEA_RADIUS_M, CORNEA_OFFSET_M = 0.0125, 0.0078, 0.0057
"""Of a grown person's size: the cornea bulges by 1 mm."""

LIMBUS_Z_M = (CORNEA_OFFSET_M**2 + EYE_RADIUS_M**2 - CORNEA_RADIUS_M**2) / (2 * CORNEA_OFFSET_M)
LIMBUS_RADIUS_M = float(np.sqrt(EYE_RADIUS_M**2 - LIMBUS_Z_M**2))
"""The circle in which the spheres meet: its height along the gaze, and its radius, 5.5 mm."""

EYE_SUBDIVISIONS = 3
"""Of the template's icosahedron: 642 vertices, edges of about 1.8 mm. Its vertices are spread evenly, so their mean is
the eyeball's centre to 0.1 mm, and a tracker that turns the part about its mean turns it as an eye turns."""

SEGMENTS, CORNEA_RINGS, SCLERA_RINGS = 96, 24, 40
"""Of the photographed mesh: edges of 0.4 mm around the limbus, 2 microns off the circle."""


@dataclass(frozen=True)
class Patch:
    """A piece of the photographed eye with the normals of its sphere.

    `uv` look up the texture whose texels show `eye_directions`.
    """

    vertices: Float64[np.ndarray, "v 3"]
    normals: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    uv: Float64[np.ndarray, "v 2"]


def radius_along(directions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Distance from the eyeball's centre to its surface, cornea included, along unit directions."""
    ahead = directions[:, 2]
    off_axis = CORNEA_RADIUS_M**2 - CORNEA_OFFSET_M**2 * (1 - ahead**2)
    cornea = CORNEA_OFFSET_M * ahead + np.sqrt(np.maximum(off_axis, 0))
    return np.where((ahead > 0) & (off_axis > 0), np.maximum(cornea, EYE_RADIUS_M), EYE_RADIUS_M)


def template_eyeball() -> tuple[Float64[np.ndarray, "v 3"], Int64[np.ndarray, "f 3"]]:
    """The coarse mesh; vertex 0, the pupil's, lies at the cornea's apex."""
    import trimesh  # With all that it can do, half a second that only captures with eyes have to spend.

    sphere = trimesh.creation.icosphere(EYE_SUBDIVISIONS)
    turn = trimesh.geometry.align_vectors(sphere.vertices[0], [0.0, 0.0, 1.0])
    directions = np.asarray(sphere.vertices) @ turn[:3, :3].T
    return radius_along(directions)[:, None] * directions, np.asarray(sphere.faces, np.int64)


def cornea_patch() -> Patch:
    """The cap of the cornea's sphere in front of the limbus."""
    widest = np.arctan2(LIMBUS_RADIUS_M, LIMBUS_Z_M - CORNEA_OFFSET_M)
    return _revolved(np.linspace(0, widest, CORNEA_RINGS + 1), CORNEA_RADIUS_M, CORNEA_OFFSET_M)


def sclera_patch() -> Patch:
    """The eyeball's sphere behind the limbus."""
    narrowest = np.arctan2(LIMBUS_RADIUS_M, LIMBUS_Z_M)
    return _revolved(np.linspace(narrowest, np.pi, SCLERA_RINGS + 1), EYE_RADIUS_M, 0.0)


def _revolved(angles: Float64[np.ndarray, " rings"], radius: float, offset: float) -> Patch:
    """Rings of a sphere about +z at these angles from it."""
    around = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    angle, turn = (a.ravel() for a in np.meshgrid(angles, around, indexing="ij"))
    normals = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
    vertices = radius * normals + [0.0, 0.0, offset]
    ring, step = (a.ravel() for a in np.meshgrid(np.arange(len(angles) - 1), np.arange(SEGMENTS), indexing="ij"))
    corner, beside = ring * SEGMENTS + step, ring * SEGMENTS + (step + 1) % SEGMENTS
    faces = np.concatenate(
        [np.stack([corner, corner + SEGMENTS, beside + SEGMENTS], 1), np.stack([corner, beside + SEGMENTS, beside], 1)]
    )
    area = np.linalg.norm(np.cross(*(vertices[faces[:, i]] - vertices[faces[:, 0]] for i in (1, 2))), axis=1)
    return Patch(vertices, normals, faces[area > 1e-6 * area.max()], eye_uv(vertices))  # none at the poles


def eye_uv(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
    """Azimuthal equidistant texture coordinates of points of an eye.

    The gaze is in the middle, the back of the eye on a circle that touches the borders.
    """
    around = np.hypot(points[:, 0], points[:, 1])
    share = np.arctan2(around, points[:, 2]) / np.pi / np.where(around > 0, around, 1.0)
    return 0.5 + 0.5 * share[:, None] * points[:, :2]


def eye_directions(size: int) -> Float64[np.ndarray, "texels 3"]:
    """Unit directions from the eyeball's centre that the texels of a square texture show.

    They come row by row, row 0 at v = 0. Texels outside the circle repeat the back of the eye.
    """
    v, u = (np.mgrid[:size, :size].reshape(2, -1) + PIXEL_CENTER) / size
    x, y = 2 * u - 1, 2 * v - 1
    reach = np.hypot(x, y)
    angle = np.pi * np.minimum(reach, 1.0)
    across = np.sin(angle) / np.maximum(reach, 1e-12)
    return np.stack([across * x, across * y, np.cos(angle)], axis=1)
