"""Lids: what of the outside the eyes see, mirror, and are lit by, past the tracked skin.

Traced, not learned: that takes no parameters, holds for expressions and gazes that were never captured, and is as good
as the tracking of the lids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.lighting.bounces import cosine_directions
from pipeline.lighting.environment_sh import COEFFICIENTS, spherical_harmonics
from pipeline.lighting.lobes import mirror_direction, unit
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import trace_bits
from pipeline.lighting.zonal import SMALLEST_DISTANCE2_M2

LID_RAYS = 32
"""Rays per texel: a lid's edge is then known to 3 % of what the texel sees."""


@dataclass(frozen=True)
class Lids:
    """Of one frame.

    Attributes:
        opening: share of the outside that each eye texel sees, weighted by the cosine; 0 behind closed lids.
        skin: what hides it; None if the template has nothing but eyes.
    """

    opening: Float[Tensor, " eye_texels"]
    skin: Occluders | None

    @torch.no_grad()
    def pass_mirrored(
        self, points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], center: Float[Tensor, "3"]
    ) -> Float[Tensor, " n"]:
        """1 where the ray from `center` is mirrored past the skin, else 0; points (metres) and unit normals of eyes."""
        if self.skin is None or not len(points):
            return torch.ones_like(points[:, 0])
        mirrored = mirror_direction(normals, unit(center - points))
        arrays = (tensor.double().cpu().numpy() for tensor in (points, normals, mirrored))
        return torch.as_tensor(self.skin.first_faces(*arrays)[0] < 0).to(points)


@torch.no_grad()
def trace_lids(
    vertices: Float[np.ndarray, "v 3"], skin: Int[np.ndarray, "f 3"], points: Float[Tensor, "n 3"],
    frames: Float[Tensor, "n 3 3"],
) -> Lids:  # fmt: skip
    """The lids of a frame.

    Args:
        vertices: posed, metres.
        skin: faces that are no part of an eye; without any, nothing is hidden.
        points, frames: of the eye texels, metres; the third column is the normal.
    """
    if not len(skin):
        return Lids(torch.ones_like(points[:, 0]), None)
    at, axes = (tensor.double().cpu().numpy() for tensor in (points, frames))
    rays = (axes[:, None] @ cosine_directions(LID_RAYS, len(at))[..., None])[..., 0].reshape(-1, 3)
    above, occluders = np.repeat(axes[..., 2], LID_RAYS, 0), Occluders(vertices, skin)
    hit, _ = occluders.first_faces(np.repeat(at, LID_RAYS, 0), above, rays)
    return Lids(torch.as_tensor((hit.reshape(-1, LID_RAYS) < 0).mean(1)).to(points), occluders)


@torch.no_grad()
def light_past_lids(
    skin: Occluders | None, points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], turns: Float[Tensor, "n 3 3"],
    positions: Float[Tensor, "lights 3"], intensities: Float[Tensor, "lights channels"],
) -> Float[Tensor, "n 81 channels"]:  # fmt: skip
    """sum_j I_j / d_j^2 V_j Y_lm(w_j) at eye texels, V_j = 0 where skin hides a light, in the frames of their eyes.

    As `gather_harmonics`, but an eye's transfer turns with it. A light below a texel's horizon is left to the transfer.

    Args:
        points, normals: of the eye texels, metres.
        turns: of their eyes, world from rest.
    """
    out = points.new_zeros(len(points), COEFFICIENTS, intensities.shape[1])
    at, up, lights = (tensor.double().cpu().numpy() for tensor in (points, normals, positions))
    bits = None if skin is None else trace_bits(skin, at, up, lights)
    for j, (position, intensity) in enumerate(zip(positions, intensities, strict=True)):
        offset = position - points
        harmonics = spherical_harmonics((unit(offset)[:, None] @ turns)[:, 0])
        arriving = harmonics / offset.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
        if bits is not None:
            free = torch.as_tensor(bits.seen(j)).to(points.device) | ((offset * normals).sum(-1) <= 0)
            arriving = arriving * free[:, None]
        out += arriving[..., None] * intensity
    return out
