"""Texels of the atlas placed by a posed mesh: the anchors of the Gaussians (RFGCA 5-6)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.capture.records import FrameRecord
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.texels import Atlas, texel_frames


@dataclass(frozen=True)
class PosedTexels:
    """Where a frame's mesh puts every texel.

    Attributes:
        points: v_k, metres.
        frames: TBN_k as rotation matrices, columns tangent, bitangent, normal.
        quaternions: the same rotations.
    """

    points: Float[Tensor, "texels 3"]
    frames: Float[Tensor, "texels 3 3"]
    quaternions: Float[Tensor, "texels 4"]


def pose_texels(atlas: Atlas, vertices: np.ndarray) -> PosedTexels:
    """Anchors for posed vertices [V, 3] in metres; constants of the optimisation."""
    points, frames = texel_frames(atlas, vertices.astype(np.float64))
    arrays = (points, frames, quaternion_from_matrix(frames))
    return PosedTexels(*(torch.as_tensor(array.astype(np.float32)) for array in arrays))


@dataclass
class FrameInputs:
    """One frame's tensors, made from its record once and kept while training comes back to it."""

    atlas: Atlas
    record: FrameRecord

    @cached_property
    def posed(self) -> PosedTexels:
        """The anchors."""
        return pose_texels(self.atlas, self.record.vertices)

    @cached_property
    def irradiance(self) -> tuple[Float[Tensor, " texels"], Float[Tensor, " texels"]]:
        """Normalised irradiance, plain and weighted by the cosine."""
        return torch.tensor(self.record.irradiance), torch.tensor(self.record.falling)

    @cached_property
    def lights(self) -> tuple[Float[Tensor, "lights 3"], Float[Tensor, "lights 3"]]:
        """Positions in metres and linear RGB radiant intensities."""
        return torch.tensor(self.record.light_positions), torch.tensor(self.record.light_intensities)


SMALLEST_SPACING_M = 1e-5
"""Spacing given to texels of degenerate triangles: a tenth of the smallest Gaussian scale (RFGCA Appendix B)."""


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
    return torch.as_tensor(np.maximum(spacing[atlas.face], SMALLEST_SPACING_M).astype(np.float32))
