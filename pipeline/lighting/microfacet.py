"""Glossy reflection of point lights that a surface point sees.

Cook-Torrance with GGX or, as learned lobes have it, with a Gaussian of the half vector's angle. What is reflected
without gloss is in `pipeline.lighting.matte`.

Every pair of point and light has its own visibility bit, so a shadow has an edge, and each highlight is shadowed by
itself: what one shadow factor per point (RFGCA 16) cannot do. Rows of bits are packed as np.packbits does
(`pipeline.lighting.visibility_bits`). The sum comes with its derivatives, made in the same pass.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting import reflection_kernels
from pipeline.lighting.device_sums import sum_in_pieces, unpacked
from pipeline.lighting.lobes import angle_between
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.reflection_kernels import DIELECTRIC_F0, LOBE_SCALE, SMALLEST_COSINE
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2


def gather_reflections(
    points: Float[Tensor, "points 3"],
    normals: Float[Tensor, "points 3"],
    to_camera: Float[Tensor, "points 3"],
    alpha: Float[Tensor, " points"],
    lights: PointLights,
    gaussian: bool = False,
) -> Float[Tensor, "points channels"]:
    """Radiance of a dielectric's gloss under point lights.

    sum_j V_j I_j / d_j^2 D G F / (4 (n . w_j) (n . w_o)) max(0, n . w_j)

    D and G of GGX, G correlated in height (Heitz 2014, eqs. 71, 99), F by Schlick's approximation. Differentiable in
    `normals` and `alpha`; points that face away from the camera have 0.

    With `gaussian`, D is a Gaussian of the angle between n and the half vector h, scaled so that straight back from a
    mirror comes what the papers' lobe has there: G(2 angle(n, h); sigma), sigma = sqrt(2) alpha (RFGCA 13). In the
    plane of n and w_o, 2 angle(n, h) is the angle between w_j and the mirror direction q, so that this is their lobe.
    Beside the plane it is narrower, the more so the more w_o grazes the surface, as highlights of rough surfaces are.

    Args:
        points: metres.
        normals, to_camera: unit vectors.
        alpha: widths of GGX, positive.
        lights: V_j are their visibility bits.
        gaussian: as above; if not, GGX.
    """
    if points.device.type != "cpu":
        return gather_reflections_in_torch(points, normals, to_camera, alpha, lights, gaussian)
    inputs = (points, normals, to_camera, alpha, lights.positions_m, lights.intensities)
    arrays = [tensor.detach().contiguous().numpy() for tensor in inputs]
    channels, seen = lights.intensities.shape[1], lights.bits_for(len(points))
    value, slope = torch.empty(len(points), channels), torch.empty(len(points), channels, 4)
    reflection_kernels.gather_reflections(*arrays, seen, gaussian, value.numpy(), slope.numpy())
    variable = torch.cat([normals, alpha[:, None]], -1)
    # First order about where it was evaluated: the value is exact, and so is the gradient.
    return value + (slope * (variable - variable.detach())[:, None]).sum(-1)


def gather_reflections_reference(
    points: Tensor, normals: Tensor, to_camera: Tensor, alpha: Tensor, light_positions: Tensor, intensities: Tensor,
    seen: Tensor | None = None, gaussian: bool = False,
) -> Tensor:  # fmt: skip
    """Slow twin of `gather_reflections` in plain torch, its oracle. `seen` is a mask [lights, points]."""
    offset = light_positions - points[:, None]
    distance2 = offset.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
    to_light = offset / distance2.sqrt()
    half = torch.nn.functional.normalize(to_light + to_camera[:, None], dim=-1)
    cos_i = (normals[:, None] * to_light).sum(-1)
    cos_o = (normals * to_camera).sum(-1)[:, None].expand_as(cos_i)
    cos_h = (normals[:, None] * half).sum(-1)
    cos_d = (to_camera[:, None] * half).sum(-1)
    a2 = alpha.square()[:, None]
    if gaussian:
        angle = angle_between(normals[:, None], half)
        d = LOBE_SCALE / alpha[:, None] * torch.exp(-angle.square() / a2)
    else:
        d = a2 / (math.pi * (cos_h.square() * (a2 - 1) + 1).square())
    lit = (cos_i > SMALLEST_COSINE) & (cos_o > SMALLEST_COSINE)
    lit = lit if seen is None else lit & seen.T
    ci, co = (torch.where(lit, cosine, torch.ones_like(cosine)) for cosine in (cos_i, cos_o))
    masked = 0.5 / (ci * (a2 + (1 - a2) * co.square()).sqrt() + co * (a2 + (1 - a2) * ci.square()).sqrt())
    fresnel = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * (1 - cos_d) ** 5
    return (torch.where(lit, d * masked * fresnel * ci, torch.zeros_like(ci)) / distance2[..., 0]) @ intensities


def gather_reflections_in_torch(
    points: Tensor, normals: Tensor, to_camera: Tensor, alpha: Tensor, lights: PointLights, gaussian: bool = False
) -> Tensor:
    """`gather_reflections` on any device, without the kernel."""

    def reflections(points: Tensor, normals: Tensor, to_camera: Tensor, alpha: Tensor, seen: Tensor | None) -> Tensor:
        sources = (lights.positions_m, lights.intensities)
        return gather_reflections_reference(
            points, normals, to_camera, alpha, *sources, None if seen is None else seen.T, gaussian
        )

    mask = unpacked(lights.bits_for(len(points)), len(points), points.device)
    return sum_in_pieces(reflections, (points.detach(), normals, to_camera.detach(), alpha, mask), len(lights))
