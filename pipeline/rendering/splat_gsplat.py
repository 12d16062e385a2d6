"""Splatting on a GPU: `pipeline.rendering.splat.splat` by gsplat 1.5.3, with this project's conventions.

gsplat and `pipeline.rendering.splat_conventions` agree on EWA projection with J held within 0.3 of the half width
outside the image, pixel centres at 0.5, quaternions w first, the camera's z as depth and as order (ties by index), on
alpha < 1/255 skipped, alpha <= 0.999 and the stop before T would fall to 1e-4. `eps2d` is the dilation, and rasterize
mode "antialiased" is the compensated opacity. The version matters: later sources limit alpha to 0.99.

Where they differ: gsplat projects in float32, so that a needle without dilation may have a determinant of 0 and is then
left out; its gradients are summed by atomics, so the last bits change from run to run; it knows no median depth.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.base.errors import InputError
from pipeline.rendering.splat_conventions import MIN_DILATION_PX2, MIN_QUATERNION_NORM, Splatted

FARTHEST_M = torch.finfo(torch.float32).max
"""gsplat's far plane: none."""


def splat_gsplat(
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
    dilation_px2: float,
    compensate_opacity: bool,
    near_m: float,
    median_depth: bool,
) -> Splatted:
    """As `pipeline.rendering.splat.splat`, which checks the arguments; in float32.

    Raises:
        InputError: if gsplat is not installed, and for a median depth.
    """
    if median_depth:
        raise InputError("expected another depth than median on a GPU; set train_avatar.depth, or stay on the CPU")
    try:
        from gsplat import rasterization
    except ImportError as error:
        message = "expected gsplat for tensors on a GPU, found none; run pip install '.[gpu]', or stay on the CPU"
        raise InputError(message) from error
    if len(means) == 0:
        black = features.new_zeros(height, width, features.shape[1], dtype=torch.float32)
        return Splatted(black, black.new_zeros(height, width), black.new_zeros(height, width))
    view = torch.eye(4, device=means.device)
    view[:3, :3], view[:3, 3] = R.detach(), t.detach()
    images, alphas, _ = rasterization(
        means=means.float(),
        quats=_usable(quaternions.float()),
        scales=scales.float(),
        opacities=opacities.float(),
        colors=features.float(),
        viewmats=view[None],
        Ks=K.detach().float()[None],
        width=width,
        height=height,
        near_plane=near_m,
        far_plane=FARTHEST_M,
        eps2d=max(dilation_px2, MIN_DILATION_PX2),
        packed=False,
        render_mode="RGB+D",
        rasterize_mode="antialiased" if compensate_opacity else "classic",
    )
    return Splatted(images[0, ..., :-1], alphas[0, ..., 0], images[0, ..., -1])


def _usable(quaternions: Float[Tensor, "g 4"]) -> Float[Tensor, "g 4"]:
    """Quaternions that gsplat can normalise: no rotation, without gradient, in place of those that are too short."""
    long_enough = quaternions.detach().norm(dim=1, keepdim=True) > MIN_QUATERNION_NORM
    return torch.where(long_enough, quaternions, quaternions.new_tensor([1.0, 0.0, 0.0, 0.0]))
