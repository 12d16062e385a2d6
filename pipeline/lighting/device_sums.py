"""Sums over all pairs of point and light in plain torch.

For devices whose memory the compiled kernels cannot read.

Points are taken in pieces whose intermediate numbers fit, and made again in the backward pass instead of kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor
from torch.utils.checkpoint import checkpoint

PAIRS_AT_ONCE = 2**21
"""Points times lights of a piece: with the 27 numbers of a pair's zonal light, a dozen times over, 3 GB."""


def sum_in_pieces(sum_over_lights: Callable[..., Tensor], per_point: Sequence[Tensor | None], lights: int) -> Tensor:
    """`sum_over_lights(*per_point)`, a piece of the points at a time. What is None stays None in every piece."""
    points = len(per_point[0])
    size = max(1, PAIRS_AT_ONCE // max(1, lights))
    sums = []
    for start in range(0, max(1, points), size):
        piece = [None if tensor is None else tensor[start : start + size] for tensor in per_point]
        sums.append(checkpoint(sum_over_lights, *piece, use_reentrant=False, preserve_rng_state=False))
    return torch.cat(sums)


def unpacked(
    seen: UInt8[np.ndarray, "lights bytes"], points: int, device: torch.device
) -> Bool[Tensor, "points lights"] | None:
    """Visibility bits as a mask; None if everything is seen."""
    if (seen == 255).all():
        return None
    return torch.as_tensor(np.unpackbits(seen, axis=1, count=points).T.astype(bool), device=device)
