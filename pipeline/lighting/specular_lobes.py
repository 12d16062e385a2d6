"""Specular light of point sources through a spherical Gaussian (RFGCA 12-13).

Summed over all lights.

A kernel, because pixels times lights times the dozen operations of a lobe is the largest tensor of a training step if
written in torch. Its slow twin is `gather_specular_reference`.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numba
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.device_sums import sum_in_pieces
from pipeline.lighting.lobes import LOBE_CONSTANT, SMALLEST_SINE2, Lobe, angular_gaussian, unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2

REACH_SIGMAS = 6.0
"""Light further than this from the lobe's centre is skipped: exp(-6^2 / 2) = 1.5e-8 is below float32's resolution of
the peak."""


def gather_specular_reference(
    points: Tensor, lobe_centers: Tensor, sigma: Tensor, light_positions: Tensor, intensities: Tensor,
    lobe: Lobe = angular_gaussian,
) -> Tensor:  # fmt: skip
    """Slow twin of `gather_specular`, any float type: its oracle, forward and backward."""
    to_light = light_positions - points[:, None]
    distance2 = to_light.square().sum(-1).clamp_min(float(SMALLEST_DISTANCE2_M2))
    return (lobe(unit(to_light), lobe_centers[:, None], sigma[:, None]) / distance2) @ intensities


def gather_specular(
    points: Float[Tensor, "pixels 3"],
    lobe_centers: Float[Tensor, "pixels 3"],
    sigma: Float[Tensor, " pixels"],
    lights: PointLights,
    lobe: Lobe = angular_gaussian,
) -> Float[Tensor, "pixels channels"]:
    """Gather specular light of point sources, sum_j I_j / d_j^2 G(w_j; q, sigma).

    Differentiable in `lobe_centers` and `sigma` (not in `points`); the angular lobe by a kernel on the CPU.

    Args:
        points: metres.
        lobe_centers: unit mirror directions q.
        sigma: lobe widths, radians, positive.
        lights: all of them, seen or not.
        lobe: G.
    """
    if points.requires_grad:
        raise ValueError(
            "gather_specular: expected points without gradient (detach them), found points that require it"
        )
    if points.device.type != "cpu" or lobe is not angular_gaussian:
        return gather_specular_in_torch(points, lobe_centers, sigma, lights, lobe)
    return _GatherSpecular.apply(points, lobe_centers, sigma, lights.positions_m, lights.intensities)


def gather_specular_in_torch(
    points: Tensor, lobe_centers: Tensor, sigma: Tensor, lights: PointLights, lobe: Lobe = angular_gaussian
) -> Tensor:
    """`gather_specular` on any device, without the kernel."""
    return sum_in_pieces(
        lambda *piece: gather_specular_reference(*piece, lights.positions_m, lights.intensities, lobe),
        (points, lobe_centers, sigma),
        len(lights),
    )


class _GatherSpecular(torch.autograd.Function):
    @staticmethod
    def forward(ctx, *inputs):
        inputs = [tensor.detach().contiguous() for tensor in inputs]
        ctx.save_for_backward(*inputs)
        out = torch.empty(len(inputs[0]), inputs[-1].shape[1])
        _specular_forward(*(tensor.numpy() for tensor in inputs), out.numpy())
        return out

    @staticmethod
    def backward(ctx, grad_out):
        inputs = ctx.saved_tensors
        grad_centers, grad_sigma = torch.empty_like(inputs[1]), torch.empty_like(inputs[2])
        arrays = [tensor.numpy() for tensor in (*inputs, grad_out.contiguous())]
        _specular_backward(*arrays, grad_centers.numpy(), grad_sigma.numpy())
        return None, grad_centers, grad_sigma, None, None


CONSTANT, TINY_SINE2, REACH = np.float32(LOBE_CONSTANT), np.float32(SMALLEST_SINE2), np.float32(REACH_SIGMAS)
NO_LIMIT = np.float32(-2.0)
"""A cosine that no direction falls short of: the lobe reaches around the whole sphere."""


@numba.njit(parallel=True, cache=True, fastmath={"contract", "nsz"})
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _specular_forward(points, centers, sigmas, lights, intensities, out):
    for p in numba.prange(points.shape[0]):
        qx, qy, qz, sigma = centers[p, 0], centers[p, 1], centers[p, 2], sigmas[p]
        limit = math.cos(REACH * sigma) if REACH * sigma < math.pi else NO_LIMIT
        out[p] = 0
        for n in range(lights.shape[0]):
            x, y, z = lights[n, 0] - points[p, 0], lights[n, 1] - points[p, 1], lights[n, 2] - points[p, 2]
            distance2 = max(x * x + y * y + z * z, SMALLEST_DISTANCE2_M2)
            inverse = np.float32(1.0) / math.sqrt(distance2)
            x, y, z = x * inverse, y * inverse, z * inverse
            cosine = x * qx + y * qy + z * qz
            if cosine < limit:
                continue
            cx, cy, cz = y * qz - z * qy, z * qx - x * qz, x * qy - y * qx
            angle = math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz + TINY_SINE2), cosine) / sigma
            lobe = CONSTANT / sigma * math.exp(np.float32(-0.5) * angle * angle) / distance2
            for c in range(intensities.shape[1]):
                out[p, c] += lobe * intensities[n, c]


@numba.njit(parallel=True, cache=True, fastmath={"contract", "nsz"})
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _specular_backward(points, centers, sigmas, lights, intensities, grad_out, grad_centers, grad_sigma):
    for p in numba.prange(points.shape[0]):
        qx, qy, qz, sigma = centers[p, 0], centers[p, 1], centers[p, 2], sigmas[p]
        limit = math.cos(REACH * sigma) if REACH * sigma < math.pi else NO_LIMIT
        gx = gy = gz = gs = np.float32(0.0)
        for n in range(lights.shape[0]):
            x, y, z = lights[n, 0] - points[p, 0], lights[n, 1] - points[p, 1], lights[n, 2] - points[p, 2]
            distance2 = max(x * x + y * y + z * z, SMALLEST_DISTANCE2_M2)
            inverse = np.float32(1.0) / math.sqrt(distance2)
            x, y, z = x * inverse, y * inverse, z * inverse
            cosine = x * qx + y * qy + z * qz
            if cosine < limit:
                continue
            cx, cy, cz = y * qz - z * qy, z * qx - x * qz, x * qy - y * qx
            sine = math.sqrt(cx * cx + cy * cy + cz * cz + TINY_SINE2)
            angle = math.atan2(sine, cosine)
            scaled = angle / sigma
            weight = np.float32(0.0)
            for c in range(intensities.shape[1]):
                weight += grad_out[p, c] * intensities[n, c]
            weight *= CONSTANT / sigma * math.exp(np.float32(-0.5) * scaled * scaled) / distance2
            gs += weight * (scaled * scaled - np.float32(1.0)) / sigma
            # d angle = (cosine d sine - sine d cosine) / (sine^2 + cosine^2); d sine = (q - p cosine) . dq / sine
            slope = -weight * scaled / sigma / (sine * sine + cosine * cosine)
            along_q, along_p = slope * cosine / sine, slope * (cosine * cosine / sine + sine)
            gx += along_q * qx - along_p * x
            gy += along_q * qy - along_p * y
            gz += along_q * qz - along_p * z
        grad_centers[p, 0], grad_centers[p, 1], grad_centers[p, 2] = gx, gy, gz
        grad_sigma[p] = gs
