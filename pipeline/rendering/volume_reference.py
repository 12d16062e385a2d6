"""Slow, readable twin of `pipeline.rendering.volume_march`.

Every sample of every ray against every box, gradients by autograd.

It is the oracle of the kernels and may run in float64. Conventions: `pipeline.rendering.volume_conventions`.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE, MOST_STEPS
from pipeline.rendering.volume_types import PLAIN, Volumes, check_march_arguments, rays


def march_reference(
    volumes: Volumes, features: Float[Tensor, "b rows columns d"], tinted: tuple[int, ...], view: CameraView,
    step_m: float,
) -> Splatted:  # fmt: skip
    """March rays through the boxes, in the dtype of their centres. Otherwise as `march`."""
    check_march_arguments(volumes, features, tinted, view, step_m)
    view = view.to(volumes.centers.dtype)
    directions, depth_per_m = rays(view)
    reach = (volumes.centers - view.center).norm(dim=1) + volumes.half_sizes.norm(dim=1)
    steps = min(math.ceil(float(reach.detach().max()) / step_m) + 1, MOST_STEPS) if len(volumes) else 1
    t = (torch.arange(steps, dtype=directions.dtype) + 0.5) * step_m
    points = view.center + t[:, None] * directions[:, None]  # [pixels, steps, 3]

    alpha = points.new_zeros(points.shape[:2])
    weighted = points.new_zeros(*points.shape[:2], features.shape[3])
    for box in torch.nonzero(volumes.drawn())[:, 0].tolist():
        local = (points - volumes.centers[box]) @ volumes.rotations[box] / volumes.half_sizes[box]
        inside = (local.abs() <= 1).all(-1)
        of_box = sample_density(volumes.density[box], local) * fade(local) * inside
        alpha = alpha + of_box
        weighted = weighted + of_box[..., None] * sample_features(features[box], volumes.tint[box], tinted, local)

    reached = (step_m * alpha).cumsum(1).clamp(max=1)
    added = torch.cat([reached[:, :1], reached[:, 1:] - reached[:, :-1]], 1)
    there = alpha > 0
    per_alpha = torch.where(there, added / torch.where(there, alpha, 1.0), step_m * (reached < 1))  # its limit at zero
    size = (view.height, view.width)
    image = (per_alpha[..., None] * weighted).sum(1).reshape(*size, -1)
    depth = (added * t).sum(1) * depth_per_m
    return Splatted(image, reached[:, -1].reshape(size), depth.reshape(size))


def fade(local: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n"]:
    """Factor by which a box ends at its faces."""
    return torch.exp(-FADE_SCALE * (local**FADE_POWER).sum(-1))


def sample_density(density: Float[Tensor, "deep rows columns"], local: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n"]:
    """Density of one box between its voxels, clamped to its faces."""
    return sample_grid(density[..., None], local.flip(-1))[..., 0]


def sample_features(
    features: Float[Tensor, "rows columns d"], tint: Float[Tensor, "deep rows columns 3"], tinted: tuple[int, ...],
    local: Float[Tensor, "*n 3"],
) -> Float[Tensor, "*n d"]:  # fmt: skip
    """Features of one box between its columns, times the tint between its voxels."""
    factors = sample_grid(tint, local.flip(-1))
    plain = torch.ones_like(factors[..., 0])
    each = [plain if component == PLAIN else factors[..., component] for component in tinted]
    sampled = sample_grid(features, local[..., :2].flip(-1))
    return sampled * torch.stack(each, -1) if each else sampled


def sample_grid(values: Float[Tensor, "*grid c"], place: Float[Tensor, "*n axes"]) -> Float[Tensor, "*n c"]:
    """Linear interpolation on a grid of any number of axes, whose ends are at -1 and 1."""
    total = 0.0
    low, share = [], []
    for axis in range(place.shape[-1]):
        last = values.shape[axis] - 1
        at = (place[..., axis].clamp(-1, 1) + 1) / 2 * last
        start = at.detach().floor().long().clamp(0, max(last - 1, 0))
        low.append(start)
        share.append(at - start)
    for corner in range(2 ** len(low)):
        weight, index = 1.0, []
        for axis, (start, part) in enumerate(zip(low, share, strict=True)):
            high = corner >> axis & 1
            index.append((start + high).clamp(max=values.shape[axis] - 1))
            weight = weight * (part if high else 1 - part)
        total = total + weight[..., None] * values[tuple(index)]
    return total
