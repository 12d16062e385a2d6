"""Looking up images between pixels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.base.conventions import PIXEL_CENTER

EDGE_PX = 1e-3
"""Keeps a bilinear look-up's right and lower neighbour inside the image."""


def sample_bilinear(
    stack: Float32[np.ndarray, "frames height width *channels"],
    frame: Int64[np.ndarray, " points"],
    pixels: Float64[np.ndarray, "points 2"],
) -> tuple[Float64[np.ndarray, " points *channels"], Float64[np.ndarray, " points *channels 2"]]:
    """Bilinear value and gradient at pixels of the images stack[frame].

    Outside, those of the nearest edge.
    """
    height, width = stack.shape[1:3]
    x = np.clip(pixels[:, 0] - PIXEL_CENTER, 0, width - 1 - EDGE_PX)
    y = np.clip(pixels[:, 1] - PIXEL_CENTER, 0, height - 1 - EDGE_PX)
    column, row = x.astype(np.int64), y.astype(np.int64)
    u, v = ((along - whole).reshape(-1, *(1,) * (stack.ndim - 3)) for along, whole in ((x, column), (y, row)))
    a, b = stack[frame, row, column], stack[frame, row, column + 1]
    c, d = stack[frame, row + 1, column], stack[frame, row + 1, column + 1]
    value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    return value, np.stack([(1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)], -1)
