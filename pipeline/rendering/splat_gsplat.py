"""Splatting on a GPU.

`pipeline.rendering.splat.splat` by gsplat 1.5.3, with this project's conventions.

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
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions

FARTHEST_M = torch.finfo(torch.float32).max
"""gsplat's far plane: none."""


def splat_gsplat(
    gaussians: Gaussians, features: Float[Tensor, "g d"], view: CameraView, options: SplatOptions
) -> Splatted:
    """Splat by gsplat, in float32, as `splat` does, which checks the arguments.

    Raises:
        InputError: if gsplat is not installed, and for a median depth.
    """
    if options.median_depth:
        raise InputError("expected another depth than median on a GPU; set train_avatar.depth, or stay on the CPU")
    try:
        from gsplat import rasterization
    except ImportError as error:
        message = "expected gsplat for tensors on a GPU, found none; run pip install '.[gpu]', or stay on the CPU"
        raise InputError(message) from error
    if len(gaussians) == 0:
        black = features.new_zeros(view.height, view.width, features.shape[1], dtype=torch.float32)
        return Splatted(black, black.new_zeros(view.height, view.width), black.new_zeros(view.height, view.width))
    camera_from_world = torch.eye(4, device=features.device)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = view.R.detach(), view.t.detach()
    images, alphas, _ = rasterization(
        means=gaussians.means.float(),
        quats=_usable(gaussians.quaternions.float()),
        scales=gaussians.scales.float(),
        opacities=gaussians.opacities.float(),
        colors=features.float(),
        viewmats=camera_from_world[None],
        Ks=view.K.detach().float()[None],
        width=view.width,
        height=view.height,
        near_plane=options.near_m,
        far_plane=FARTHEST_M,
        eps2d=max(options.dilation_px2, MIN_DILATION_PX2),
        packed=False,
        render_mode="RGB+D",
        rasterize_mode="antialiased" if options.compensate_opacity else "classic",
    )
    return Splatted(images[0, ..., :-1], alphas[0, ..., 0], images[0, ..., -1])


def _usable(quaternions: Float[Tensor, "g 4"]) -> Float[Tensor, "g 4"]:
    """Quaternions that gsplat can normalise: no rotation, without gradient, in place of those that are too short."""
    long_enough = quaternions.detach().norm(dim=1, keepdim=True) > MIN_QUATERNION_NORM
    return torch.where(long_enough, quaternions, quaternions.new_tensor([1.0, 0.0, 0.0, 0.0]))
