"""Slow, readable twin of `pipeline.rendering.splat`.

Every pixel against every Gaussian, gradients by autograd.

It is the oracle of the kernels and may run in float64. Conventions: `pipeline.rendering.splat_conventions`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.rendering.splat_conventions import (
    FRUSTUM_MARGIN,
    MAX_ALPHA,
    MEDIAN_TRANSMITTANCE,
    MIN_ALPHA,
    MIN_DILATION_PX2,
    MIN_QUATERNION_NORM,
    MIN_TRANSMITTANCE,
    Splatted,
)
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions, check_splat_arguments

PAIRS_AT_ONCE = 1 << 22
"""Pixels x Gaussians handled together: about 100 MB of float64 per intermediate with three components."""


class Footprints(NamedTuple):
    """Gaussians as one camera sees them, front to back; those behind `near_m` are gone.

    Attributes:
        index: which Gaussian each row is.
        center_px: projected means.
        factor: M = J R V diag(s), px; the covariance is M M^T + dilation.
        dilation_px2: added variance.
        opacity: after compensation.
        depth_m: camera depth of the mean.
    """

    index: Int64[Tensor, " v"]
    center_px: Float[Tensor, "v 2"]
    factor: Float[Tensor, "v 2 3"]
    dilation_px2: float
    opacity: Float[Tensor, " v"]
    depth_m: Float[Tensor, " v"]


def splat_reference(
    gaussians: Gaussians, features: Float[Tensor, "g d"], view: CameraView, options: SplatOptions = SplatOptions()
) -> Splatted:
    """Splat Gaussians into one image, in the dtype of their means. Otherwise as `pipeline.rendering.splat.splat`."""
    check_splat_arguments(gaussians, features, view, options)
    footprints = project_footprints(gaussians, view.to(gaussians.means.dtype), options)
    width, height, median_depth = view.width, view.height, options.median_depth
    channels = torch.cat([features[footprints.index], footprints.depth_m[:, None]], dim=1)
    pixels = pixel_centers(width, height).to(gaussians.means.dtype)
    blended, alpha = [], []
    for chunk in pixels.split(max(1, PAIRS_AT_ONCE // max(1, len(channels)))):
        weights, transmittance = blend_weights(footprint_alphas(footprints, chunk))
        image = weights @ channels
        if median_depth:
            depth = (1 - transmittance) * middle_depth(weights, footprints.depth_m)
            image = torch.cat([image[:, :-1], depth[:, None]], dim=1)
        blended.append(image)
        alpha.append(1 - transmittance)
    image = torch.cat(blended).reshape(height, width, -1)
    depth = image[..., -1].detach() if median_depth else image[..., -1]
    return Splatted(image[..., :-1], torch.cat(alpha).reshape(height, width), depth)


def middle_depth(weights: Float[Tensor, "p v"], depth_m: Float[Tensor, " v"]) -> Float[Tensor, " p"]:
    """Median depth: that of the last Gaussian drawn that enough of the light comes to.

    More than MEDIAN_TRANSMITTANCE; 0 without any Gaussian.

    What comes to Gaussian i is what the ones before it let through, 1 - sum of their weights.
    """
    if weights.shape[1] == 0:
        return weights.new_zeros(len(weights))
    arriving = 1 - (torch.cumsum(weights, dim=1) - weights)
    position = torch.arange(1, weights.shape[1] + 1) * ((weights > 0) & (arriving > MEDIAN_TRANSMITTANCE))
    last = position.amax(dim=1)
    return torch.where(last > 0, depth_m[last.clamp_min(1) - 1], 0.0)


def pixel_centers(width: int, height: int) -> Float64[Tensor, "pixels 2"]:
    """Pixel centres (x, y), row by row from the top left."""
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([columns, rows], dim=-1).reshape(-1, 2).double() + PIXEL_CENTER


def rotations_from_quaternions(quaternions: Float[Tensor, "g 4"]) -> Float[Tensor, "g 3 3"]:
    """Rotation matrices of (w, x, y, z) quaternions of any length. A zero quaternion is no rotation."""
    norm_squared = (quaternions**2).sum(dim=1, keepdim=True)
    usable = norm_squared > MIN_QUATERNION_NORM**2
    unit = torch.where(usable, quaternions, torch.zeros_like(quaternions))
    unit = unit / torch.sqrt(torch.where(usable, norm_squared, torch.ones_like(norm_squared)))
    w, x, y, z = unit.unbind(dim=1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def project_footprints(gaussians: Gaussians, view: CameraView, options: SplatOptions) -> Footprints:
    """Project means in perspective, and factors by its Jacobian there; sorted by depth."""
    means, R, t, K = gaussians.means, view.R, view.t, view.K
    dilation_px2 = max(options.dilation_px2, MIN_DILATION_PX2)
    depth64 = means.detach().double() @ R[2].double() + t[2].double()
    order = torch.argsort(depth64.float(), stable=True)
    order = order[depth64[order] >= options.near_m]
    x, y, z = (means[order] @ R.T + t).unbind(dim=1)
    focal, principal = torch.stack([K[0, 0], K[1, 1]]), torch.stack([K[0, 2], K[1, 2]])
    slope = torch.stack([x / z, y / z], dim=1)
    size = torch.tensor([view.width, view.height], dtype=means.dtype)
    margin = FRUSTUM_MARGIN * 0.5 * size / focal
    clamped = torch.minimum(torch.maximum(slope, -principal / focal - margin), (size - principal) / focal + margin)
    jacobian = torch.cat([torch.diag_embed(focal / z[:, None]), (-focal * clamped / z[:, None])[:, :, None]], dim=2)
    factor = (jacobian @ R @ rotations_from_quaternions(gaussians.quaternions[order])) * gaussians.scales[order][
        :, None, :
    ]
    opacity = gaussians.opacities[order]
    if options.compensate_opacity:
        area_squared = (torch.linalg.cross(factor[:, 0], factor[:, 1]) ** 2).sum(dim=1)
        visible = area_squared > 0
        area = torch.where(visible, torch.sqrt(torch.where(visible, area_squared, torch.ones_like(z))), 0 * z)
        opacity = opacity * area / torch.sqrt(_determinant(factor, dilation_px2))
    return Footprints(order, slope * focal + principal, factor, dilation_px2, opacity, z)


def _determinant(factor: Float[Tensor, "v 2 3"], dilation_px2: float) -> Float[Tensor, " v"]:
    """det(M M^T + dilation I) as a sum of squares: det(M M^T) = |a x b|^2 for the rows a, b of M (Cauchy-Binet)."""
    area_squared = (torch.linalg.cross(factor[:, 0], factor[:, 1]) ** 2).sum(dim=1)
    return area_squared + dilation_px2 * (factor**2).sum(dim=(1, 2)) + dilation_px2**2


def footprint_alphas(footprints: Footprints, pixels: Float[Tensor, "p 2"]) -> Float[Tensor, "p v"]:
    """Opacity exp(-q / 2) of every Gaussian at every pixel.

    Before the limits MAX_ALPHA and MIN_ALPHA.

    q = d^T adj(covariance) d / det, and the numerator is |a d_y - b d_x|^2 + dilation |d|^2: again no cancellation.
    """
    dx, dy = (pixels[:, None, :] - footprints.center_px[None]).unbind(dim=2)
    a, b = footprints.factor[:, 0], footprints.factor[:, 1]
    across = sum((a[:, k] * dy - b[:, k] * dx) ** 2 for k in range(3))
    determinant = _determinant(footprints.factor, footprints.dilation_px2)
    q = (across + footprints.dilation_px2 * (dx**2 + dy**2)) / determinant
    return footprints.opacity * torch.exp(-0.5 * q)


def blend_weights(alphas: Float[Tensor, "p v"]) -> tuple[Float[Tensor, "p v"], Float[Tensor, " p"]]:
    """Front-to-back blending weights w_i = alpha_i T_i, and the transmittance left at the end.

    Args:
        alphas: as `footprint_alphas` returns them, front to back.
    """
    alphas = torch.where(alphas >= MIN_ALPHA, torch.clamp(alphas, max=MAX_ALPHA), torch.zeros_like(alphas))
    behind = torch.cumprod(1 - alphas, dim=1)
    alphas = torch.where(behind > MIN_TRANSMITTANCE, alphas, torch.zeros_like(alphas))
    behind = torch.cumprod(1 - alphas, dim=1)
    before = torch.cat([torch.ones_like(behind[:, :1]), behind[:, :-1]], dim=1)
    return alphas * before[:, : alphas.shape[1]], behind[:, -1] if alphas.shape[1] else torch.ones_like(alphas.sum(1))
