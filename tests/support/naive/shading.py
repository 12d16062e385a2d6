"""Highlights, lobes, falloff of light and sRGB, as they are usually written."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pipeline.lighting.lobes import LOBE_CONSTANT

GUARD_M2 = 1e-12
"""Added to squared distances, so that nothing is divided by zero."""


def naive_distribution(to_camera: Tensor, to_light: Tensor, alpha: float) -> Tensor:
    """GGX about +z with cos^2 (alpha^2 - 1) + 1, which at a highlight is one minus nearly one."""
    half = torch.nn.functional.normalize(to_light + to_camera, dim=-1)
    a2 = torch.tensor(alpha) ** 2
    return a2 / (math.pi * (half[..., 2] ** 2 * (a2 - 1) + 1) ** 2)


def naive_lobe_slope(p: tuple[float, ...], q: tuple[float, ...], sigma: float) -> Tensor:
    """Derivative by p of the papers' lobe with the angle as acos of the dot product."""
    at = torch.tensor(p, requires_grad=True)
    lobe = LOBE_CONSTANT / sigma * torch.exp(-0.5 * (torch.acos((at * torch.tensor(q)).sum()) / sigma).square())
    return torch.autograd.grad(lobe, at)[0]


def naive_falloff(distance_m: Tensor) -> Tensor:
    """1 / d^2 of a light of intensity one, guarded."""
    return 1 / (distance_m.square() + GUARD_M2)


def naive_srgb_slope(linear: float) -> float:
    """Slope of the transfer function's power alone, without the straight line below it."""
    at = torch.tensor(linear, requires_grad=True)
    (1.055 * at ** (1 / 2.4) - 0.055).backward()
    return at.grad.item()
