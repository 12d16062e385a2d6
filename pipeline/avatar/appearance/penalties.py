"""Penalties on parameters: bounds, and values below zero (RFGCA Appendix B)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

ROUGHNESS_BOUNDS = (0.01, 0.25)
"""Bounds of the lobe width in radians (RFGCA Appendix B)."""

HALFWAY_BOUNDS = (0.01, 1.0)
"""Bounds of the lobe about half vectors, radians: sqrt(2) of the width of GGX, 0.4 for skin."""

GGX_WIDTH_BOUNDS = (0.05, 1.0)
"""Bounds of the width of GGX: at 0.05 a highlight is as wide as a lamp of the stage, at 1 it is matte."""

RIGHT, BELOW = 5, 7
"""Places of these neighbours in a row of `adjoining_texels`."""

SMALLEST_DIFFERENCE = 1e-3
"""Of an albedo, a normal or a logarithm, that shows: a quarter of a level of 8 bits."""

SMALLEST_VALUE = 1e-30
"""Values are bounded as if they were no smaller: slopes, 2 log(low / v) / v, then fit into float32."""


def outside(value: Tensor, low: float, high: float) -> Float[Tensor, ""]:
    """Mean squared excess over bounds, in units of log: zero inside, finite slope everywhere.

    The paper's lower branch, 1 / max(v, 1e-7), jumps at the bound and has slopes up to 1e14.
    """
    log = value.clamp_min(SMALLEST_VALUE).log()
    return (torch.relu(math.log(low) - log).square() + torch.relu(log - math.log(high)).square()).mean()


def total_variation(values: Float[Tensor, "texels *channels"], adjoining: Int[Tensor, "texels 9"]) -> Float[Tensor, ""]:
    """Sum of the differences to the texels on the right and below, a mean over texels.

    Total variation (Rudin et al. 1992): an edge costs as much as a slope of the same height, noise costs more.
    Differences far below `SMALLEST_DIFFERENCE` count squared, so that the slope is continuous. `adjoining` as
    `pipeline.geometry.texels.adjoining_texels` makes them.
    """
    rows, total = values.reshape(len(values), -1), values.new_zeros(())
    for column in (RIGHT, BELOW):
        other = adjoining[:, column].long()
        there = (other < len(rows))[:, None]
        difference = (rows[other.clamp_max(len(rows) - 1)] - rows) * there
        total = total + ((difference.square() + SMALLEST_DIFFERENCE**2).sqrt() - SMALLEST_DIFFERENCE).sum()
    return total / len(rows)


def negative(values: Tensor) -> Float[Tensor, ""]:
    """Mean square of what is below zero (Appendix B)."""
    return torch.relu(-values).square().mean()
