"""The terms of the training loss (RFGCA 17, 18 and Appendix B), each as a small function of tensors."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.model import Avatar
from pipeline.base.color import srgb_from_linear
from pipeline.config.train_avatar import Edges, TrainAvatar

SCALE_BOUNDS_M = (1e-4, 1e-2)
"""Bounds of Gaussian scales (RFGCA Appendix B)."""

ROUGHNESS_BOUNDS = (0.01, 0.25)
"""Bounds of the lobe width in radians (RFGCA Appendix B)."""

SMALLEST_VALUE = 1e-30
"""Values are bounded as if they were no smaller: slopes, 2 log(low / v) / v, then fit into float32."""

GGX_WIDTH_BOUNDS = (0.05, 1.0)
"""Bounds of the width of GGX: at 0.05 a highlight is as wide as a lamp of the stage, at 1 it is matte."""


def photometric(
    rgb: Float[Tensor, "h w 3"], captured: Float[Tensor, "h w 3"], mask: Float[Tensor, "h w"], edges: Edges
) -> Float[Tensor, ""]:
    """L1 in sRGB, where the result is scored, against the capture over black; summed over the picture, per subject
    pixel, so that the width of the crop's margin does not change the balance with the other terms.

    A mask of zeros and ones cuts through pixels that the subject covers in part. Compared with black, those beyond its
    edge would teach the avatar to end half a pixel inside its outline, so `edges` says what to do with them.
    """
    beside = widest(mask) - mask
    wanted = captured * (mask if edges == "ignored" else mask + beside)[..., None]
    difference = (srgb_from_linear(rgb) - srgb_from_linear(wanted)).abs()
    if edges == "ignored":
        difference = difference * (1 - beside)[..., None]
    return difference.sum() / (3 * mask.sum()).clamp_min(1)


def widest(mask: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    """The largest value among each pixel and its eight neighbours."""
    padded = torch.nn.functional.pad(mask[None, None], (1, 1, 1, 1), mode="replicate")
    return torch.nn.functional.max_pool2d(padded, 3, 1)[0, 0]


def silhouette(alpha: Float[Tensor, "h w"], mask: Float[Tensor, "h w"]) -> Float[Tensor, ""]:
    """L1 between alpha and mask per subject pixel. Pixels that touch the mask's edge are left out (Appendix B)."""
    high, low = widest(mask), -widest(-mask)
    inside = (high == low).to(mask.dtype)
    return ((alpha - mask).abs() * inside).sum() / mask.sum().clamp_min(1)


TRANSFER = ("transfer_color", "transfer_mono")


def outside(value: Tensor, low: float, high: float) -> Float[Tensor, ""]:
    """Mean squared excess over bounds, in units of log: zero inside, finite slope everywhere.

    The paper's lower branch, 1 / max(v, 1e-7), jumps at the bound and has slopes up to 1e14.
    """
    log = value.clamp_min(SMALLEST_VALUE).log()
    return (torch.relu(math.log(low) - log).square() + torch.relu(log - math.log(high)).square()).mean()


def regularization(avatar: Avatar, diffuse: Float[Tensor, "texels 3"], weights: TrainAvatar) -> dict[str, Tensor]:
    """All terms that look at parameters, weighted."""
    terms = {
        "offset": weights.weight_offset * (avatar.offset / avatar.spacing.mean(-1, keepdim=True)).square().mean(),
        "scale": weights.weight_scale * outside(avatar.log_scale.exp(), *SCALE_BOUNDS_M),
        "negative": weights.weight_negative
        * (torch.relu(-diffuse).square().mean() + torch.relu(-avatar.albedo).square().mean()),
    }
    if avatar.spec.shading != "microfacet":
        distances = [(avatar.get_parameter(name) - avatar.get_buffer(f"start_{name}")) for name in TRANSFER]
        terms["transfer"] = weights.weight_transfer * sum(distance.square().mean() for distance in distances)
    if avatar.spec.bent_normals:
        terms["normal"] = weights.weight_normal * avatar.normal_offset.square().mean()
    if avatar.spec.lobe:
        terms["roughness"] = weights.weight_scale * outside(avatar.log_roughness.exp(), *ROUGHNESS_BOUNDS)
    if avatar.spec.gloss:
        terms["roughness"] = weights.weight_scale * outside(avatar.log_ggx_width.exp(), *GGX_WIDTH_BOUNDS)
        terms["gloss"] = weights.weight_gloss * avatar.log_gloss.square().mean()
    return terms
