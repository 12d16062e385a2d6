"""Light of point sources by Legendre degree along a Gaussian's axes (RFGCA 7-9).

A transfer lobe that is zonal about axis a, with coefficients z_l, reflects from a light of direction w

    sum_l z_l sum_m Y_lm(a) Y_lm(w) L = L sum_l z_l (2 l + 1) / (4 pi) P_l(a . w)        (addition theorem)

so no spherical harmonics are needed for point lights. `gather_light` returns, for every point, axis and degree, the
sum over lights of L (2 l + 1) / (4 pi) P_l(a . w) with L = I / d^2 (near field); the shading is a dot product with z.
Degree 8 is the papers' choice. The constant sqrt(4 pi / (2 l + 1)) of the usual rotation is absorbed into z.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numba
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.device_sums import sum_in_pieces, unpacked
from pipeline.lighting.point_lights import PointLights

FAST_MATH = {"contract", "nsz", "arcp"}
"""Not "reassoc": numba optimises what it stores once more than what it has just compiled, and sums in another order
then give other bits. A training that is stopped before its kernels are stored could not go on to the same result."""

DEGREES = 9
"""Degrees 0..8 (RFGCA section 3.2.1): as many as there ever are."""

NORMALISATION = np.array([(2 * degree + 1) / (4 * math.pi) for degree in range(DEGREES)], dtype=np.float32)
"""(2 l + 1) / (4 pi), from the addition theorem."""

SMALLEST_DISTANCE2_M2 = np.float32(1e-8)
"""Lights closer than 0.1 mm are taken at 0.1 mm: no LED is nearer, and I / d^2 stays finite in float32."""


def clamped_cosine_coefficients() -> Float[np.ndarray, "degrees"]:
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
        _gather_forward(*(tensor.numpy() for tensor in inputs), seen, NORMALISATION[:degrees], out.numpy())
        return out

    @staticmethod
    def backward(ctx, grad_out):
        points, axes, light_positions, intensities = ctx.saved_tensors
        grad_points, grad_axes = torch.empty_like(points), torch.empty_like(axes)
        arrays = [tensor.numpy() for tensor in (points, axes, light_positions, intensities, grad_out.contiguous())]
        normalisation = NORMALISATION[: grad_out.shape[2]]
        _gather_backward(*arrays, ctx.seen, normalisation, grad_points.numpy(), grad_axes.numpy())
        return grad_points, grad_axes, None, None, None, None


@numba.njit(parallel=True, cache=True, fastmath=FAST_MATH)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _gather_forward(points, axes, lights, intensities, seen, normalisation, out):
    channels, degrees = intensities.shape[1], normalisation.shape[0]
    for p in numba.prange(points.shape[0]):
        total = np.zeros((3, degrees, channels), np.float32)
        for n in range(lights.shape[0]):
            if not seen[n, p >> 3] & (128 >> (p & 7)):
                continue
            dx, dy, dz = lights[n, 0] - points[p, 0], lights[n, 1] - points[p, 1], lights[n, 2] - points[p, 2]
            distance2 = max(dx * dx + dy * dy + dz * dz, SMALLEST_DISTANCE2_M2)
            inverse = np.float32(1.0) / np.sqrt(distance2)
            for a in range(3):
                x = (axes[p, 0, a] * dx + axes[p, 1, a] * dy + axes[p, 2, a] * dz) * inverse
                before, here = np.float32(1.0), x
                for c in range(channels):
                    light = intensities[n, c] / distance2
                    total[a, 0, c] += light
                    total[a, 1, c] += light * x
                for degree in range(2, degrees):
                    after = (np.float32(2 * degree - 1) * x * here - np.float32(degree - 1) * before) * (
                        np.float32(1.0) / np.float32(degree)
                    )
                    before, here = here, after
                    for c in range(channels):
                        total[a, degree, c] += intensities[n, c] / distance2 * after
        for a in range(3):
            for degree in range(degrees):
                for c in range(channels):
                    out[p, a, degree, c] = total[a, degree, c] * normalisation[degree]


@numba.njit(parallel=True, cache=True, fastmath=FAST_MATH)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _gather_backward(points, axes, lights, intensities, grad_out, seen, normalisation, grad_points, grad_axes):
    channels, degrees = intensities.shape[1], normalisation.shape[0]
    for p in numba.prange(points.shape[0]):
        to_point = np.zeros(3, np.float32)
        to_axes = np.zeros((3, 3), np.float32)
        w, grad_w = np.zeros(3, np.float32), np.zeros(3, np.float32)
        for n in range(lights.shape[0]):
            if not seen[n, p >> 3] & (128 >> (p & 7)):
                continue
            for i in range(3):
                w[i] = lights[n, i] - points[p, i]
                grad_w[i] = np.float32(0.0)
            distance2 = max(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], SMALLEST_DISTANCE2_M2)
            inverse = np.float32(1.0) / np.sqrt(distance2)
            for i in range(3):
                w[i] *= inverse
            along = np.float32(0.0)  # derivative with respect to log(1 / d^2)
            for a in range(3):
                x = axes[p, 0, a] * w[0] + axes[p, 1, a] * w[1] + axes[p, 2, a] * w[2]
                slope = np.float32(0.0)
                before, here = np.float32(1.0), x
                slope_before, slope_here = np.float32(0.0), np.float32(1.0)
                for degree in range(degrees):
                    if degree == 0:
                        value, change = before, slope_before
                    elif degree == 1:
                        value, change = here, slope_here
                    else:
                        inverse_degree = np.float32(1.0) / np.float32(degree)
                        k1, k2 = np.float32(2 * degree - 1), np.float32(degree - 1)
                        value = (k1 * x * here - k2 * before) * inverse_degree
                        change = (k1 * (here + x * slope_here) - k2 * slope_before) * inverse_degree
                        before, here = here, value
                        slope_before, slope_here = slope_here, change
                    weighted = np.float32(0.0)
                    for c in range(channels):
                        weighted += grad_out[p, a, degree, c] * intensities[n, c]
                    weighted *= normalisation[degree] / distance2
                    slope += weighted * change
                    along += weighted * value
                for i in range(3):
                    to_axes[i, a] += slope * w[i]
                    grad_w[i] += slope * axes[p, i, a]
            radial = w[0] * grad_w[0] + w[1] * grad_w[1] + w[2] * grad_w[2]
            for i in range(3):
                to_point[i] += inverse * (np.float32(2.0) * along * w[i] - (grad_w[i] - radial * w[i]))
        for i in range(3):
            grad_points[p, i] = to_point[i]
            for a in range(3):
                grad_axes[p, i, a] = to_axes[i, a]
