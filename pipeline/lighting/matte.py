"""Matte reflection of point lights that a surface point sees.

Lambert's, and what of it a coat keeps back. A dielectric coat mirrors the more light, and lets the less of it pass, the
more it grazes the surface. By reciprocity this is so on the way in and on the way out (Kelemen and Szirmay-Kalos 2001):
light is multiplied by a transmittance for its own angle, and by one for the camera's. Here it is 1 - s (1 - cosine)^p,
with a share s that is learned. Rough matte surfaces, brighter where light grazes them, have a negative one.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.device_sums import sum_in_pieces, unpacked
from pipeline.lighting.matte_kernels import GRAZING_POWER, add_arriving_vectors, add_grazing_irradiance
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2


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
    add_arriving_vectors(*_arrays(points, normals, lights), out.numpy())
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
    add_grazing_irradiance(*_arrays(points, normals, lights), value.numpy(), slope.numpy())
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
