"""Tensors of one frame, made from its record: pose, light, and what is traced for them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.avatar.frames.light_gains import AS_CALIBRATED, LightGains
from pipeline.avatar.frames.sky import PreparedSky
from pipeline.avatar.texels.posed_texels import PosedTexels, pose_texels
from pipeline.capture.records import FrameRecord
from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas, texel_frames
from pipeline.lighting.bounces import trace_bounces
from pipeline.lighting.distant import far_lights, gather_harmonics, light_harmonics
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import trace_bits, trace_some_bits

BOUNCE_RAYS = 16
"""Rays per texel for light that other surfaces send, of which nine texels share theirs. On a recorded body its pictures
differ by -56 dB from those of 512 rays, as with 32 rays that are not shared; the captured ones differ by -34 dB."""


TRACED = ("posed", "irradiance", "visibility_bits", "bounces", "head_from_world", "local_vertices", "texture")
"""What the light of a frame has no part in, or only by the places of its lights."""


@dataclass(eq=False)
class FrameInputs:
    """Input of an avatar for one frame, kept while training comes back to it.

    Equal only to itself.

    Nothing is traced before it is asked for.

    Attributes:
        sky: light of the frame in place of the record's lights.
        gains: factors of the record's lights.
        shadowed: texels that the surface may hide lights from, and send light to; all if None.
    """

    atlas: Atlas
    record: FrameRecord
    sky: PreparedSky | None = None
    gains: LightGains = field(default=AS_CALIBRATED, kw_only=True)
    shadowed: Bool[np.ndarray, " texels"] | None = field(default=None, kw_only=True)
    device: torch.device | str = field(default="cpu", kw_only=True)

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
        """Normalised irradiance and cosine visibility; see `pipeline.lighting.irradiance`."""
        return self._tensor(self.record.irradiance), self._tensor(self.record.cosine_visibility)

    @cached_property
    def visibility_bits(self) -> UInt8[np.ndarray, "lights bytes"]:
        """Texels that see each lit light, packed as in `PointLights`."""
        points, _, face_normals, occluders = occluding_surface(self)
        asked = (occluders, points, face_normals[self.atlas.face], self.record.light_positions.astype(np.float64))
        return trace_bits(*asked).bits if self.shadowed is None else trace_some_bits(*asked, self.shadowed)

    @cached_property
    def bounces(self) -> Int[Tensor, "texels rays"]:
        """The texel that each ray from each texel hits, see `pipeline.lighting.bounces`."""
        points, frames, face_normals, occluders = occluding_surface(self)
        hits = trace_bounces(self.atlas, occluders, points, frames, face_normals, BOUNCE_RAYS, self.shadowed)
        return self._tensor(hits)

    @cached_property
    def head_from_world(self) -> Float[Tensor, "3 4"]:
        """[R | t] that brings points, metres, to the frame of the template at rest.

        That of the record, if it has one, else the rigid motion that brings the posed vertices nearest to those at
        rest.
        """
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
    def lights(self) -> PointLights:
        """The lit lights where they are.

        Their shadows stay those of the calibrated places: places are moved by less than a texel's shadow is wide.
        """
        positions = self.record.light_positions
        intensities = self.record.light_intensities * self.gains.of(positions)[:, None]
        return PointLights(self._tensor(self.gains.moved(positions)), self._tensor(intensities))

    def with_gains(self, gains: LightGains) -> FrameInputs:
        """The frame with lights of other brightness; what was traced is kept."""
        return self._sharing(gains=gains)

    def with_light(self, number: int) -> FrameInputs:
        """The frame in the light of one of its lights alone; what was traced is kept."""
        lit, record = slice(number, number + 1), self.record
        positions, intensities = record.light_positions[lit], record.light_intensities[lit]
        other = self._sharing(record=replace(record, light_positions=positions, light_intensities=intensities))
        if "visibility_bits" in vars(self):
            vars(other)["visibility_bits"] = self.visibility_bits[lit]
        return other

    def _sharing(self, **changes: object) -> FrameInputs:
        """The frame with other fields, and what was traced."""
        other = replace(self, **changes)
        vars(other).update({name: value for name, value in vars(self).items() if name in TRACED})
        return other

    @cached_property
    def far_lights(self) -> PointLights:
        """The lights without their distance, as bright as at the subject's centre."""
        return far_lights(self.posed.points.mean(0), self.lights)

    @cached_property
    def harmonics(self) -> Float[Tensor, "texels 81 channels"]:
        """Light at every texel in harmonics of the body's frame; see `gather_harmonics`."""
        return gather_harmonics(self.posed.points, self.root_from_world, white_once(self.lights))

    @cached_property
    def tangent_harmonics(self) -> Float[Tensor, "texels 81 channels"]:
        """The same in each texel's tangent frame on the tracked mesh."""
        return gather_harmonics(self.posed.points, self.posed.tangent_frames.mT, white_once(self.lights))

    @cached_property
    def world_light(self) -> Float[Tensor, "81 channels"]:
        """The light at the subject's centre in spherical harmonics."""
        return self._harmonics_at_center(torch.eye(3, device=self.device))

    @cached_property
    def body_light(self) -> Float[Tensor, "81 channels"]:
        """The light at the subject's centre in spherical harmonics of the body's frame."""
        return self._harmonics_at_center(self.root_from_world)

    @property
    def root_from_world(self) -> Float[Tensor, "3 3"]:
        """Rotation of the subject as a whole back to rest."""
        return self.head_from_world[:, :3].contiguous()

    def _harmonics_at_center(self, turn: Float[Tensor, "3 3"]) -> Float[Tensor, "81 channels"]:
        return light_harmonics(self.posed.points.mean(0), turn, white_once(self.lights))

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.tensor(array, device=self.device)


@lru_cache(maxsize=3)
def occluding_surface(inputs: FrameInputs) -> tuple[np.ndarray, np.ndarray, np.ndarray, Occluders]:
    """Points and tangent frames of a frame's texels, face normals, and the mesh to trace.

    In float64. Kept for the frame at hand, and those that are traced ahead: for all, it would double what training
    holds.
    """
    vertices = inputs.record.vertices.astype(np.float64)
    normals = unit_or(area_vectors(vertices, inputs.atlas.faces), 0.0)  # no direction is above a degenerate face
    return *texel_frames(inputs.atlas, vertices), normals, Occluders(vertices, inputs.atlas.faces)


def white_once(lights: PointLights) -> PointLights:
    """Lights with one channel if all are white; else as they are. It spares two thirds of the sums over them."""
    intensities = lights.intensities
    white = intensities[:, :1] if bool((intensities == intensities[:, :1]).all()) else intensities
    return PointLights(lights.positions_m, white, lights.visibility_bits)


def body_rotation(atlas: Atlas, vertices: np.ndarray) -> Float[Tensor, "3 3"]:
    """Rotation that best turns the posed body as a whole back to rest (Kabsch 1976). Body from world."""
    rest, posed = (array.astype(np.float64) - array.mean(0) for array in (atlas.rest_vertices, vertices))
    return torch.as_tensor(Rotation.align_vectors(rest, posed)[0].as_matrix(), dtype=torch.float32)
