"""Occlusion of the eyes by lids: traced past the tracked skin.

Traced, not learned: that takes no parameters, holds for expressions and gazes that were never captured, and is as good
as the tracking of the lids.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.avatar.frames.prepared import LidOcclusion
from pipeline.lighting.bounces import cosine_directions
from pipeline.lighting.environment_sh import COEFFICIENTS, spherical_harmonics
from pipeline.lighting.lobes import unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import trace_bits
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2

LID_RAYS = 32
"""Rays per texel: a lid's edge is then known to 3 % of what the texel sees."""


@torch.no_grad()
def trace_lids(
    vertices: Float[np.ndarray, "v 3"], skin: Int[np.ndarray, "f 3"], points: Float[Tensor, "n 3"],
    tangent_frames: Float[Tensor, "n 3 3"],
) -> LidOcclusion:  # fmt: skip
    """Trace what the lids of a frame hide.

    Args:
        vertices: posed, metres.
        skin: faces that are no part of an eye; without any, nothing is hidden.
        points, tangent_frames: of the eye texels, metres; the third column is the normal.
    """
    if not len(skin):
        return LidOcclusion(torch.ones_like(points[:, 0]), None)
    at, axes = (tensor.double().cpu().numpy() for tensor in (points, tangent_frames))
    rays = (axes[:, None] @ cosine_directions(LID_RAYS, len(at))[..., None])[..., 0].reshape(-1, 3)
    above, occluders = np.repeat(axes[..., 2], LID_RAYS, 0), Occluders(vertices, skin)
    hit, _ = occluders.first_faces(np.repeat(at, LID_RAYS, 0), above, rays)
    return LidOcclusion(torch.as_tensor((hit.reshape(-1, LID_RAYS) < 0).mean(1)).to(points), occluders)


@torch.no_grad()
def light_past_lids(
    skin: Occluders | None, points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], turns: Float[Tensor, "n 3 3"],
    sources: PointLights,
) -> Float[Tensor, "n 81 channels"]:  # fmt: skip
    """Project lights on harmonics at eye texels, but for what skin hides.

    In the frames of their eyes.

    sum_j I_j / d_j^2 V_j Y_lm(w_j), V_j = 0 where skin hides a light. As `gather_harmonics`, but an eye's transfer
    turns with it. A light below a texel's horizon is left to the transfer.

    Args:
        points, normals: of the eye texels, metres.
        turns: of their eyes, world from rest.
    """
    out = points.new_zeros(len(points), COEFFICIENTS, sources.intensities.shape[1])
    at, up, lights = (tensor.double().cpu().numpy() for tensor in (points, normals, sources.positions_m))
    bits = None if skin is None else trace_bits(skin, at, up, lights)
    for j, (position, intensity) in enumerate(zip(sources.positions_m, sources.intensities, strict=True)):
        offset = position - points
        harmonics = spherical_harmonics((unit(offset)[:, None] @ turns)[:, 0])
        arriving = harmonics / offset.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
        if bits is not None:
            free = torch.as_tensor(bits.seen(j)).to(points.device) | ((offset * normals).sum(-1) <= 0)
            arriving = arriving * free[:, None]
        out += arriving[..., None] * intensity
    return out
