"""The terms of the training loss that RGCA has and RFGCA has not (RGCA 11, 12)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.model import Avatar
from pipeline.avatar.networks.expression_vae import standard_divergence
from pipeline.base.color import srgb_from_linear
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.training_losses import LossMean, LossSpace
from pipeline.metrics.images import SSIM_SIGMA, SSIM_WINDOW

STABLE_MEAN, STABLE_VARIANCE = 0.01**2, 0.03**2
"""C1 and C2 of Wang et al. 2004 for pictures of range 1."""


def structural_dissimilarity(
    rgb: Float[Tensor, "h w 3"], captured: Float[Tensor, "h w 3"], mask: Float[Tensor, "h w"],
    space: LossSpace = "srgb", mean: LossMean = "subject",
) -> Float[Tensor, ""]:  # fmt: skip
    """(1 - SSIM) / 2 between picture and capture over black.

    By default in sRGB and as a mean over the subject.

    The index of Wang et al. 2004 as `pipeline.metrics.images.ssim` scores it, differentiable; windows reach over the
    picture's border as if it went on black, which it is.
    """
    pair = [linear.clamp(0, 1) for linear in (rgb, captured * mask[..., None])]
    shown = [srgb_from_linear(linear) for linear in pair] if space == "srgb" else pair
    x, y = torch.stack([picture.permute(2, 0, 1) for picture in shown])
    mean_x, mean_y, xx, yy, xy = blurred(torch.cat([x, y, x * x, y * y, x * y])).split(len(x))

    variance = xx - mean_x**2 + yy - mean_y**2
    covariance = xy - mean_x * mean_y
    index = (2 * mean_x * mean_y + STABLE_MEAN) * (2 * covariance + STABLE_VARIANCE)
    index = index / ((mean_x**2 + mean_y**2 + STABLE_MEAN) * (variance + STABLE_VARIANCE))
    dissimilar = (1 - index.mean(0)) / 2
    return dissimilar.mean() if mean == "picture" else (dissimilar * mask).sum() / mask.sum().clamp_min(1)


def blurred(image: Float[Tensor, "c h w"]) -> Float[Tensor, "c h w"]:
    """Each channel under the Gaussian window of SSIM, zero outside."""
    half = SSIM_WINDOW // 2
    place = torch.arange(-half, half + 1, device=image.device, dtype=image.dtype)
    window = torch.exp(-0.5 * (place / SSIM_SIGMA).square())
    window = window / window.sum()
    down = torch.nn.functional.conv2d(image[:, None], window[None, None, :, None], padding=(half, 0))
    return torch.nn.functional.conv2d(down, window[None, None, None], padding=(0, half))[:, 0]


def expression_terms(
    avatar: Avatar, frame: PreparedFrame, inputs: FrameInputs, weights: TrainAvatar
) -> dict[str, Tensor]:
    """Terms that keep a head's code a code, weighted (RGCA 11, 12).

    L_kl, and L_geo: squared errors of decoded vertices over the variance of those of training. Rigid tracking knows no
    vertices to compare with.
    """
    head = frame.decoded.head
    if head is None:
        return {}
    terms = {"kl": weights.weight_kl * standard_divergence(head.latent)}
    if avatar.spec.anchors != "rigid":
        errors = (head.decoded_vertices - inputs.local_vertices) / avatar.networks.expression.scale
        terms["geometry"] = weights.weight_geometry * errors.square().mean()
    return terms
