"""Marching rays through volumetric primitives by torch operations, on any device.

What `pipeline.rendering.volume_march` computes, as a flat list of samples: which rays pass which boxes, which steps of
them that are, and sums by ray and step. Sums over samples are atomic on a GPU, so the last bits change from run to run.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE, MOST_STEPS
from pipeline.rendering.volume_types import PLAIN, Volumes, rays

PAIRS_AT_ONCE = 1 << 24
"""Rays x boxes that are looked at together: about a gigabyte of float32 for the places at which they meet."""


class Samples(NamedTuple):
    """Samples in boxes, by ray and then by step.

    Attributes:
        ray, box: which.
        t: distances from the camera, metres.
        group: which of the steps that have samples.
    """

    ray: Int[Tensor, " n"]
    box: Int[Tensor, " n"]
    t: Float[Tensor, " n"]
    group: Int[Tensor, " n"]


def march_torch(
    volumes: Volumes, features: Float[Tensor, "b rows columns d"], tinted: tuple[int, ...], view: CameraView,
    step_m: float,
) -> Splatted:  # fmt: skip
    """March rays through the boxes, in the type of their centres. Arguments are checked by `march`."""
    directions, depth_per_m = rays(view.to(torch.float64))
    origin, pixels, size = view.center.double(), len(directions), (view.height, view.width)
    with torch.no_grad():
        samples = find_samples(volumes, directions, origin, step_m)
        alpha, _ = alphas(volumes, samples, directions, origin)
        kept = samples_before_end(samples, alpha, pixels, step_m)
        samples = numbered(*(part[kept] for part in samples[:3]), step_m)
    alpha, local = alphas(volumes, samples, directions, origin)
    reached = reached_after(samples, alpha, pixels, step_m)
    groups, rays_of, t_of = steps_of(samples)
    first = torch.ones_like(rays_of, dtype=torch.bool)
    first[1:] = rays_of[1:] != rays_of[:-1]
    before = torch.where(first, 0.0, torch.cat([reached[:1] * 0, reached[:-1]]))
    added = reached - before
    whole = alpha.new_zeros(groups).index_add(0, samples.group, alpha)
    there, of_step = (whole > 0)[samples.group], whole[samples.group]
    # The share first: squares of very dense steps would leave float32. Without any density, the limit.
    share = alpha / torch.where(there, of_step, 1.0)
    weight = torch.where(there, share * added[samples.group], step_m * alpha)

    seen = features_at(volumes, features, tinted, samples.box, local) * weight[:, None]
    image = seen.new_zeros(pixels, features.shape[3]).index_add(0, samples.ray, seen)
    opacity = added.new_zeros(pixels).index_add(0, rays_of, added)
    depth = added.new_zeros(pixels).index_add(0, rays_of, added * t_of.to(added)) * depth_per_m.to(added)
    return Splatted(image.reshape(*size, -1), opacity.clamp(max=1).reshape(size), depth.reshape(size))


def find_samples(
    volumes: Volumes, directions: Float[Tensor, "pixels 3"], origin: Float[Tensor, " 3"], step_m: float
) -> Samples:
    """All samples of all rays that lie in some box."""
    pose = volumes.map(Tensor.double)
    inverses = pose.from_world()
    start = (inverses @ (origin - pose.centers)[..., None])[..., 0]
    found = []
    for first in range(0, len(directions), chunk := max(1, PAIRS_AT_ONCE // max(1, len(volumes)))):
        slope = torch.einsum("bij,pj->pbi", inverses, directions[first : first + chunk])
        still = slope == 0
        divisor = torch.where(still, 1.0, slope)
        one, other = (-1 - start) / divisor, (1 - start) / divisor
        endless = torch.where(start.abs() <= 1, torch.inf, -torch.inf).expand_as(slope)
        enters = torch.where(still, -endless, torch.minimum(one, other)).amax(-1).clamp(min=0)
        leaves = torch.where(still, endless, torch.maximum(one, other)).amin(-1).clamp(max=MOST_STEPS * step_m)
        ray, box = torch.nonzero((enters <= leaves) & volumes.drawn(), as_tuple=True)
        low = (enters[ray, box] / step_m - 0.5).ceil().long()
        count = ((leaves[ray, box] / step_m - 0.5).floor().long() - low + 1).clamp(min=0)
        ends = count.cumsum(0)
        pair = torch.repeat_interleave(torch.arange(len(ray), device=ray.device), count)
        k = low[pair] + torch.arange(len(pair), device=ray.device) - (ends - count)[pair]
        found.append(((ray + first)[pair], box[pair], (k.to(directions.dtype) + 0.5) * step_m))
    ray, box, t = (torch.cat(parts) for parts in zip(*found, strict=True))
    return numbered(ray, box, t, step_m)


def numbered(ray: Tensor, box: Tensor, t: Tensor, step_m: float) -> Samples:
    """Samples sorted by ray and step, with the number of their step among those that have any."""
    key = ray * MOST_STEPS + (t / step_m).floor().long().clamp(max=MOST_STEPS - 1)
    key, order = torch.sort(key, stable=True)
    group = torch.unique_consecutive(key, return_inverse=True)[1]
    return Samples(ray[order], box[order], t[order], group)


def steps_of(samples: Samples) -> tuple[int, Int[Tensor, " g"], Float[Tensor, " g"]]:
    """Number of the steps that have samples, and the ray and the distance of each."""
    groups = int(samples.group[-1]) + 1 if len(samples.group) else 0
    first = torch.ones_like(samples.group, dtype=torch.bool)
    first[1:] = samples.group[1:] != samples.group[:-1]
    return groups, samples.ray[first], samples.t[first]


def reached_after(samples: Samples, alpha: Float[Tensor, " n"], pixels: int, step_m: float) -> Float[Tensor, " g"]:
    """A_k after each step that has samples; sums in float64, as they run over all rays."""
    groups, ray, _ = steps_of(samples)
    steps = alpha.new_zeros(groups).index_add(0, samples.group, alpha).double() * step_m
    steps = steps.clamp(max=1)  # none adds more; a ray's steps would otherwise drown in those of the rays before it
    running = steps.cumsum(0)
    of_ray = steps.new_zeros(pixels).index_add(0, ray, steps)
    return (running - (of_ray.cumsum(0) - of_ray)[ray]).clamp(max=1).to(alpha.dtype)


def samples_before_end(samples: Samples, alpha: Float[Tensor, " n"], pixels: int, step_m: float) -> Bool[Tensor, " n"]:
    """Samples up to the step that reaches an opacity of 1, with it."""
    _, ray, _ = steps_of(samples)
    reached = reached_after(samples, alpha, pixels, step_m)
    over = torch.zeros_like(reached, dtype=torch.bool)
    over[1:] = (reached[:-1] >= 1) & (ray[1:] == ray[:-1])
    return ~over[samples.group]


def alphas(
    volumes: Volumes, samples: Samples, directions: Float[Tensor, "pixels 3"], origin: Float[Tensor, " 3"]
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
    """Alpha of each sample, and its place in its box."""
    pose = volumes.map(Tensor.double)  # boxes may be thin: float32 would put a sample elsewhere in them
    points = origin + samples.t[:, None] * directions[samples.ray] - pose.centers[samples.box]
    local = (pose.from_world()[samples.box] @ points[..., None])[..., 0].to(volumes.density.dtype)
    faded = torch.exp(-FADE_SCALE * (local**FADE_POWER).sum(-1))
    return interpolated(volumes.density[..., None], samples.box, local.flip(-1))[:, 0] * faded, local


def features_at(
    volumes: Volumes, features: Tensor, tinted: tuple[int, ...], box: Int[Tensor, " n"], local: Float[Tensor, "n 3"]
) -> Float[Tensor, "n d"]:
    """Tinted features of each sample."""
    found = interpolated(features, box, local[:, :2].flip(-1))
    if all(component == PLAIN for component in tinted):
        return found
    tint = interpolated(volumes.tint, box, local.flip(-1))
    factors = torch.cat([tint, torch.ones_like(tint[:, :1])], 1)  # the last for those without
    return found * factors[:, list(tinted)]


def interpolated(
    values: Float[Tensor, "b *grid c"], box: Int[Tensor, " n"], place: Float[Tensor, "n axes"]
) -> Float[Tensor, "n c"]:
    """Values of boxes' grids at places; the ends of each axis lie at -1 and 1."""
    sizes = values.shape[1:-1]
    rows = values.flatten(0, -2)
    index, weight = [box], [torch.ones_like(place[:, 0])]
    for axis, size in enumerate(sizes):
        at = (place[:, axis].clamp(-1, 1) + 1) / 2 * (size - 1)
        low = at.detach().floor().long().clamp(max=max(size - 2, 0))
        share = at - low
        ends = ((low, 1 - share), ((low + 1).clamp(max=size - 1), share))
        pairs = [(i * size + k, w * part) for i, w in zip(index, weight, strict=True) for k, part in ends]
        index, weight = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    return sum(w[:, None] * rows[i] for i, w in zip(index, weight, strict=True))
