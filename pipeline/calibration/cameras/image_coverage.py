"""Parts of an image that the corners of the board cover."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

CELLS = 8
"""Cells along either side of the grid that corners should cover: one is about as large as a square of the board."""


def cell_numbers(pixels: Float64[np.ndarray, "corners 2"], width: int, height: int) -> Int64[np.ndarray, " corners"]:
    """Cell of each pixel, counted row by row; of those beyond the image, the nearest."""
    column, row = np.clip(pixels / [width, height] * CELLS, 0, CELLS - 1).astype(np.int64).T
    return row * CELLS + column


def count_cells(pixels: Float64[np.ndarray, "corners 2"], width: int, height: int) -> Int64[np.ndarray, "rows columns"]:
    """Corners in each of the `CELLS` x `CELLS` cells of an image.

    Those beyond the image count in the nearest cell.
    """
    return np.bincount(cell_numbers(pixels, width, height), minlength=CELLS**2).reshape(CELLS, CELLS)


def covered_share(pixels: Float64[np.ndarray, "corners 2"], width: int, height: int) -> float:
    """Share of the cells in which there are corners."""
    return float((count_cells(pixels, width, height) > 0).mean())
