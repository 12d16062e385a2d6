"""Definition of a splatted image, for the kernels and the reference that checks them.

A Gaussian with mean m, rotation V (from its quaternion) and scales s is seen by a camera ``x = R m + t``, ``K``. With
z its camera depth, J the Jacobian of the perspective projection at its mean and M = J R V diag(s), its footprint is

    covariance = M M^T + dilation_px2 * I                              (EWA splatting, Zwicker et al. 2001)
    alpha(pixel) = min(MAX_ALPHA, opacity * exp(-q / 2)),  q = d^T covariance^-1 d,  d = pixel centre - projected mean

and a pixel blends the Gaussians in front-to-back order of z (rounded to float32; ties by index) with weights
w_i = alpha_i T_i, T_i = prod_{j<i} (1 - alpha_j)                      (Kerbl et al. 2023, eq. 2 and 3).

With `compensate_opacity`, the dilation spreads a footprint without adding to it. A footprint's integral over the image
is opacity * 2 pi sqrt(det covariance), so one that is dilated keeps the integral of one that is not if

    opacity' = opacity * sqrt(det(M M^T) / det(M M^T + dilation_px2 * I))        (Yu et al. 2024, Mip-Splatting, eq. 9).

It undoes the growth of small footprints, and also lets light through between opaque neighbours: they were to overlap.

The constants are those of gsplat 1.5.3 (Ye et al. 2024), so that an avatar looks the same in either.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

MAX_ALPHA = 0.999
"""No Gaussian is fully opaque, so that the backward pass may divide by 1 - alpha >= 1e-3."""

MIN_ALPHA = 1.0 / 255.0
"""Fainter contributions are skipped: one step of an 8-bit image. A footprint ends there, at q = 2 ln(255 opacity)."""

MIN_TRANSMITTANCE = 1e-4
"""A pixel stops before the Gaussian that would leave no more than this much light to what lies behind."""

MEDIAN_TRANSMITTANCE = 0.5
"""The median depth of a pixel is that of the last Gaussian that more than this share of the light comes to."""

FRUSTUM_MARGIN = 0.3
"""J is evaluated no further outside the image than this share of its half width: the affine approximation of the
perspective projection explodes at grazing angles."""

MIN_DILATION_PX2 = 1e-6
"""Floor of the dilation, px^2: a standard deviation of a thousandth of a pixel, so a Gaussian without extent still
covers 3.3e-3 px around its mean and shows only where a pixel centre falls in there. It keeps the determinant at or
above 1e-12 and the entries of the inverse covariance at or below 1e6; 16,384 px away that is an exponent below 1e15: no
overflow in float32. Being a floor of the dilation and not of the determinant, it leaves the gradient exact."""

MIN_QUATERNION_NORM = 1e-12
"""Shorter quaternions mean no rotation, with gradient 0. Above it gradients, which go with 1 / norm, stay finite."""


MIN_NEAR_M = 1e-6
"""Smallest near plane, m. With focal lengths up to 1e5 px and any finite float32 mean and scale, no intermediate of the
projection exceeds 1e200 in float64."""


class Splatted(NamedTuple):
    """Images of one camera, row 0 at the top.

    Attributes:
        features: sum of w_i features_i; black background.
        alpha: 1 - T behind the last Gaussian, in [0, 1).
        depth: sum of w_i z_i in metres, not divided by alpha. With `median_depth`, alpha times the z of the Gaussian at
            which T falls to MEDIAN_TRANSMITTANCE, or of the last one drawn if T stays above; without gradient.
    """

    features: Float[Tensor, "h w d"]
    alpha: Float[Tensor, "h w"]
    depth: Float[Tensor, "h w"]


class NotFinite(ValueError):
    """An argument holds NaN or infinity."""


def check_splat_inputs(
    tensors: dict[str, Tensor], K: Tensor, width: int, height: int, dilation_px2: float, near_m: float
) -> None:
    """Refuse, naming the argument, what would come out as a wrong image, by a ValueError.

    Args:
        tensors: name -> tensor; all must have the same length, lie on one device and be finite. `R` and `t` may have
            any length.
        K: intrinsics in pixels without skew.
    """
    counts = {name: len(tensor) for name, tensor in tensors.items() if name not in ("R", "t")}
    if len(set(counts.values())) > 1:
        raise ValueError(f"splat: expected as many of each, found {counts}")
    for name, tensor in {**tensors, "K": K}.items():
        if tensor.device != K.device:
            raise ValueError(f"{name}: expected a tensor on {K.device} like K, found {tensor.device}")
        # The sum is ten times cheaper; it may overflow without a bad number, so only it asks for the careful look.
        if not bool(torch.isfinite(tensor.detach().sum())) and not bool(torch.isfinite(tensor).all()):
            bad = torch.nonzero(~torch.isfinite(tensor))
            raise NotFinite(f"{name}: expected finite numbers, found {len(bad)} others, first at {bad[0].tolist()}")
    if K[0, 1] != 0 or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise ValueError(f"K: expected positive focal lengths and no skew, found {K[:2, :2].tolist()}")
    if width < 1 or height < 1:
        raise ValueError(f"width, height: expected at least 1, found {width}, {height}")
    if not (0 <= dilation_px2 < math.inf and MIN_NEAR_M <= near_m < math.inf):
        found = f"{dilation_px2} and {near_m}"
        raise ValueError(f"expected dilation_px2 >= 0 and near_m >= {MIN_NEAR_M}, both finite, found {found}")
