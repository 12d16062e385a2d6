"""Lids: how much of the outside the texels of an eye see past the tracked skin.

Traced, not learned: that takes no parameters, holds for expressions and gazes that were never captured, and is as good
as the tracking of the lids.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.lighting.bounces import cosine_directions
from pipeline.lighting.visibility import Occluders

LID_RAYS = 32
"""Rays per texel: a lid's edge is then known to 3 % of what the texel sees."""


@torch.no_grad()
def trace_lids(
    vertices: Float[np.ndarray, "v 3"], skin: Int[np.ndarray, "f 3"], points: Float[Tensor, "n 3"],
    frames: Float[Tensor, "n 3 3"],
) -> Float[Tensor, " n"]:  # fmt: skip
    """Share of the outside that each texel sees, weighted by the cosine; 0 behind closed lids.

    Args:
        vertices: posed, metres.
        skin: faces that are no part of an eye; without any, nothing is hidden.
        points, frames: of the eye texels, metres; the third column is the normal.
    """
    if not len(skin):
        return torch.ones_like(points[:, 0])
    at, axes = (tensor.double().cpu().numpy() for tensor in (points, frames))
    rays = (axes[:, None] @ cosine_directions(LID_RAYS, len(at))[..., None])[..., 0].reshape(-1, 3)
    above = np.repeat(axes[..., 2], LID_RAYS, 0)
    hit, _ = Occluders(vertices, skin).first_faces(np.repeat(at, LID_RAYS, 0), above, rays)
    return torch.as_tensor((hit.reshape(-1, LID_RAYS) < 0).mean(1)).to(points)
