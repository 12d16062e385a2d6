"""Vertices against the mask of the mesh they belong to."""

from __future__ import annotations

import cv2
import numpy as np


def assert_outlined(mask: np.ndarray, pixels: np.ndarray, off_px: int = 1) -> None:
    """All vertices lie in the mask, and reach its four sides, up to `off_px`.

    Args:
        mask: what is the mesh, any values but 0.
        pixels: x and y of its vertices, from the corner of the first pixel.
    """
    inside = (mask > 0).astype(np.uint8)
    wider = cv2.dilate(inside, np.ones((2 * off_px + 1,) * 2, np.uint8))
    at = np.floor(pixels).astype(int)
    assert wider[at[:, 1], at[:, 0]].all()
    rows, columns = np.nonzero(inside)
    sides = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    np.testing.assert_allclose([*pixels.min(0), *pixels.max(0)], sides, atol=off_px)
