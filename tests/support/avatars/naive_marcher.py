"""Marching through boxes of voxels as it is usually written down: all samples in float32, places divided by sizes.

Alpha is added up to one as by Lombardi et al. 2021, interpolation is PyTorch's own, gradients are by autograd.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample

from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE, MOST_STEPS
from pipeline.rendering.volume_types import PLAIN, Volumes, rays

GUARD = 1e-8
"""Added to what is divided by."""


def naive_march(
    volumes: Volumes, features: Float[Tensor, "b rows columns d"], tinted: tuple[int, ...], view: CameraView,
    step_m: float,
) -> Splatted:  # fmt: skip
    """March rays through the boxes; otherwise as `pipeline.rendering.volume_march.march`."""
    directions, depth_per_m = rays(view)
    far = (volumes.centers.norm(dim=1) + volumes.half_sizes.norm(dim=1)).detach().max()
    t = (torch.arange(min(int(far / step_m) + 2, MOST_STEPS)).to(directions) + 0.5) * step_m
    points = view.center + t[:, None] * directions[:, None]
    local = torch.einsum("psbi,bij->bpsj", points[:, :, None] - volumes.centers, volumes.rotations)
    local = local / volumes.half_sizes[:, None, None]
    inside = (local.abs() <= 1).all(-1)
    voxels = torch.cat([volumes.density[..., None], volumes.tint], -1).permute(0, 4, 1, 2, 3)
    sampled = grid_sample(voxels, local[:, None], align_corners=True, padding_mode="border")[:, :, 0]
    columns = grid_sample(features.permute(0, 3, 1, 2), local[..., :2], align_corners=True, padding_mode="border")
    alpha = sampled[:, 0] * torch.exp(-FADE_SCALE * (local**FADE_POWER).sum(-1)) * inside
    factors = torch.cat([sampled[:, 1:], torch.ones_like(sampled[:, :1])], 1)
    colors = columns * factors[:, [3 if one == PLAIN else one for one in tinted]]
    whole = alpha.sum(0)
    reached = (step_m * whole).cumsum(1).clamp(max=1)
    added = torch.diff(reached, dim=1, prepend=torch.zeros_like(reached[:, :1]))
    image = (alpha[:, None] * colors).sum(0) * (added / (whole + GUARD))
    size = (view.height, view.width)
    depth = (added * t).sum(1) * depth_per_m
    return Splatted(image.sum(-1).T.reshape(*size, -1), reached[:, -1].reshape(size), depth.reshape(size))
