"""Splatting as it is usually written down: covariances are multiplied out, and inverted by their determinant.

In float32, with gradients by autograd (Zwicker et al. 2001; Kerbl et al. 2023). What is a matter of convention, where
footprints end and what is too near, is as in `pipeline.rendering.splat`.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.rendering.splat_conventions import FRUSTUM_MARGIN, MAX_ALPHA, MIN_ALPHA, Splatted
from pipeline.rendering.splat_reference import blend_weights, pixel_centers
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions


def naive_splat(
    gaussians: Gaussians, features: Float[Tensor, "g d"], view: CameraView, options: SplatOptions = SplatOptions(),
    bounded: bool = True,
) -> Splatted:  # fmt: skip
    """Splat Gaussians into one image; otherwise as `pipeline.rendering.splat.splat`, without its median depth.

    Not `bounded`: without a near plane, and with perspective taken for linear however far aside a Gaussian is.
    """
    depth = gaussians.means @ view.R[2] + view.t[2]
    order = torch.argsort(depth.detach(), stable=True)
    order = order[depth.detach()[order] >= (options.near_m if bounded else -torch.inf)]
    x, y, z = (gaussians.means[order] @ view.R.T + view.t).unbind(1)
    K, zero = view.K, torch.zeros_like(z)
    margin = FRUSTUM_MARGIN if bounded else torch.inf
    limits = [(1 + margin) * side / 2 / K[i, i] for i, side in enumerate((view.width, view.height))]
    u, v = ((a / z).clamp(-limit, limit) for a, limit in ((x, limits[0]), (y, limits[1])))
    rows = [
        torch.stack([K[0, 0] / z, zero, -K[0, 0] * u / z], 1),
        torch.stack([zero, K[1, 1] / z, -K[1, 1] * v / z], 1),
    ]
    J = torch.stack(rows, 1) @ view.R
    axes = naive_rotations(gaussians.quaternions[order]) @ torch.diag_embed(gaussians.scales[order])
    flat = J @ (axes @ axes.mT) @ J.mT
    cov = flat + options.dilation_px2 * torch.eye(2)
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    determinant, opacity = a * c - b * b, gaussians.opacities[order]
    if options.compensate_opacity:
        before = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1].square()
        opacity = opacity * (before / determinant).clamp(min=0).sqrt()
    centers = torch.stack([K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]], 1)
    px, py = (pixel_centers(view.width, view.height).to(z)[:, None] - centers).unbind(-1)
    power = (c * px * px - 2 * b * px * py + a * py * py) / determinant
    alphas = opacity * torch.exp(-0.5 * power)
    alphas = torch.where(alphas < MIN_ALPHA, 0.0, alphas.clamp(max=MAX_ALPHA))
    weights, transmittance = blend_weights(alphas)
    image = (weights @ torch.cat([features[order], z[:, None]], 1)).reshape(view.height, view.width, -1)
    return Splatted(image[..., :-1], (1 - transmittance).reshape(view.height, view.width), image[..., -1])


def naive_rotations(quaternions: Float[Tensor, "g 4"]) -> Float[Tensor, "g 3 3"]:
    """Rotation matrices of quaternions over their lengths."""
    w, x, y, z = (quaternions / quaternions.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)
