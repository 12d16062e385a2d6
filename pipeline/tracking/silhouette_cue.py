"""The silhouette cue: fits a posed mesh to the silhouettes in masks.

It tells what keypoints leave open (heads, hands, twist of limbs). Around the current pose the mesh is drawn into each
view, and the vertices that lie near its drawn silhouette are kept, each with its signed distance to it. They are then
asked to have the same signed distance to the mask's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.least_squares import CAUCHY
from pipeline.geometry.sampling import EDGE_PX
from pipeline.geometry.signed_distance import View, signed_distance
from pipeline.geometry.surface_points import SurfacePoints, at_vertices
from pipeline.tracking.cue_kernels import add_distances, near_outline
from pipeline.tracking.nearly_projected import project_nearly
from pipeline.tracking.pose_equations import PointQuadratic
from pipeline.tracking.pose_solver import DataTerm

SILHOUETTE_PX = 1.5
"""Vertices this near to the drawn silhouette move it; the next ring of vertices is hidden behind it."""


@dataclass(frozen=True)
class _SilhouettePoints:
    """Vertices near the drawn silhouette of one view, with their signed distance to it.

    Attributes:
        view: the masks.
        frame: of each vertex.
        vertex: index among the chosen ones.
        target: signed distance to the drawn silhouette, pixels.
    """

    view: View
    frame: Int64[np.ndarray, " points"]
    vertex: Int64[np.ndarray, " points"]
    target: Float64[np.ndarray, " points"]


def _silhouette_points(view: View, vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray) -> _SilhouettePoints:
    camera, number, target = view.camera, np.empty(len(chosen), np.int64), np.empty(len(chosen))
    frames, indices, targets = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for frame in np.flatnonzero(view.usable):
        pixels, depth = camera.project(vertices[frame])
        drawing = view.drawn(pixels, depth, faces)
        if min(drawing.mask.shape) > 1:  # else all of the mesh is beside the image
            found = near_outline(
                signed_distance(drawing.mask), drawing.corner, pixels, depth, chosen, camera.height, camera.width,
                SILHOUETTE_PX, EDGE_PX, number, target,
            )  # fmt: skip
            frames.append(np.full(found, frame))
            indices.append(number[:found].copy())
            targets.append(target[:found].copy())
    return _SilhouettePoints(view, np.concatenate(frames), np.concatenate(indices), np.concatenate(targets))


def silhouette_term(
    views: Sequence[View],
    vertices: Float64[np.ndarray, "frames vertices 3"],
    faces: Int64[np.ndarray, "faces 3"],
    chosen: Int64[np.ndarray, " chosen"],
    sigma_px: float,
) -> DataTerm:
    """Robust difference of signed distances of `chosen` vertices, linearised around `vertices`."""
    silhouettes = [_silhouette_points(view, vertices, faces, chosen) for view in views]

    def term(positions: np.ndarray) -> PointQuadratic:
        cost, gradient, normal = 0.0, np.zeros_like(positions), np.zeros((*positions.shape, 3))
        for drawn in silhouettes:
            at = positions[drawn.frame, drawn.vertex]
            pixels, derivative = project_nearly(drawn.view.camera, at)
            cost += add_distances(
                drawn.view.distance, drawn.frame, drawn.vertex, pixels, derivative, drawn.target, sigma_px, CAUCHY,
                EDGE_PX, gradient, normal,
            )  # fmt: skip
        return PointQuadratic(float(cost), gradient, normal)

    return term


@dataclass(frozen=True)
class SilhouetteCue:
    """Masks as a cue: some vertices, and the silhouettes they are fitted to.

    Attributes:
        views: the masks.
        faces: the template's.
        chosen: vertices that may sit on a silhouette.
        sigma_px: standard deviation of a mask's silhouette, mask pixels.
    """

    views: Sequence[View]
    faces: Int64[np.ndarray, "faces 3"]
    chosen: Int64[np.ndarray, " chosen"]
    sigma_px: float

    @property
    def points(self) -> SurfacePoints:
        """The chosen vertices."""
        return at_vertices(self.chosen)

    def at(self, frames: Int64[np.ndarray, " some"]) -> SilhouetteCue:
        """The cue of some of the frames."""
        return replace(self, views=[view.at(frames) for view in self.views])

    def around(self, vertices: Float64[np.ndarray, "frames vertices 3"]) -> DataTerm:
        """The term of the chosen vertices, linearised around a mesh."""
        return silhouette_term(self.views, vertices, self.faces, self.chosen, self.sigma_px)
