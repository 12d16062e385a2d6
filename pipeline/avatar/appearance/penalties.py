"""Penalties on parameters: bounds, and values below zero (RFGCA Appendix B)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

ROUGHNESS_BOUNDS = (0.01, 0.25)
"""Bounds of the lobe width in radians (RFGCA Appendix B)."""

HALFWAY_BOUNDS = (0.01, 1.0)
"""Bounds of the lobe about half vectors, radians: sqrt(2) of the width of GGX, 0.4 for skin."""

GGX_WIDTH_BOUNDS = (0.05, 1.0)
"""Bounds of the width of GGX: at 0.05 a highlight is as wide as a lamp of the stage, at 1 it is matte."""

SMALLEST_VALUE = 1e-30
"""Values are bounded as if they were no smaller: slopes, 2 log(low / v) / v, then fit into float32."""


def outside(value: Tensor, low: float, high: float) -> Float[Tensor, ""]:
    """Mean squared excess over bounds, in units of log: zero inside, finite slope everywhere.

    The paper's lower branch, 1 / max(v, 1e-7), jumps at the bound and has slopes up to 1e14.
    """
    log = value.clamp_min(SMALLEST_VALUE).log()
    return (torch.relu(math.log(low) - log).square() + torch.relu(log - math.log(high)).square()).mean()


def negative(values: Tensor) -> Float[Tensor, ""]:
    """Mean square of what is below zero (Appendix B)."""
    return torch.relu(-values).square().mean()
