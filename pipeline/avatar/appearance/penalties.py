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

SMALLEST_DIFFERENCE = 1e-3
"""Of an albedo, a normal or a logarithm, that shows: a quarter of a level of 8 bits."""

SMALLEST_VALUE = 1e-30
"""Values are bounded as if they were no smaller: slopes, 2 log(low / v) / v, then fit into float32."""


PRINTED_FLOOR = 1e-7
"""Below this value, in the unit of the bound, the papers' lower branch stays as it is."""


def outside(value: Tensor, low: float, high: float) -> Float[Tensor, ""]:
    """Mean squared excess over bounds, in units of log: zero inside, finite slope everywhere.

    The paper's lower branch, 1 / max(v, 1e-7), jumps at the bound and has slopes up to 1e14.
    """
    log = value.clamp_min(SMALLEST_VALUE).log()
    return (torch.relu(math.log(low) - log).square() + torch.relu(log - math.log(high)).square()).mean()


def outside_as_printed(value: Tensor, low: float, high: float) -> Float[Tensor, ""]:
    """Mean of 1 / max(v, 1e-7) below the bounds and (v - high)^2 above (RFGCA B.2, RGCA 14).

    It jumps at the lower bound, and its slopes reach 1e14. Finite for all finite values.
    """
    below = torch.where(value < low, 1 / value.clamp_min(PRINTED_FLOOR), torch.zeros_like(value))
    return (below + torch.relu(value - high).square()).mean()


def total_variation(values: Float[Tensor, " texels *channels"], pairs: Int[Tensor, "2 pairs"]) -> Float[Tensor, ""]:
    """Sum of the absolute differences of pairs of texels, per texel.

    Total variation (Rudin et al. 1992): an edge costs as much as a slope of the same height, noise costs more.
    Differences below `SMALLEST_DIFFERENCE` count squared (Huber's loss), so that the slope is continuous.

    Args:
        values: of the texels.
        pairs: as `pipeline.geometry.texels.texels_side_by_side` makes them.
    """
    rows = values.reshape(len(values), -1)
    one, other = (rows.index_select(0, of_pairs) for of_pairs in pairs)
    huber = torch.nn.functional.smooth_l1_loss(one, other, beta=SMALLEST_DIFFERENCE, reduction="sum")
    return huber / len(rows)


def negative(values: Tensor) -> Float[Tensor, ""]:
    """Mean square of what is below zero (Appendix B)."""
    return torch.relu(-values).square().mean()
