"""Texels of the atlas placed by a posed mesh: the anchors of the primitives (RFGCA 5-6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.texels.length_unit import length_unit_m
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.texel_surface import surface_frames
from pipeline.geometry.texels import Atlas


@dataclass(frozen=True, eq=False)
class PosedTexels:
    """Anchors of all texels on a frame's mesh; equal only to themselves.

    Attributes:
        points: v_k, metres.
        tangent_frames: TBN_k as rotation matrices, columns tangent, bitangent, normal.
        quaternions: the same rotations.
        world_from_head: rotation of a head that keeps its texels' parameters in its own frame (RGCA 3, 9).
    """

    points: Float[Tensor, "texels 3"]
    tangent_frames: Float[Tensor, "texels 3 3"]
    quaternions: Float[Tensor, "texels 4"]
    world_from_head: Float[Tensor, "3 3"] | None = None

    @property
    def normals(self) -> Float[Tensor, "texels 3"]:
        """Unit normals of the mesh."""
        return self.tangent_frames[..., 2]


def pose_texels(atlas: Atlas, vertices: np.ndarray, device: torch.device | str = "cpu") -> PosedTexels:
    """Anchor texels on posed vertices [V, 3] in metres; constants of the optimisation."""
    points, tangent_frames = surface_frames(atlas, vertices)
    arrays = (points, tangent_frames, quaternion_from_matrix(tangent_frames))
    return PosedTexels(*(torch.as_tensor(array.astype(np.float32), device=device) for array in arrays))


def rest_normals(atlas: Atlas) -> Float[Tensor, "texels 3"]:
    """Unit normals of the texels at rest."""
    return pose_texels(atlas, atlas.rest_vertices).normals


SMALLEST_SPACING_M = 1e-5
"""Spacing given to texels of degenerate triangles: a tenth of the smallest Gaussian scale (RFGCA Appendix B). In units
of `length_unit_m`."""


def texel_spacing(atlas: Atlas) -> Float[Tensor, "texels 2"]:
    """Size of each texel on the rest surface, along tangent and bitangent, metres.

    With P(u, v) the surface: |P_u| / size along the tangent, and |P_u x P_v| / |P_u| / size across it.
    """
    corners = atlas.rest_vertices[atlas.faces].astype(np.float64)
    edges = corners[:, 1:] - corners[:, :1]  # [faces, 2, 3]
    uv_edges = (atlas.uv[:, 1:] - atlas.uv[:, :1]).astype(np.float64)  # [faces, 2, 2]
    determinant = np.linalg.det(uv_edges)
    usable = np.abs(determinant) > np.finfo(np.float32).tiny
    uv_edges[~usable] = np.eye(2)
    along_u, along_v = np.moveaxis(np.linalg.solve(uv_edges, edges), 1, 0)
    length_u = np.linalg.norm(along_u, axis=-1)
    area = np.linalg.norm(np.cross(along_u, along_v), axis=-1)
    across = np.divide(area, length_u, out=np.zeros_like(area), where=length_u > 0)
    spacing = np.stack([length_u, across], -1) / atlas.size
    spacing[~usable] = 0
    smallest = SMALLEST_SPACING_M * length_unit_m(atlas)
    return torch.as_tensor(np.maximum(spacing[atlas.face], smallest).astype(np.float32))
