"""Errors of the kernels against the float64 reference on one scene: value, gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.rendering.splat import splat
from pipeline.rendering.splat_conventions import (
    MAX_ALPHA,
    MEDIAN_TRANSMITTANCE,
    MIN_ALPHA,
    MIN_TRANSMITTANCE,
    Splatted,
)
from pipeline.rendering.splat_reference import footprint_alphas, pixel_centers, project_footprints, splat_reference
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions

UNDECIDED = 1e-4
"""Relative distance to a threshold (MIN_ALPHA, MAX_ALPHA, a transmittance) below which float32 may decide otherwise
than float64: 50 times the rounding of alpha, 2e-6. Such pixels jump by up to 1/255 and are left out."""


class Disagreement(NamedTuple):
    """Kernels against reference.

    Attributes:
        value: largest absolute difference of features and alpha, and of depth over the largest depth drawn.
        gradients: for means, quaternions, scales, opacities, features: |difference| / |reference| over all
            Gaussians; for a reference of exactly zero, |difference|.
        finite: whether every output and gradient of the kernels is.
        undecided: share of the pixels left out.
    """

    value: float
    gradients: dict[str, float]
    finite: bool
    undecided: float


def compare_with_reference(
    gaussians: Gaussians, features: Float[Tensor, "g d"], view: CameraView, options: SplatOptions = SplatOptions(),
    *, seed: int = 0,
) -> Disagreement:  # fmt: skip
    """Render with kernels and reference, and back-propagate the same random gradients. They are seeded by `seed`."""
    skip = undecided_pixels(gaussians, view, options)
    generator = torch.Generator().manual_seed(seed)
    sizes = [(view.height, view.width, channels) for channels in (features.shape[1], 1, 1)]
    upstream = [torch.randn(size, generator=generator, dtype=torch.float64) * ~skip[..., None] for size in sizes]
    tensors = {**gaussians.named(), "features": features}
    fast, fast_gradients = _render(splat, torch.float32, tensors, (view, options), upstream)
    slow, slow_gradients = _render(splat_reference, torch.float64, tensors, (view, options), upstream)
    finite = all(bool(torch.isfinite(a).all()) for a in (*fast, *fast_gradients))
    scales = (1.0, 1.0, max(1.0, float(slow.depth.max())))
    largest = [(a - b).abs()[~skip] / scale for a, b, scale in zip(fast, slow, scales, strict=True)]
    value = max([float(a.max()) for a in largest if a.numel()], default=0.0)
    gradients = {
        name: float((a - b).norm() / (b.norm() if b.norm() > 0 else 1.0))
        for name, a, b in zip(tensors, fast_gradients, slow_gradients, strict=True)
    }
    return Disagreement(value, gradients, finite, float(skip.double().mean()))


def undecided_pixels(gaussians: Gaussians, view: CameraView, options: SplatOptions) -> Bool[Tensor, "h w"]:
    """Pixels where some alpha or transmittance is so close to a threshold that rounding decides."""
    width, height = view.width, view.height
    doubles = gaussians.map(lambda tensor: tensor.detach().double())
    footprints = project_footprints(doubles, view.to(torch.float64), options)
    alphas = footprint_alphas(footprints, pixel_centers(width, height))
    undecided = (alphas / MIN_ALPHA - 1).abs() < UNDECIDED
    undecided |= (alphas / MAX_ALPHA - 1).abs() < UNDECIDED
    alphas = torch.where(alphas >= MIN_ALPHA, alphas.clamp(max=MAX_ALPHA), torch.zeros_like(alphas))
    behind = torch.cumprod(1 - alphas, dim=1)
    undecided |= (behind / MIN_TRANSMITTANCE - 1).abs() < UNDECIDED
    if options.median_depth:
        undecided |= (behind / MEDIAN_TRANSMITTANCE - 1).abs() < UNDECIDED
    return undecided.any(dim=1).reshape(height, width)


def _render(
    function: Callable[..., Splatted], dtype: torch.dtype, tensors: dict[str, Tensor], camera: tuple, upstream: list
) -> tuple[Splatted, list[Tensor]]:
    """Images and gradients, as float64."""
    leaves = [a.detach().to(dtype).clone().requires_grad_() for a in tensors.values()]
    out = function(Gaussians(*leaves[:4]), leaves[4], *camera)
    images = [out.features, out.alpha[..., None], out.depth[..., None]]
    reached = [k for k, image in enumerate(images) if image.requires_grad]  # none without visible Gaussians
    torch.autograd.backward([images[k] for k in reached], [upstream[k].to(dtype) for k in reached])
    detached = Splatted(*(a.detach().double() for a in images))
    return detached, [torch.zeros_like(a).double() if a.grad is None else a.grad.double() for a in leaves]
