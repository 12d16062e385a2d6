"""The terms of the training loss (RFGCA 17, 18 and Appendix B), each as a small function of tensors."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.model import Avatar
from pipeline.base.color import srgb_from_linear
from pipeline.config.train_avatar import TrainAvatar

SCALE_BOUNDS_M = (1e-4, 1e-2)
"""Bounds of Gaussian scales (RFGCA Appendix B)."""

ROUGHNESS_BOUNDS = (0.01, 0.25)
"""Bounds of the lobe width in radians (RFGCA Appendix B)."""


def photometric(
    rgb: Float[Tensor, "h w 3"], captured: Float[Tensor, "h w 3"], mask: Float[Tensor, "h w"]
) -> Float[Tensor, ""]:
    """L1 in sRGB, where the result is scored, against the capture over black; summed over the picture, per subject
    pixel, so that the width of the crop's margin does not change the balance with the other terms."""
    difference = srgb_from_linear(rgb) - srgb_from_linear(captured * mask[..., None])
    return difference.abs().sum() / (3 * mask.sum()).clamp_min(1)


def silhouette(alpha: Float[Tensor, "h w"], mask: Float[Tensor, "h w"]) -> Float[Tensor, ""]:
    """L1 between alpha and mask per subject pixel. Pixels that touch the mask's edge are left out (Appendix B)."""
    padded = torch.nn.functional.pad(mask[None, None], (1, 1, 1, 1), mode="replicate")
    high = torch.nn.functional.max_pool2d(padded, 3, 1)[0, 0]
    low = -torch.nn.functional.max_pool2d(-padded, 3, 1)[0, 0]
    inside = (high == low).to(mask.dtype)
    return ((alpha - mask).abs() * inside).sum() / mask.sum().clamp_min(1)


def outside(value: Tensor, low: float, high: float) -> Float[Tensor, ""]:
    """Mean squared excess over bounds, in units of log: zero inside, finite slope everywhere.

    The paper's lower branch, 1 / max(v, 1e-7), jumps at the bound and has slopes up to 1e14.
    """
    log = value.clamp_min(torch.finfo(value.dtype).tiny).log()
    bounds = torch.tensor([low, high]).log()
    return (torch.relu(bounds[0] - log).square() + torch.relu(log - bounds[1]).square()).mean()


def regularization(avatar: Avatar, diffuse: Float[Tensor, "texels 3"], weights: TrainAvatar) -> dict[str, Tensor]:
    """All terms that look at parameters, weighted."""
    lambert = avatar.lambert
    colored, mono = lambert[: avatar.transfer_color.shape[2]], lambert[avatar.transfer_color.shape[2] :]
    normal_lobe = torch.tensor([0.0, 0.0, 1.0])
    transfer = (avatar.transfer_color - (normal_lobe[:, None] * colored)[None, :, :, None]).square().mean()
    transfer = transfer + (avatar.transfer_mono - (normal_lobe[:, None] * mono)[None]).square().mean()
    terms = {
        "offset": weights.weight_offset * (avatar.offset / avatar.spacing.mean(-1, keepdim=True)).square().mean(),
        "scale": weights.weight_scale * outside(avatar.log_scale.exp(), *SCALE_BOUNDS_M),
        "negative": weights.weight_negative
        * (torch.relu(-diffuse).square().mean() + torch.relu(-avatar.albedo).square().mean()),
        "transfer": weights.weight_transfer * transfer,
    }
    if avatar.spec.specular:
        terms["normal"] = weights.weight_normal * avatar.normal_offset.square().mean()
        terms["roughness"] = weights.weight_scale * outside(avatar.log_roughness.exp(), *ROUGHNESS_BOUNDS)
    return terms
