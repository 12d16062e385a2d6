"""Fitting a posed mesh to the outlines in masks: the cue for what keypoints leave open (heads, hands, twist of limbs).

Around the current pose the mesh is drawn into each view, and the vertices that lie near its drawn outline are kept,
each with its signed distance to that outline. They are then asked to have the same signed distance to the mask's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.least_squares import cauchy
from pipeline.geometry.sampling import sample_bilinear
from pipeline.geometry.signed_distance import View, signed_distance
from pipeline.geometry.surface_points import SurfacePoints, at_vertices
from pipeline.geometry.triangulation import SMALLEST_DEPTH_M
from pipeline.tracking.pose_solver import DataTerm, PointQuadratic

OUTLINE_PX = 1.5
"""Vertices this near to the drawn outline move it; the next ring of vertices is hidden behind it."""


@dataclass(frozen=True)
class _OutlinePoints:
    """Vertices near the drawn outline of one view: their frame, index among the chosen, and signed distance to it."""

    view: View
    frame: Int64[np.ndarray, " points"]
    vertex: Int64[np.ndarray, " points"]
    target: Float64[np.ndarray, " points"]


def _outline_points(view: View, vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray) -> _OutlinePoints:
    size = [view.camera.width, view.camera.height]
    frames, indices, targets = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for frame in np.flatnonzero(view.usable):
        drawn = signed_distance(view.drawn(vertices[frame], faces))
        pixels, depth = view.camera.project(vertices[frame, chosen])
        candidates = np.flatnonzero((depth > 0) & (pixels > 0).all(1) & (pixels < size).all(1))
        distance, _ = sample_bilinear(drawn[None], np.zeros(len(candidates), np.int64), pixels[candidates])
        near = np.abs(distance) < OUTLINE_PX
        frames.append(np.full(near.sum(), frame))
        indices.append(candidates[near])
        targets.append(distance[near])
    return _OutlinePoints(view, np.concatenate(frames), np.concatenate(indices), np.concatenate(targets))


def outline_term(
    views: Sequence[View],
    vertices: Float64[np.ndarray, "frames vertices 3"],
    faces: Int64[np.ndarray, "faces 3"],
    chosen: Int64[np.ndarray, " chosen"],
    sigma_px: float,
) -> DataTerm:
    """Robust difference of signed distances, for the `chosen` vertices, linearised around the pose of `vertices`."""
    outlines = [_outline_points(view, vertices, faces, chosen) for view in views]

    def term(positions: np.ndarray) -> PointQuadratic:
        cost, gradient, normal = 0.0, np.zeros_like(positions), np.zeros((*positions.shape, 3))
        for outline in outlines:
            camera, frame, vertex = outline.view.camera, outline.frame, outline.vertex
            at = positions[frame, vertex]
            in_camera = at @ camera.R.T + camera.t
            depth = np.maximum(in_camera[:, 2:], SMALLEST_DEPTH_M)
            value, slope = sample_bilinear(outline.view.distance, frame, camera.project(at)[0])
            residual = (value - outline.target) / sigma_px
            # Distortion changes the slope by a few percent at most: left out here, exact in the residual.
            along = slope * np.diag(camera.K)[:2] / depth / sigma_px
            row = along @ camera.R[:2] - ((along * in_camera[:, :2]).sum(1, keepdims=True) / depth) * camera.R[2]
            if not camera.lens.perspective:  # a fisheye bends the slope by much more
                row = np.einsum("np,npa->na", slope, camera.project_with_derivative(at)[1]) / sigma_px
            losses, weight = cauchy(residual**2)
            cost += losses.sum()
            # A vertex occurs once per frame and view, so plain indexed addition loses nothing.
            gradient[frame, vertex] += (weight * residual)[:, None] * row
            normal[frame, vertex] += weight[:, None, None] * row[:, :, None] * row[:, None, :]
        return PointQuadratic(float(cost), gradient, normal)

    return term


@dataclass(frozen=True)
class OutlineCue:
    """Masks as a cue: some vertices, and the outlines they are fitted to.

    Attributes:
        views: the masks.
        faces: the template's.
        chosen: vertices that may sit on an outline.
        sigma_px: standard deviation of a mask's outline, mask pixels.
    """

    views: Sequence[View]
    faces: Int64[np.ndarray, "faces 3"]
    chosen: Int64[np.ndarray, " chosen"]
    sigma_px: float

    @property
    def points(self) -> SurfacePoints:
        """The chosen vertices."""
        return at_vertices(self.chosen)

    def at(self, frames: Int64[np.ndarray, " some"]) -> OutlineCue:
        """The cue of some of the frames."""
        return replace(self, views=[view.at(frames) for view in self.views])

    def around(self, vertices: Float64[np.ndarray, "frames vertices 3"]) -> DataTerm:
        """The term of the chosen vertices, linearised around a mesh."""
        return outline_term(self.views, vertices, self.faces, self.chosen, self.sigma_px)
