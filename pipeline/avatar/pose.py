"""Texels of the atlas placed by a posed mesh: the anchors of the Gaussians (RFGCA 5-6)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.avatar.eyes.lid_occlusion import Lids
from pipeline.avatar.shading import gather_harmonics
from pipeline.capture.records import FrameRecord
from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.texels import Atlas, texel_frames
from pipeline.lighting.bounces import trace_bounces
from pipeline.lighting.distant import far_lights, light_harmonics
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import trace_bits


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


def pose_texels(atlas: Atlas, vertices: np.ndarray, device: torch.device | str = "cpu") -> PosedTexels:
    """Anchors for posed vertices [V, 3] in metres; constants of the optimisation."""
    points, frames = texel_frames(atlas, vertices.astype(np.float64))
    arrays = (points, frames, quaternion_from_matrix(frames))
    return PosedTexels(*(torch.as_tensor(array.astype(np.float32), device=device) for array in arrays))


BOUNCE_RAYS = 32
"""Rays per texel for light that other surfaces send. A tenth of them meet the body, whose light is a tenth of the
direct light: their sampling error is below 1 % of a texel's colour, and splatting averages over neighbours."""


@dataclass
class FrameInputs:
    """One frame's tensors, made from its record once and kept while training comes back to it.

    Nothing is traced before it is asked for.
    """

    atlas: Atlas
    record: FrameRecord
    device: torch.device | str = field(default="cpu", kw_only=True)
    lids: Lids | None = field(default=None, init=False)
    """What eyes see past the lids, once an avatar with eyes has traced it."""
    eye_light: tuple[Int[Tensor, " n"], Float[Tensor, "n 81 channels"]] | None = field(default=None, init=False)
    """Texels of eyes with the light that comes to them past the lids, in spherical harmonics of their eyes' frames."""

    @cached_property
    def posed(self) -> PosedTexels:
        """The anchors."""
        return pose_texels(self.atlas, self.record.vertices, self.device)

    @property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Posed vertices [V, 3] in metres and faces [F, 3]."""
        return self.record.vertices.astype(np.float64), self.atlas.faces.astype(np.int64)

    @cached_property
    def irradiance(self) -> tuple[Float[Tensor, " texels"], Float[Tensor, " texels"]]:
        """Normalised irradiance, plain and weighted by the cosine."""
        return self._tensor(self.record.irradiance), self._tensor(self.record.cosine_visibility)

    @cached_property
    def seen(self) -> UInt8[np.ndarray, "lights bytes"]:
        """Row j has the texels that see lit light j, packed as np.packbits does."""
        points, _, face_normals, occluders = self._surface()
        return trace_bits(
            occluders, points, face_normals[self.atlas.face], self.record.light_positions.astype(np.float64)
        ).bits

    @cached_property
    def bounces(self) -> Int[Tensor, "texels rays"]:
        """The texel that each ray from each texel hits, see `pipeline.lighting.bounces`."""
        points, frames, face_normals, occluders = self._surface()
        return self._tensor(trace_bounces(self.atlas, occluders, points, frames, face_normals, BOUNCE_RAYS))

    @cached_property
    def head_from_world(self) -> Float[Tensor, "3 4"]:
        """[R | t] that brings points, metres, to the frame of the template at rest: that of the record, if it has one,
        else the rigid motion that brings the posed vertices nearest to those at rest."""
        if self.record.head_from_world is not None:
            return self._tensor(self.record.head_from_world)
        turn = body_rotation(self.atlas, self.record.vertices)
        rest, posed = (torch.as_tensor(array.mean(0)) for array in (self.atlas.rest_vertices, self.record.vertices))
        return torch.cat([turn, (rest - turn @ posed)[:, None]], 1).to(self.device)

    @cached_property
    def local_vertices(self) -> Float[Tensor, "vertices 3"]:
        """The posed template in the frame of the template at rest, metres."""
        motion = self.head_from_world
        return self._tensor(self.record.vertices) @ motion[:, :3].T + motion[:, 3]

    @cached_property
    def texture(self) -> Float[Tensor, "texels 3"] | None:
        """The frame's mean texture, linear RGB, if it has one."""
        return None if self.record.texture is None else self._tensor(self.record.texture)

    @cached_property
    def harmonics(self) -> Float[Tensor, "texels 81 channels"]:
        """The light at every texel in spherical harmonics of the body's frame, see `gather_harmonics`."""
        positions, intensities = self.lights
        return gather_harmonics(self.posed.points, self.root_from_world, positions, white_once(intensities))

    @cached_property
    def far_lights(self) -> tuple[Float[Tensor, "lights 3"], Float[Tensor, "lights 3"]]:
        """The lights without their distance, as bright as at the subject's centre."""
        return far_lights(self.posed.points.mean(0), *self.lights)

    @cached_property
    def world_light(self) -> Float[Tensor, "81 channels"]:
        """The light at the subject's centre in spherical harmonics."""
        return self._harmonics_at_center(torch.eye(3, device=self.device))

    @cached_property
    def body_light(self) -> Float[Tensor, "81 channels"]:
        """The same in the body's frame."""
        return self._harmonics_at_center(self.root_from_world)

    @property
    def root_from_world(self) -> Float[Tensor, "3 3"]:
        """Rotation of the subject as a whole back to rest."""
        return self.head_from_world[:, :3].contiguous()

    def _harmonics_at_center(self, turn: Float[Tensor, "3 3"]) -> Float[Tensor, "81 channels"]:
        positions, intensities = self.lights
        return light_harmonics(self.posed.points.mean(0), turn, positions, white_once(intensities))

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.tensor(array, device=self.device)

    def _surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, Occluders]:
        vertices = self.record.vertices.astype(np.float64)
        normals = unit_or(area_vectors(vertices, self.atlas.faces), 0.0)  # no direction is above a degenerate face
        return *texel_frames(self.atlas, vertices), normals, Occluders(vertices, self.atlas.faces)

    @cached_property
    def lights(self) -> tuple[Float[Tensor, "lights 3"], Float[Tensor, "lights 3"]]:
        """Positions in metres and linear RGB radiant intensities."""
        return self._tensor(self.record.light_positions), self._tensor(self.record.light_intensities)


def white_once(intensities: Float[Tensor, "lights 3"]) -> Float[Tensor, "lights channels"]:
    """One channel if all lights are white, which spares two thirds of the sums over them; else all three."""
    return intensities[:, :1] if bool((intensities == intensities[:, :1]).all()) else intensities


def body_rotation(atlas: Atlas, vertices: np.ndarray) -> Float[Tensor, "3 3"]:
    """Rotation that best turns the posed body as a whole back to rest (Kabsch 1976): body from world."""
    rest, posed = (array.astype(np.float64) - array.mean(0) for array in (atlas.rest_vertices, vertices))
    return torch.as_tensor(Rotation.align_vectors(rest, posed)[0].as_matrix(), dtype=torch.float32)


def rest_normals(atlas: Atlas) -> Float[Tensor, "texels 3"]:
    """Unit normals of the texels at rest."""
    return pose_texels(atlas, atlas.rest_vertices).frames[..., 2]


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
