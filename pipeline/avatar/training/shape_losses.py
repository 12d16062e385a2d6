"""Terms of the training loss that hold primitives in shape (RFGCA 18, RGCA 14).

Of boxes, those of Lombardi et al. 2021.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.penalties import outside, outside_as_printed
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.model import Avatar
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.training_losses import Bound

SCALE_BOUNDS_M = (1e-4, 1e-2)
"""Bounds of Gaussian scales (RFGCA Appendix B), of a person; see `length_unit_m` for other subjects."""

SCENE_RADIUS_M = 0.25
"""Half sizes of boxes are multiplied in this unit: the paper's scene, a head with hair and shoulders, has radius 1."""


def shape_terms(avatar: Avatar, frame: PreparedFrame, weights: TrainAvatar) -> dict[str, Tensor]:
    """Offsets and sizes of primitives, weighted.

    Boxes shrink to what they are needed for: the sum over them of the product of their half sizes, as printed.
    """
    size, gaussians = avatar.unit_m, frame.gaussians
    if weights.offset_unit == "texel":
        size = avatar.spacing.mean(-1, keepdim=True)
        size = size[avatar.box_anchor] if avatar.spec.volumes else size
    terms = {"offset": weights.weight_offset * (frame.parameters.offset / size).square().mean()}
    if avatar.spec.volumes:
        half_sizes = gaussians.volumes.half_sizes / (SCENE_RADIUS_M * avatar.unit_m)
        return terms | {"volume": weights.weight_volume * half_sizes.prod(-1).sum()}
    return terms | {
        "scale": weights.weight_scale * scales_outside(avatar, gaussians.scales, weights.bound),
        "size": weights.weight_size * gaussians.scales.mean() / avatar.unit_m,
    }


def scales_outside(avatar: Avatar, scales_m: Float[Tensor, "texels 3"], bound: Bound) -> Float[Tensor, ""]:
    """Scales outside of their bounds.

    As printed in metres for bodies (RFGCA B.2), in millimetres for heads (RGCA 14).
    """
    low, high = (avatar.unit_m * bound_m for bound_m in SCALE_BOUNDS_M)
    if bound == "log":
        return outside(scales_m, low, high)
    unit_m = (1e-3 if avatar.spec.head else 1.0) * avatar.unit_m
    return outside_as_printed(scales_m / unit_m, low / unit_m, high / unit_m)
