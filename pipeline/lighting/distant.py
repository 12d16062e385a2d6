"""Distant lights: one direction each, whatever the place.

A frame's light is 81 numbers for all texels.

`gather_distant` is `pipeline.lighting.zonal.gather_light` without distances, by the addition theorem read backwards
(`pipeline.lighting.environment_sh`): its cost does not depend on the number of lights. Its slow twin is
`pipeline.lighting.environment_sh.gather_environment`.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.distant_kernels import distant_backward, distant_forward
from pipeline.lighting.environment_sh import COEFFICIENTS, gather_environment, spherical_harmonics
from pipeline.lighting.lobes import unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal_kernels import DEGREES, SMALLEST_DISTANCE2_M2

LIGHTS_THAT_PAY = 7
"""From so many lights on, harmonics cost less than a sum over the lights: 29 ms forward and back for 16,000 points
against 4 ms a light, on two cores."""

FAR_M = 1e5
"""Distance at which a point light stands for a distant one: over a subject of 2 m, falloff and direction change by
2e-5."""


def _seen_from(center: Tensor, lights: PointLights) -> tuple[Tensor, Tensor]:
    """Unit directions to the lights, and their irradiances I / d^2."""
    offset = lights.positions_m - center
    distance2 = offset.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
    return unit(offset), lights.intensities / distance2


def far_lights(center: Float[Tensor, "3"], lights: PointLights) -> PointLights:
    """Move lights away from `center` to `FAR_M`, as bright as they were there."""
    toward, irradiances = _seen_from(center, lights)
    return PointLights(center + FAR_M * toward, FAR_M**2 * irradiances, lights.visibility_bits)


def light_harmonics(
    center: Float[Tensor, "3"], turn: Float[Tensor, "3 3"], lights: PointLights
) -> Float[Tensor, "81 channels"]:
    """Project lights on harmonics, L_lm = sum_j I_j / d_j^2 Y_lm(w_j), as seen from `center`.

    Args:
        turn: turns the directions w_j.
    """
    toward, irradiances = _seen_from(center, lights)
    return spherical_harmonics(toward @ turn.T).T @ irradiances


@torch.no_grad()
def gather_harmonics(
    points: Float[Tensor, "points 3"], turn: Float[Tensor, "*points 3 3"], lights: PointLights
) -> Float[Tensor, "points 81 channels"]:
    """Project lights on harmonics at every point, sum_j I_j / d_j^2 Y_lm(w_j).

    The directions w_j are turned by `turn`, one for all points or one for each.
    """
    out = points.new_zeros(len(points), COEFFICIENTS, lights.intensities.shape[1])
    for position, intensity in zip(lights.positions_m, lights.intensities, strict=True):
        offset = position - points
        distance2 = offset.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
        turned = unit(offset) @ turn.T if turn.ndim == 2 else (turn @ unit(offset)[..., None])[..., 0]
        harmonics = spherical_harmonics(turned) / distance2
        out += harmonics[..., None] * intensity
    return out


@torch.no_grad()
def arriving_light(points: Float[Tensor, "points 3"], lights: PointLights) -> Float[Tensor, "points channels"]:
    """Sum I / d^2 over all lights, seen or not."""
    distance2 = torch.cdist(points, lights.positions_m).square().clamp_min(float(SMALLEST_DISTANCE2_M2))
    return (1 / distance2) @ lights.intensities


def gather_distant(
    axes: Float[Tensor, "points 3 3"], light: Float[Tensor, "coefficients channels"]
) -> Float[Tensor, "points 3 degrees channels"]:
    """Incident light per axis and degree, differentiable in `axes`; by a kernel on the CPU.

    Args:
        axes: rotation matrices; column a is the axis of lobe a.
        light: L_lm of as many degrees as are asked for, see `light_harmonics`.
    """
    return gather_environment(axes, light) if axes.device.type != "cpu" else _GatherDistant.apply(axes, light)


class _GatherDistant(torch.autograd.Function):
    @staticmethod
    def forward(ctx, axes, light):
        axes, light = axes.detach().contiguous(), light.detach().contiguous()
        ctx.save_for_backward(axes, light)
        out = torch.empty(len(axes), 3, math.isqrt(len(light)), light.shape[1])
        distant_forward(axes.numpy(), light.numpy(), STEP, BACK, DIAGONAL, out.numpy())
        return out

    @staticmethod
    def backward(ctx, grad_out):
        axes, light = ctx.saved_tensors
        grad = torch.empty_like(axes)
        arrays = [tensor.numpy() for tensor in (axes, light, grad_out.contiguous())]
        distant_backward(*arrays, STEP, BACK, DIAGONAL, grad.numpy())
        return grad, None


def _recursion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Factors of `spherical_harmonics`' recursion: forwards and back in the degree, and on the diagonal."""
    step, back = np.zeros((2, DEGREES, DEGREES), np.float32)
    diagonal = np.zeros(DEGREES, np.float32)
    here = math.sqrt(1 / (4 * math.pi))
    for m in range(DEGREES):
        diagonal[m] = here * (math.sqrt(2) if m else 1)
        here *= math.sqrt((2 * m + 3) / (2 * m + 2))
        for degree in range(m, DEGREES):
            step[m, degree] = math.sqrt((4 * (degree + 1) ** 2 - 1) / ((degree + 1) ** 2 - m * m))
            if degree > m:
                back[m, degree] = math.sqrt((degree * degree - m * m) / (4 * degree * degree - 1))
    return step, back, diagonal


STEP, BACK, DIAGONAL = _recursion()
if len(STEP) ** 2 != COEFFICIENTS:
    raise AssertionError("degrees of the recursion and of the harmonics differ")
