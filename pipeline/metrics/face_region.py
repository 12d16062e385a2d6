"""Pixels that show a subject's face, as its template labels it or its eyes tell it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.lenses import BROWN_CONRADY
from pipeline.geometry.texels import face_vertices

ShownFace = Callable[[Any, Any], Bool[np.ndarray, "h w"]]
"""(frame record, image record) -> the pixels of the image that show the face."""


FACE_REACH, FACE_HALF_BREADTH = 1.9, 1.1
"""How far a face reaches from the point between its eyes, and how far along the line through them, in distances of one
eye from the other: to the chin, some 120 mm away at 63 mm between the eyes, and to cheekbones 140 mm apart."""


def known_face(
    regions: Mapping[str, Int[np.ndarray, " _"]], rest: Float[np.ndarray, "v 3"],
    eyes: Mapping[str, Int[np.ndarray, " _"]],
) -> Int64[np.ndarray, " _"]:  # fmt: skip
    """Vertices of the face; none if nothing tells what it is.

    Those labelled as such, or else moved by the head's joint, or else near the eyes.

    Args:
        regions: of the atlas.
        rest: vertices of the template at rest, metres.
        eyes: vertices of each eye, by name; of any number but two, nothing is taken.
    """
    labelled = face_vertices(regions)
    if len(labelled) or len(eyes) != 2:
        return labelled
    rest = rest.astype(np.float64)
    one, other = (rest[vertices].mean(0) for vertices in eyes.values())
    offset, apart = rest - (one + other) / 2, one - other
    near = np.linalg.norm(offset, axis=1) <= FACE_REACH * np.linalg.norm(apart)
    return np.flatnonzero(near & (np.abs(offset @ apart) <= FACE_HALF_BREADTH * (apart @ apart)))


def shown_face(faces: Int[np.ndarray, "faces 3"], vertices: Int[np.ndarray, " _"]) -> ShownFace | None:
    """Function that finds the pixels of an image whose centres show the face.

    It is seen on the tracked mesh, and so alike for all avatars. None where no triangle lies in the face.

    Args:
        faces: of the atlas.
        vertices: of the face, see `known_face`.
    """
    faces = np.asarray(faces, np.int64)
    own = faces[np.isin(faces, vertices).all(1)]
    if not len(own):
        return None

    def of_image(frame: Any, image: Any) -> Bool[np.ndarray, "h w"]:
        camera = Camera(image.R, image.t, image.K, BROWN_CONRADY.no_distortion(), image.width, image.height)
        vertices = frame.vertices.astype(np.float64)
        nearest, nearest_own = (draw_depth(camera, vertices, some) for some in (faces, own))
        return np.isfinite(nearest_own) & (nearest_own <= nearest)  # the same triangles have the same depths

    return of_image
