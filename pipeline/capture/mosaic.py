"""Raw Bayer mosaics, whose pixels see one colour each, as images of three channels."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float32, Shaped

from pipeline.base.errors import InputError

Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
"""Colours of the first two pixels of the first row, then those below them."""


def spread_cells(
    stored: Shaped[np.ndarray, "h w *channels"], mosaic: Mosaic, path: Path
) -> Float32[np.ndarray, "H W 3"]:
    """RGB of each cell of 2 x 2 pixels, at all four of them.

    Values are as stored, green is the mean of the two. Nothing is interpolated between cells: a patch of
    a chart keeps its colours, and all pixels their places. A last row or column that has no partner is left out.

    Raises:
        InputError: if the image has more than one channel.
    """
    if stored.ndim != 2:
        raise InputError(f"{path}: expected a mosaic of one channel, found {stored.shape[2]}; leave out mosaic?")
    height, width = (side // 2 * 2 for side in stored.shape)
    sites = stored[:height, :width].astype(np.float32).reshape(height // 2, 2, width // 2, 2).swapaxes(1, 2)
    flat = sites.reshape(height // 2, width // 2, 4)
    channels = [flat[..., [k for k, color in enumerate(mosaic) if color == name]].mean(-1) for name in "RGB"]
    return np.stack(channels, -1).repeat(2, axis=0).repeat(2, axis=1)
