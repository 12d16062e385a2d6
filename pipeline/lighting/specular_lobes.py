"""Specular light of point sources through a spherical Gaussian (RFGCA 12-13).

Summed over all lights.

A kernel, because pixels times lights times the dozen operations of a lobe is the largest tensor of a training step if
written in torch. Its slow twin is `gather_specular_reference`.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.device_sums import sum_in_pieces
from pipeline.lighting.lobe_kernels import gather_lobes
from pipeline.lighting.lobes import Lobe, angular_gaussian, unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2


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
    inputs = (points, lobe_centers, sigma, lights.positions_m, lights.intensities)
    arrays = [tensor.detach().contiguous().numpy() for tensor in inputs]
    channels = lights.intensities.shape[1]
    value, slope = torch.empty(len(points), channels), torch.empty(len(points), channels, 4)
    gather_lobes(*arrays, value.numpy(), slope.numpy())
    variable = torch.cat([lobe_centers, sigma[:, None]], -1)
    # First order about where it was evaluated: the value is exact, and so is the gradient.
    return value + (slope * (variable - variable.detach())[:, None]).sum(-1)


def gather_specular_in_torch(
    points: Tensor, lobe_centers: Tensor, sigma: Tensor, lights: PointLights, lobe: Lobe = angular_gaussian
) -> Tensor:
    """`gather_specular` on any device, without the kernel."""
    return sum_in_pieces(
        lambda *piece: gather_specular_reference(*piece, lights.positions_m, lights.intensities, lobe),
        (points, lobe_centers, sigma),
        len(lights),
    )
