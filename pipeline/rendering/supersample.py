"""Splatting at a multiple of the resolution, then filtering down: less blur than a wide dilation, less aliasing."""

from __future__ import annotations

import math
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.rendering.splat import splat
from pipeline.rendering.splat_conventions import Splatted

GAUSSIAN_CUTOFF = 3.0
"""A Gaussian pixel filter ends at this many standard deviations: 0.3 % is left out, and the rest normalised."""


def splat_supersampled(
    means: Float[Tensor, "g 3"],
    quaternions: Float[Tensor, "g 4"],
    scales: Float[Tensor, "g 3"],
    opacities: Float[Tensor, " g"],
    features: Float[Tensor, "g d"],
    R: Float[Tensor, "3 3"],
    t: Float[Tensor, " 3"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    *,
    factor: int = 2,
    filter: Literal["box", "gaussian"] = "box",
    filter_std_px: float = 0.6,
    dilation_px2: float = 0.1,
    compensate_opacity: bool = False,
    near_m: float = 0.01,
    median_depth: bool = False,
) -> Splatted:
    """As `splat`, rendered `factor` times larger each way and averaged; differentiable likewise.

    Args:
        means, quaternions, scales, opacities, features, R, t, K, width, height: as for `splat`, of the final image.
        factor: samples per pixel and direction; 1 with the box filter is `splat` itself.
        filter: "box" averages a pixel's own samples. "gaussian" weighs samples by their distance to the pixel centre;
            a margin is rendered around the image so that its border is filtered like its middle.
        filter_std_px: standard deviation of the Gaussian filter, pixels of the final image.
        dilation_px2: px^2 of the large image: the dilation guards the spacing of the samples.
        compensate_opacity, near_m, median_depth: as for `splat`.

    Returns:
        features, alpha and depth, each the filtered mean of its samples. A median depth divided by alpha is then the
        mean of the samples' medians, each with its alpha for weight.

    Raises:
        ValueError: for a factor below 1 or an unknown filter, and what `splat` raises.
    """
    if factor < 1 or filter not in ("box", "gaussian") or not filter_std_px > 0:
        found = f"{factor}, {filter!r}, {filter_std_px}"
        raise ValueError(f"expected factor >= 1, filter 'box' or 'gaussian', filter_std_px > 0, found {found}")
    weights = (_box(factor) if filter == "box" else _gaussian(factor, filter_std_px)).to(means.device)
    margin = (len(weights) - factor) // 2
    scaled = K.detach().double() * K.new_tensor([[factor], [factor], [1.0]], dtype=torch.float64)
    scaled[:2, 2] += margin
    large = splat(
        means, quaternions, scales, opacities, features, R, t, scaled, width * factor + 2 * margin,
        height * factor + 2 * margin, dilation_px2=dilation_px2, compensate_opacity=compensate_opacity, near_m=near_m,
        median_depth=median_depth,
    )  # fmt: skip
    stacked = torch.cat([large.features, large.alpha[..., None], large.depth[..., None]], dim=2).permute(2, 0, 1)
    small = _filter_down(stacked, weights, factor).permute(1, 2, 0)
    return Splatted(small[..., :-2], small[..., -2], small[..., -1])


def _box(factor: int) -> Float[Tensor, " taps"]:
    return torch.full((factor,), 1.0 / factor)


def _gaussian(factor: int, std_px: float) -> Float[Tensor, " taps"]:
    """Weights of the samples within the cutoff, symmetric about the pixel centre: `factor` plus an even number."""
    beyond = max(0, math.ceil(GAUSSIAN_CUTOFF * std_px * factor - factor / 2))
    offset = torch.arange(factor + 2 * beyond) - (factor + 2 * beyond - 1) / 2
    weights = torch.exp(-0.5 * (offset / (factor * std_px)) ** 2)
    return weights / weights.sum()


def _filter_down(
    images: Float[Tensor, "c large_h large_w"], weights: Float[Tensor, " taps"], factor: int
) -> Float[Tensor, "c h w"]:
    """Separable filter, one output every `factor` samples."""
    if len(weights) == factor:
        return functional.avg_pool2d(images[None], factor)[0]
    column = functional.conv2d(images[:, None], weights[None, None, :, None], stride=(factor, 1))
    return functional.conv2d(column, weights[None, None, None, :], stride=(1, factor))[:, 0]
