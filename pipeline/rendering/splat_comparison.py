"""How far the kernels are from the float64 reference on one scene: value and gradients."""

from __future__ import annotations

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
    gaussians: dict[str, Tensor],
    R: Float[Tensor, "3 3"],
    t: Float[Tensor, " 3"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    *,
    seed: int = 0,
    **settings: float | bool,
) -> Disagreement:
    """Render with both and back-propagate the same random pixel gradients.

    Args:
        gaussians: the first five arguments of `splat`, by name.
        R, t, K, width, height: the camera.
        seed: of the pixel gradients.
        settings: the other arguments of `splat`.
    """
    camera = (R, t, K, width, height)
    skip = undecided_pixels(gaussians, *camera, **settings)
    draws = torch.Generator().manual_seed(seed)
    sizes = [(height, width, gaussians["features"].shape[1]), (height, width, 1), (height, width, 1)]
    upstream = [torch.randn(size, generator=draws, dtype=torch.float64) * ~skip[..., None] for size in sizes]
    fast, fast_gradients = _render(splat, torch.float32, gaussians, camera, upstream, settings)
    slow, slow_gradients = _render(splat_reference, torch.float64, gaussians, camera, upstream, settings)
    finite = all(bool(torch.isfinite(a).all()) for a in (*fast, *fast_gradients))
    scales = (1.0, 1.0, max(1.0, float(slow.depth.max())))
    largest = [(a - b).abs()[~skip] / scale for a, b, scale in zip(fast, slow, scales, strict=True)]
    value = max([float(a.max()) for a in largest if a.numel()], default=0.0)
    gradients = {
        name: float((a - b).norm() / (b.norm() if b.norm() > 0 else 1.0))
        for name, a, b in zip(gaussians, fast_gradients, slow_gradients, strict=True)
    }
    return Disagreement(value, gradients, finite, float(skip.double().mean()))


def undecided_pixels(
    gaussians: dict[str, Tensor], R: Tensor, t: Tensor, K: Tensor, width: int, height: int, *,
    dilation_px2: float = 0.1, compensate_opacity: bool = False, near_m: float = 0.01, median_depth: bool = False,
) -> Bool[Tensor, "h w"]:  # fmt: skip
    """Pixels where some alpha or transmittance is so close to a threshold that rounding decides."""
    means, quaternions, scales, opacities = (
        gaussians[name].detach().double() for name in ("means", "quaternions", "scales", "opacities")
    )
    footprints = project_footprints(
        means, quaternions, scales, opacities, R.double(), t.double(), K.double(), width, height,
        dilation_px2=dilation_px2, compensate_opacity=compensate_opacity, near_m=near_m,
    )  # fmt: skip
    alphas = footprint_alphas(footprints, pixel_centers(width, height))
    undecided = (alphas / MIN_ALPHA - 1).abs() < UNDECIDED
    undecided |= (alphas / MAX_ALPHA - 1).abs() < UNDECIDED
    alphas = torch.where(alphas >= MIN_ALPHA, alphas.clamp(max=MAX_ALPHA), torch.zeros_like(alphas))
    behind = torch.cumprod(1 - alphas, dim=1)
    undecided |= (behind / MIN_TRANSMITTANCE - 1).abs() < UNDECIDED
    if median_depth:
        undecided |= (behind / MEDIAN_TRANSMITTANCE - 1).abs() < UNDECIDED
    return undecided.any(dim=1).reshape(height, width)


def _render(
    function, dtype: torch.dtype, gaussians: dict, camera: tuple, upstream: list, settings: dict
) -> tuple[Splatted, list[Tensor]]:
    """Images and gradients, as float64."""
    leaves = {name: a.detach().to(dtype).clone().requires_grad_() for name, a in gaussians.items()}
    out = function(**leaves, R=camera[0], t=camera[1], K=camera[2], width=camera[3], height=camera[4], **settings)
    images = [out.features, out.alpha[..., None], out.depth[..., None]]
    reached = [k for k, image in enumerate(images) if image.requires_grad]  # none without visible Gaussians
    torch.autograd.backward([images[k] for k in reached], [upstream[k].to(dtype) for k in reached])
    detached = Splatted(*(a.detach().double() for a in images))
    return detached, [torch.zeros_like(a).double() if a.grad is None else a.grad.double() for a in leaves.values()]
