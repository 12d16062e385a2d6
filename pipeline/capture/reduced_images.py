"""Images reduced by whole blocks of pixels, for which `Camera.downsampled` is exact."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32, Num

from pipeline.geometry.cameras import Camera


def reduction(camera: Camera, longest_px: int) -> int:
    """The least whole factor that reduces a camera's longer side to `longest_px` at most."""
    return max(1, math.ceil(max(camera.width, camera.height) / longest_px))


def block_means(
    image: Num[np.ndarray, "height width *channels"], factor: int, small: Camera
) -> Float32[np.ndarray, "rows columns *channels"]:
    """Means over blocks of `factor` x `factor` pixels, at the size of reduced camera `small`.

    What is cut off at the right and bottom is less than a block; `small` may round up to one more, which is 0.
    """
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    whole = image[: rows * factor, : columns * factor]
    blocks = whole.reshape(rows, factor, columns, factor, *image.shape[2:]).mean((1, 3), dtype=np.float32)
    means = np.zeros((small.height, small.width, *image.shape[2:]), np.float32)
    rows, columns = min(rows, small.height), min(columns, small.width)
    means[:rows, :columns] = blocks[:rows, :columns]
    return means
