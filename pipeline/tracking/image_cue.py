"""Images as a cue for tracking: a point of the surface keeps its colour wherever it moves.

Around a posed mesh, the points that each camera sees well are looked up in its images; their colours are explained by
one albedo per point under the known lights (`pipeline.tracking.point_colors`); what is left over, times the image's
gradient, says where each point should be. Silhouettes cannot: a round limb may twist inside its silhouette.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.depth_maps import draw_depth, seen_well
from pipeline.geometry.sampling import EDGE_PX, sample_bilinear
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.lighting.direct_light import direct_light, smooth_normals
from pipeline.lighting.frame_lights import FrameLights
from pipeline.tracking.color_views import ColorView
from pipeline.tracking.cue_kernels import add_albedo_sums, add_color_differences, look_up_colors
from pipeline.tracking.nearly_projected import project_nearly
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
            observed[number, frame, point] = sample_bilinear(view.images, view.row[frame], pixels)[0]
        colors = fit_point_colors(observed, seen, light)
        compared = []
        normal_albedo = LEAST_ALBEDO_WEIGHT * np.tile(np.eye(3), (len(self.points), 1, 1))
        for number, view in enumerate(self.views):
            frame, point = np.nonzero(seen[number])
            weight = colors.weight[number, frame, point] / self.redundancy
            lit = colors.shading[frame, point][:, None, None] * colors.responses[number]
            np.add.at(normal_albedo, point, weight[:, None, None] * lit.swapaxes(1, 2) @ lit)
            compared.append(_Compared(view, frame, point, lit, weight))
        return partial(_quadratic, compared, normal_albedo)


@dataclass(frozen=True)
class _Compared:
    """Points that one view sees: their frame and index, colour per albedo [3, 3], and precision."""

    view: ColorView
    frame: Int64[np.ndarray, " seen"]
    point: Int64[np.ndarray, " seen"]
    lit: Float64[np.ndarray, "seen 3 3"]
    weight: Float64[np.ndarray, " seen"]


def _quadratic(compared: Sequence[_Compared], normal_albedo: np.ndarray, positions: np.ndarray) -> PointQuadratic:
    """Squared differences of colours, each point's albedo being the one that explains it best.

    Args:
        normal_albedo: normal matrices of these fits [points, 3, 3], which do not depend on the positions.
    """
    sums = np.zeros((positions.shape[1], 3))
    looked_up = []
    for part in compared:
        pixels, derivative = project_nearly(part.view.camera, positions[part.frame, part.point])
        color, across, down = np.empty((3, len(pixels), 3))
        look_up_colors(part.view.images, part.view.row[part.frame], pixels, EDGE_PX, color, across, down)
        add_albedo_sums(part.point, part.lit, part.weight, color, sums)
        looked_up.append((derivative, color, across, down))
    albedo = np.linalg.solve(normal_albedo, sums[..., None])[..., 0]
    cost, gradient, normal = 0.0, np.zeros_like(positions), np.zeros((*positions.shape, 3))
    cross = np.zeros_like(normal)
    for part, (derivative, color, across, down) in zip(compared, looked_up, strict=True):
        cost += add_color_differences(
            part.frame, part.point, derivative, part.lit, part.weight, albedo, color, across, down, gradient, normal,
            cross,
        )  # fmt: skip
    whiten = np.linalg.inv(np.linalg.cholesky(normal_albedo)).swapaxes(1, 2)
    return PointQuadratic(float(cost), gradient, normal, cross @ whiten)
