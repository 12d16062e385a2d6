"""Light of point sources by Legendre degree along a Gaussian's axes (RFGCA 7-9).

A transfer lobe that is zonal about axis a, with coefficients z_l, reflects from a light of direction w

    sum_l z_l sum_m Y_lm(a) Y_lm(w) L = L sum_l z_l (2 l + 1) / (4 pi) P_l(a . w)        (addition theorem)

so no spherical harmonics are needed for point lights. `gather_light` returns, for every point, axis and degree, the
sum over lights of L (2 l + 1) / (4 pi) P_l(a . w) with L = I / d^2 (near field); the shading is a dot product with z.
Degree 8 is the papers' choice. The constant sqrt(4 pi / (2 l + 1)) of the usual rotation is absorbed into z.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.device_sums import sum_in_pieces, unpacked
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal_kernels import DEGREES, SMALLEST_DISTANCE2_M2, gather_backward, gather_forward

NORMALISATION = np.array([(2 * degree + 1) / (4 * math.pi) for degree in range(DEGREES)], dtype=np.float32)
"""(2 l + 1) / (4 pi), from the addition theorem."""


def clamped_cosine_coefficients() -> Float[np.ndarray, " degrees"]:
    """Zonal coefficients of max(0, cos) / pi, the Lambertian lobe. 2 pi integral_0^1 t P_l(t) dt / pi (Funk-Hecke)."""
    nodes, weights = np.polynomial.legendre.leggauss(DEGREES + 1)  # exact for polynomials to degree 2 * 10 - 1
    t, weight = (nodes + 1) / 2, weights / 2
    return 2 * np.stack([np.sum(weight * t * np.polynomial.Legendre.basis(n)(t)) for n in range(DEGREES)])


def gather_light_reference(
    points: Tensor,
    axes: Tensor,
    light_positions: Tensor,
    intensities: Tensor,
    seen: Tensor | None = None,
    degrees: int = DEGREES,
) -> Tensor:
    """Slow twin of `gather_light` in plain torch: its oracle, forward and backward.

    Any float type; `seen` is a mask [points, lights].
    """
    to_light = light_positions - points[:, None]
    distance2 = to_light.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
    cosine = torch.einsum("pda,pnd->pna", axes, to_light / distance2.sqrt())
    legendre = [torch.ones_like(cosine), cosine]
    for degree in range(2, degrees):
        legendre.append(((2 * degree - 1) * cosine * legendre[-1] - (degree - 1) * legendre[-2]) / degree)
    weighted = torch.stack(legendre, -1) * torch.as_tensor(
        NORMALISATION[:degrees], dtype=points.dtype, device=points.device
    )
    arriving = intensities / distance2
    return torch.einsum("pnal,pnc->palc", weighted, arriving if seen is None else arriving * seen[..., None])


def gather_light(
    points: Float[Tensor, "points 3"],
    axes: Float[Tensor, "points 3 3"],
    lights: PointLights,
    degrees: int = DEGREES,
) -> Float[Tensor, "points 3 {degrees} _"]:
    """Gather incident light per axis and degree, differentiable in `points` and `axes`.

    By a kernel on the CPU.

    Args:
        points: positions in the world, metres.
        axes: rotation matrices; column a is the axis of lobe a.
        lights: with as many channels as the result.
        degrees: 0, 1 and so on to one less than this, at least 2.
    """
    if points.device.type != "cpu":
        return gather_light_in_torch(points, axes, lights, degrees)
    seen = lights.bits_for(len(points))
    return _GatherLight.apply(points, axes, lights.positions_m, lights.intensities, seen, degrees)


def gather_light_in_torch(points: Tensor, axes: Tensor, lights: PointLights, degrees: int = DEGREES) -> Tensor:
    """`gather_light` on any device, without the kernel."""
    sources = lights.positions_m, lights.intensities
    mask = unpacked(lights.bits_for(len(points)), len(points), points.device)
    return sum_in_pieces(
        lambda *piece: gather_light_reference(*piece[:2], *sources, piece[2], degrees),
        (points, axes, mask),
        len(lights),
    )


class _GatherLight(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, axes, light_positions, intensities, seen, degrees):
        inputs = [tensor.detach().contiguous() for tensor in (points, axes, light_positions, intensities)]
        ctx.save_for_backward(*inputs)
        ctx.seen = seen
        out = torch.empty(len(points), 3, degrees, intensities.shape[1])
        gather_forward(*(tensor.numpy() for tensor in inputs), seen, NORMALISATION[:degrees], out.numpy())
        return out

    @staticmethod
    def backward(ctx, grad_out):
        points, axes, light_positions, intensities = ctx.saved_tensors
        grad_points, grad_axes = torch.empty_like(points), torch.empty_like(axes)
        arrays = [tensor.numpy() for tensor in (points, axes, light_positions, intensities, grad_out.contiguous())]
        normalisation = NORMALISATION[: grad_out.shape[2]]
        gather_backward(*arrays, ctx.seen, normalisation, grad_points.numpy(), grad_axes.numpy())
        return grad_points, grad_axes, None, None, None, None
