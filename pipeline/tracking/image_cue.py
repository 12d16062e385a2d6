"""Images as a cue for tracking: a point of the surface keeps its colour wherever it moves.

Around a posed mesh, the points that each camera sees well are looked up in its images; their colours are explained by
one albedo per point under the known lights (`pipeline.tracking.point_colors`); what is left over, times the image's
gradient, says where each point should be. Silhouettes cannot: a round limb may twist inside its silhouette.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth, seen_well
from pipeline.geometry.sampling import sample_bilinear
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.geometry.triangulation import SMALLEST_DEPTH_M
from pipeline.lighting.direct_light import direct_light, smooth_normals
from pipeline.lighting.frame_lights import FrameLights
from pipeline.tracking.color_views import ColorView
from pipeline.tracking.point_colors import fit_point_colors
from pipeline.tracking.pose_equations import PointQuadratic
from pipeline.tracking.pose_solver import DataTerm

LEAST_ALBEDO_WEIGHT = 1e-6
"""Keeps the albedo of a point that nothing sees at zero; an observation weighs 1 / (a percent of white)^2."""


@dataclass(frozen=True)
class ImageCue:
    """Images, their lights, and the surface points whose colours are compared.

    Attributes:
        points: on the surface.
        faces: the template's.
        weld: see `pipeline.geometry.mesh.weld_vertices`.
        views: the images.
        lights: of each frame.
        redundancy: how many samples count as one: neighbours share a shadow's edge, a highlight, a blur.
    """

    points: SurfacePoints
    faces: Int64[np.ndarray, "faces 3"]
    weld: Int64[np.ndarray, " vertices"]
    views: Sequence[ColorView]
    lights: Sequence[FrameLights]
    redundancy: float

    def at(self, frames: Int64[np.ndarray, " some"]) -> ImageCue:
        """The cue of some of the frames."""
        views, lights = [view.at(frames) for view in self.views], [self.lights[frame] for frame in frames]
        return replace(self, views=views, lights=lights)

    def around(self, vertices: Float64[np.ndarray, "frames vertices 3"]) -> DataTerm:
        """The term of the points: colours and visibility are those of this mesh."""
        positions = self.points.carried(vertices)
        shape = (len(self.views), *positions.shape[:2])
        seen, observed = np.zeros(shape, bool), np.zeros((*shape, 3))
        light = np.zeros(shape[1:])
        for frame in np.flatnonzero(np.any([view.usable for view in self.views], axis=0)):
            mesh = vertices[frame]
            normals = smooth_normals(mesh, self.faces, self.weld, self.points)
            light[frame] = direct_light(mesh, self.faces, self.points, normals, self.lights[frame])
            for number, view in enumerate(self.views):
                if view.usable[frame]:
                    depth = draw_depth(view.camera, mesh, self.faces)
                    seen[number, frame] = seen_well(view.camera, depth, positions[frame], normals)
        for number, view in enumerate(self.views):
            frame, point = np.nonzero(seen[number])
            pixels, _ = view.camera.project(positions[frame, point])
            observed[number, frame, point] = sample_bilinear(view.images, frame, pixels)[0]
        colors = fit_point_colors(observed, seen, light)
        compared = []
        for number, view in enumerate(self.views):
            frame, point = np.nonzero(seen[number])
            weight = colors.weight[number, frame, point] / self.redundancy
            lit = colors.shading[frame, point][:, None, None] * colors.responses[number]
            compared.append(_Compared(view, frame, point, lit, weight))
        return lambda moved: _quadratic(compared, moved)


@dataclass(frozen=True)
class _Compared:
    """Points that one view sees: their frame and index, colour per albedo [3, 3], and precision."""

    view: ColorView
    frame: Int64[np.ndarray, " seen"]
    point: Int64[np.ndarray, " seen"]
    lit: Float64[np.ndarray, "seen 3 3"]
    weight: Float64[np.ndarray, " seen"]


def _quadratic(compared: Sequence[_Compared], positions: np.ndarray) -> PointQuadratic:
    """Squared differences of colours, each point's albedo being the one that explains it best."""
    count = positions.shape[1]
    normal_albedo, sums = LEAST_ALBEDO_WEIGHT * np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    looked_up = []
    for part in compared:
        pixels, by_position = _projection(part.view.camera, positions[part.frame, part.point])
        value, slope = sample_bilinear(part.view.images, part.frame, pixels)
        looked_up.append((value, slope @ by_position))
        weighted = part.weight[:, None, None] * part.lit
        np.add.at(normal_albedo, part.point, weighted.swapaxes(1, 2) @ part.lit)
        np.add.at(sums, part.point, np.einsum("nca,nc->na", weighted, value))
    albedo = np.linalg.solve(normal_albedo, sums[..., None])[..., 0]
    cost, gradient, normal = 0.0, np.zeros_like(positions), np.zeros((*positions.shape, 3))
    cross = np.zeros_like(normal)
    for part, (value, jacobian) in zip(compared, looked_up, strict=True):
        residual = value - (part.lit @ albedo[part.point][..., None])[..., 0]
        cost += 0.5 * float((part.weight * (residual**2).sum(1)).sum())
        weighted = part.weight[:, None, None] * jacobian
        # A point occurs once per frame and view, so plain indexed addition loses nothing.
        gradient[part.frame, part.point] += np.einsum("nca,nc->na", weighted, residual)
        normal[part.frame, part.point] += weighted.swapaxes(1, 2) @ jacobian
        cross[part.frame, part.point] += weighted.swapaxes(1, 2) @ part.lit
    whiten = np.linalg.inv(np.linalg.cholesky(normal_albedo)).swapaxes(1, 2)
    return PointQuadratic(cost, gradient, normal, cross @ whiten)


def _projection(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [N, 2] and their derivatives by the points [N, 2, 3].

    Distortion changes the derivatives by a few percent at most and is left out of them, but not a fisheye's.
    """
    if not camera.lens.perspective:
        return camera.project_with_derivative(points)
    in_camera = points @ camera.R.T + camera.t
    depth = np.maximum(in_camera[:, 2:], SMALLEST_DEPTH_M)
    ratio = in_camera[:, :2] / depth
    across = camera.R[:2] - ratio[:, :, None] * camera.R[2]
    return camera.project(points)[0], np.diag(camera.K)[:2, None] * across / depth[:, :, None]
