"""Matte reflection of point lights that a surface point sees.

Lambert's, and what of it a coat keeps back. A dielectric coat mirrors the more light, and lets the less of it pass, the
more it grazes the surface. By reciprocity this is so on the way in and on the way out (Kelemen and Szirmay-Kalos 2001):
light is multiplied by a transmittance for its own angle, and by one for the camera's. Here it is 1 - s (1 - cosine)^p,
with a share s that is learned. Rough matte surfaces, brighter where light grazes them, have a negative one.
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
from pipeline.lighting.zonal_kernels import FAST_MATH, SMALLEST_DISTANCE2_M2

GRAZING_POWER = 2.5
"""Power of what a coat keeps back. Of what passes straight down, a dielectric of index 1.5 and GGX of width 0.3 lets
0.71, 0.81, 0.93 and 0.99 pass at cosines of 0.05, 0.2, 0.5 and 0.9; with s = 0.33 this has 0.71, 0.81, 0.94 and 1.00.
Schlick's fifth power, that of a smooth coat, falls too late."""


def coat_passes(cosine: Float[Tensor, "*n"], share: Float[Tensor, ""]) -> Float[Tensor, "*n"]:
    """Transmittance of a coat for light at an angle, 1 for light from straight above.

    Args:
        cosine: of the angle to the normal, in [0, 1].
        share: of grazing light that the coat keeps back, at most 1.
    """
    return 1 - share * (1 - cosine) ** GRAZING_POWER


def arriving_vectors(
    points: Float[Tensor, "points 3"],
    normals: Float[Tensor, "points 3"],
    lights: PointLights,
) -> Float[Tensor, "points channels 3"]:
    """Gather vector irradiance.

    Sum of I_j / d_j^2 w_j over the lights seen and above the horizon of the normal.

    Its product with the normal is the irradiance sum_j V_j I_j / d_j^2 max(0, n . w_j), and it is also that sum's
    derivative with respect to n. No gradient flows through it.
    """
    tensors = [tensor.detach() for tensor in (points, normals)]
    if points.device.type != "cpu":
        return arriving_vectors_in_torch(*tensors, lights)
    out = torch.empty(len(points), lights.intensities.shape[1], 3)
    _arriving_vectors(*_arrays(points, normals, lights), out.numpy())
    return out


def arriving_vectors_in_torch(points: Tensor, normals: Tensor, lights: PointLights) -> Tensor:
    """`arriving_vectors` on any device, without the kernel."""

    def vectors(points: Tensor, normals: Tensor, seen: Tensor | None) -> Tensor:
        offset = lights.positions_m - points[:, None]
        distance2 = offset.square().sum(-1).clamp_min(float(SMALLEST_DISTANCE2_M2))
        lit = (offset * normals[:, None]).sum(-1) > 0
        weight = 1 / (distance2 * distance2.sqrt()) * (lit if seen is None else lit & seen)
        return torch.einsum("pn,nc,pnd->pcd", weight, lights.intensities, offset)

    mask = unpacked(lights.bits_for(len(points)), len(points), points.device)
    return sum_in_pieces(vectors, (points, normals, mask), len(lights))


def grazing_irradiance(
    points: Float[Tensor, "points 3"],
    normals: Float[Tensor, "points 3"],
    lights: PointLights,
) -> Float[Tensor, "points channels"]:
    """Gather the irradiance that a coat keeps back if its share is 1.

    sum_j V_j I_j / d_j^2 max(0, n . w_j) (1 - n . w_j)^p. Differentiable in `normals`.
    """
    if points.device.type != "cpu":
        return grazing_irradiance_in_torch(points, normals, lights)
    value = torch.empty(len(points), lights.intensities.shape[1])
    slope = torch.empty(*value.shape, 3)
    _grazing_irradiance(*_arrays(points, normals, lights), value.numpy(), slope.numpy())
    # First order about where it was evaluated: the value is exact, and so is the gradient.
    return value + (slope * (normals - normals.detach())[:, None]).sum(-1)


def grazing_irradiance_in_torch(points: Tensor, normals: Tensor, lights: PointLights) -> Tensor:
    """`grazing_irradiance` on any device, without the kernel: its oracle."""

    def kept(points: Tensor, normals: Tensor, seen: Tensor | None) -> Tensor:
        offset = lights.positions_m - points[:, None]
        distance2 = offset.square().sum(-1).clamp_min(float(SMALLEST_DISTANCE2_M2))
        cosine = ((offset * normals[:, None]).sum(-1) / distance2.sqrt()).clamp(0, 1)
        weight = cosine * (1 - cosine) ** GRAZING_POWER / distance2
        return (weight if seen is None else weight * seen) @ lights.intensities

    mask = unpacked(lights.bits_for(len(points)), len(points), points.device)
    return sum_in_pieces(kept, (points.detach(), normals, mask), len(lights))


def _arrays(points: Tensor, normals: Tensor, lights: PointLights) -> list[np.ndarray]:
    tensors = (points, normals, lights.positions_m, lights.intensities)
    return [*(tensor.detach().contiguous().numpy() for tensor in tensors), lights.bits_for(len(points))]


ONE = np.float32(1.0)
POWER = np.float32(GRAZING_POWER)


@numba.njit(parallel=True, cache=True, fastmath=FAST_MATH)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _arriving_vectors(points, normals, lights, intensities, seen, out):
    channels = intensities.shape[1]
    for p in numba.prange(points.shape[0]):
        out[p] = 0
        for j in range(lights.shape[0]):
            if not seen[j, p >> 3] & (128 >> (p & 7)):
                continue
            x, y, z = lights[j, 0] - points[p, 0], lights[j, 1] - points[p, 1], lights[j, 2] - points[p, 2]
            if x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2] <= 0:
                continue
            distance2 = max(x * x + y * y + z * z, SMALLEST_DISTANCE2_M2)
            weight = ONE / (distance2 * math.sqrt(distance2))
            for c in range(channels):
                out[p, c, 0] += intensities[j, c] * weight * x
                out[p, c, 1] += intensities[j, c] * weight * y
                out[p, c, 2] += intensities[j, c] * weight * z


@numba.njit(parallel=True, cache=True, fastmath=FAST_MATH)
@no_type_check
def _grazing_irradiance(points, normals, lights, intensities, seen, value, slope):
    channels = intensities.shape[1]
    for p in numba.prange(points.shape[0]):
        value[p] = 0
        slope[p] = 0
        for j in range(lights.shape[0]):
            if not seen[j, p >> 3] & (128 >> (p & 7)):
                continue
            x, y, z = lights[j, 0] - points[p, 0], lights[j, 1] - points[p, 1], lights[j, 2] - points[p, 2]
            along = x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2]
            if along <= 0:
                continue
            inverse2 = ONE / max(x * x + y * y + z * z, SMALLEST_DISTANCE2_M2)
            inverse = math.sqrt(inverse2)
            cosine = min(along * inverse, ONE)
            rest = ONE - cosine
            power = rest * math.sqrt(rest)  # (1 - cosine)^(p - 1), p = GRAZING_POWER
            kept, turned = cosine * power * rest, power * (rest - POWER * cosine) * inverse
            for c in range(channels):
                light = intensities[j, c] * inverse2
                value[p, c] += light * kept
                slope[p, c, 0] += light * turned * x
                slope[p, c, 1] += light * turned * y
                slope[p, c, 2] += light * turned * z
