"""Pixels that show a subject's face, as its template labels it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.lenses import BROWN_CONRADY
from pipeline.geometry.texels import face_vertices

ShownFace = Callable[[Any, Any], Bool[np.ndarray, "h w"]]
"""(frame record, image record) -> the pixels of the image that show the face."""


def shown_face(faces: Int[np.ndarray, "faces 3"], regions: Mapping[str, Int[np.ndarray, " _"]]) -> ShownFace | None:
    """Function that finds the pixels of an image whose centres show the face.

    None where nothing says what that is. The face is what the template labels so (`template.regions`), or else what the
    joint of its keypoint `head` moves. It is seen on the tracked mesh, and so alike for all avatars.

    Args:
        faces, regions: of the atlas.
    """
    faces = np.asarray(faces, np.int64)
    own = faces[np.isin(faces, face_vertices(regions)).all(1)]
    if not len(own):
        return None

    def of_image(frame: Any, image: Any) -> Bool[np.ndarray, "h w"]:
        camera = Camera(image.R, image.t, image.K, BROWN_CONRADY.no_distortion(), image.width, image.height)
        vertices = frame.vertices.astype(np.float64)
        nearest, nearest_own = (draw_depth(camera, vertices, some) for some in (faces, own))
        return np.isfinite(nearest_own) & (nearest_own <= nearest)  # the same triangles have the same depths

    return of_image
