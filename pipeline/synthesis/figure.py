"""The procedural figure as a whole: mesh, skin, texture, and its pose over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.synthesis.appearance import Unwrapped, bake, unwrap
from pipeline.synthesis.implicit_surface import even_out, smooth_union, surface_nets
from pipeline.synthesis.skeleton import Skeleton, human_skeleton, human_solids
from pipeline.synthesis.skinning import joint_transforms, pose_vertices, smooth_weights

BOX_LOW_M = np.array([-0.9, -0.1, -0.3])
BOX_HIGH_M = np.array([0.9, 1.9, 0.35])
"""A box around the rest pose with a hand's breadth to spare."""


@dataclass(frozen=True)
class Figure:
    """Rest mesh in metres, skin and texture.

    Attributes:
        vertices, faces, weights: the closed mesh, not cut along texture seams, and its skin.
        unwrapped: the same mesh cut along texture seams.
        texture: linear albedo, row 0 at v = 0.
    """

    skeleton: Skeleton
    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    weights: Float64[np.ndarray, "v joints"]
    unwrapped: Unwrapped
    texture: Float32[np.ndarray, "size size 3"]

    def posed(self, rotations: np.ndarray, root_translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Uncut vertices [v, 3] and joint positions [joints, 3] in metres for local joint rotations (wxyz)."""
        world_from_joint = joint_transforms(self.skeleton, rotations, root_translation)
        return pose_vertices(self.vertices, self.weights, self.skeleton, world_from_joint), world_from_joint[:, :3, 3]


def build_figure(subject: str, vertex_spacing_m: float, texture_size: int) -> Figure:
    """Build the figure; equal arguments give an equal figure."""
    skeleton, solids = human_skeleton(), human_solids()

    def field(points: np.ndarray) -> np.ndarray:
        return smooth_union(points, solids)

    vertices, faces = surface_nets(field, BOX_LOW_M, BOX_HIGH_M, vertex_spacing_m)
    vertices = even_out(vertices, faces, field)
    weights = smooth_weights(vertices, faces, solids, skeleton)
    unwrapped = unwrap(vertices, faces, texture_size)
    texture = bake(unwrapped, vertices, weights.argmax(axis=1), skeleton, texture_size, subject)
    return Figure(skeleton, vertices, faces, weights, unwrapped, texture)


def vertex_normals(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]) -> Float64[np.ndarray, "v 3"]:
    """Unit normals, area-weighted over the faces around each vertex."""
    corners = vertices[faces]
    doubled_area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], doubled_area)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
