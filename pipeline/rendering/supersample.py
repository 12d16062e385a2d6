"""Rendering at a multiple of the resolution, then filtering down.

Less blur than a wide dilation, less aliasing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.rendering.filter_kernels import filter_backward, filter_forward
from pipeline.rendering.splat import splat
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions, Supersampling

GAUSSIAN_CUTOFF = 3.0
"""A Gaussian pixel filter ends at this many standard deviations: 0.3 % is left out, and the rest normalised."""


def splat_supersampled(
    gaussians: Gaussians,
    features: Float[Tensor, "g d"],
    view: CameraView,
    options: SplatOptions = SplatOptions(),
    sampling: Supersampling = Supersampling(),
) -> Splatted:
    """Splat at a multiple of the resolution and filter down; differentiable as `splat` is.

    Args:
        gaussians, features, view: as for `splat`, of the final image.
        options: as for `splat`, but the dilation, which guards the spacing of the samples, is px^2 of the large image.
        sampling: how much larger, and the filter.

    Returns:
        features, alpha and depth, each the filtered mean of its samples. A median depth divided by alpha is then the
        mean of the samples' medians, each with its alpha for weight.

    Raises:
        ValueError: for a factor below 1 or an unknown filter, and what `splat` raises.
    """
    return supersampled(lambda large: splat(gaussians, features, large, options), view, sampling)


def supersampled(render: Callable[[CameraView], Splatted], view: CameraView, sampling: Supersampling) -> Splatted:
    """Render at a multiple of the resolution and filter down.

    Raises:
        ValueError: for a factor below 1 or an unknown filter, and what `render` raises.
    """
    factor, std_px, K = sampling.factor, sampling.filter_std_px, view.K
    if factor < 1 or sampling.filter not in ("box", "gaussian") or not std_px > 0:
        found = f"{factor}, {sampling.filter!r}, {std_px}"
        raise ValueError(f"expected factor >= 1, filter 'box' or 'gaussian', filter_std_px > 0, found {found}")
    weights = (_box(factor) if sampling.filter == "box" else _gaussian(factor, std_px)).to(K.device)
    margin = (len(weights) - factor) // 2
    scaled = K.detach().double() * K.new_tensor([[factor], [factor], [1.0]], dtype=torch.float64)
    scaled[:2, 2] += margin
    width, height = view.width * factor + 2 * margin, view.height * factor + 2 * margin
    large = render(CameraView(view.R, view.t, scaled, width, height))
    stacked = torch.cat([large.features, large.alpha[..., None], large.depth[..., None]], dim=2)
    small = filter_down(stacked, weights, factor)
    return Splatted(small[..., :-2], small[..., -2], small[..., -1])


def _box(factor: int) -> Float[Tensor, " taps"]:
    return torch.full((factor,), 1.0 / factor)


def _gaussian(factor: int, std_px: float) -> Float[Tensor, " taps"]:
    """Weights of the samples within the cutoff, symmetric about the pixel centre: `factor` plus an even number."""
    beyond = max(0, math.ceil(GAUSSIAN_CUTOFF * std_px * factor - factor / 2))
    offset = torch.arange(factor + 2 * beyond) - (factor + 2 * beyond - 1) / 2
    weights = torch.exp(-0.5 * (offset / (factor * std_px)) ** 2)
    return weights / weights.sum()


def filter_down(
    images: Float[Tensor, "large_h large_w c"], weights: Float[Tensor, " taps"], factor: int
) -> Float[Tensor, "h w c"]:
    """Separable filter, one output every `factor` samples.

    Differentiable in the images; by a kernel on the CPU.
    """
    if images.device.type != "cpu":
        return filter_down_reference(images, weights, factor)
    return _FilterDown.apply(images, weights, factor)


def filter_down_reference(images: Tensor, weights: Tensor, factor: int) -> Tensor:
    """Slow twin of `filter_down`, its oracle forward and backward.

    On any device and in any float type.
    """
    channels_first = images.permute(2, 0, 1)[:, None]
    column = functional.conv2d(channels_first, weights[None, None, :, None], stride=(factor, 1))
    return functional.conv2d(column, weights[None, None, None, :], stride=(1, factor))[:, 0].permute(1, 2, 0)


class _FilterDown(torch.autograd.Function):
    @staticmethod
    def forward(ctx, images, weights, factor):
        large_height, large_width, channels = images.shape
        ctx.size, ctx.weights, ctx.factor = tuple(images.shape), weights.numpy(), factor
        height, width = ((side - len(weights)) // factor + 1 for side in (large_height, large_width))
        out = torch.empty(height, width, channels)
        rows = images.detach().contiguous().view(large_height, -1).numpy()
        filter_forward(rows, ctx.weights, factor, out.numpy())
        return out

    @staticmethod
    def backward(ctx, grad_out):
        large_height, large_width, channels = ctx.size
        grad_images = torch.empty(large_height, large_width * channels)
        scratch = np.empty((grad_out.shape[0], large_width * channels), np.float32)
        filter_backward(grad_out.contiguous().numpy(), ctx.weights, ctx.factor, scratch, grad_images.numpy())
        return grad_images.view(ctx.size), None, None
