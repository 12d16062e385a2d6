"""Direct light on a matte surface, in luminance: what white reflects, times pi.

sum_j I_j / d_j^2 max(0, n . w_j) Vis_j.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.mesh import unit_or, vertex_normals
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.irradiance import trace_irradiance
from pipeline.lighting.light_scene import LUMINANCE, MIN_DISTANCE, Lights
from pipeline.lighting.visibility import Occluders


def smooth_normals(
    vertices: Float64[np.ndarray, "vertices 3"],
    faces: Int64[np.ndarray, "faces 3"],
    weld: Int64[np.ndarray, " vertices"],
    surface: SurfacePoints,
) -> Float64[np.ndarray, "points 3"]:
    """Unit normals of the smooth surface; zero where a mesh has none."""
    return unit_or(surface.carried(vertex_normals(vertices, faces, weld)), 0.0)


def direct_light(
    vertices: Float64[np.ndarray, "vertices 3"],
    faces: Int64[np.ndarray, "faces 3"],
    surface: SurfacePoints,
    normals: Float64[np.ndarray, "points 3"],
    lights: FrameLights,
) -> Float64[np.ndarray, " points"]:
    """Direct light on a matte surface, in luminance: what white reflects, times pi.

    sum_j I_j / d_j^2 max(0, n . w_j) Vis_j.
    """
    points = surface.carried(vertices)
    edges = vertices[surface.corners[:, 1:]] - vertices[surface.corners[:, :1]]
    face_normals = unit_or(np.cross(edges[:, 0], edges[:, 1]), 0.0)
    luminances, occluders = lights.intensities @ LUMINANCE, Occluders(vertices, faces)
    traced = trace_irradiance(occluders, points, face_normals, Lights(lights.positions, luminances), normals=normals)
    to_light = lights.positions - points[:, None]
    squared = np.maximum((to_light**2).sum(-1), (MIN_DISTANCE * occluders.half_extent) ** 2)
    cosines = np.maximum((to_light * normals[:, None]).sum(-1), 0.0) / np.sqrt(squared)
    return (luminances / squared * cosines).sum(1) * traced.cosine_visibility
