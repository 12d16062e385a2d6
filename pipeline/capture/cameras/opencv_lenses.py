"""Lenses as OpenCV's calibration functions give them.

K counts from the centre of the first pixel; distortion is a row of coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.errors import InputError
from pipeline.capture.cameras.camera_formats import SourceLens, finite_numbers
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tauX", "tauY")
"""In the order of cv2.calibrateCamera, which gives 4, 5, 8, 12 or 14 of them."""

COUNTS = (4, 5, 8, 12, 14)

MIDDLE = 0.2
"""Share of a side by which the principal point may be off the middle of the image: an ordinary lens's is within a
tenth, and that of K for images of half the size, where a file says no size, a quarter off."""


def opencv_lens(
    values: Mapping[str, Any], K_key: str, dist_key: str, size: tuple[int, int], *, fisheye: bool = False
) -> SourceLens:
    """The lens of two matrices of a file.

    Args:
        size: width and height, pixels.
        fisheye: whether the four coefficients are those of cv2.fisheye.

    Raises:
        InputError: if they are none, or those of images of another size.
    """
    K = finite_numbers(values, K_key, (3, 3))
    if np.any(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != [0, 0, 0, 0, 1]):
        raise InputError(f"{K_key}: expected no skew and a last row of 0, 0, 1, found {K.tolist()}")
    off = np.abs((K[:2, 2] + PIXEL_CENTER) / size - 0.5).max()
    if off > MIDDLE:
        found = f"{K[0, 2]:g}, {K[1, 2]:g}"
        expected = f"a principal point near the middle of {size[0]} x {size[1]} pixels"
        raise InputError(f"{K_key}: expected {expected}, found {found}; give K of the sensor's resolution")
    model = FISHEYE if fisheye else BROWN_CONRADY
    names = model.terms if fisheye else COEFFICIENTS
    given = np.atleast_1d(np.asarray(values.get(dist_key, np.zeros(0))))
    if given.size not in ((len(names),) if fisheye else COUNTS):
        counts = len(names) if fisheye else "4, 5, 8, 12 or 14"
        raise InputError(f"{dist_key}: expected {counts} coefficients, found {given.size or 'none'}")
    dist = finite_numbers({dist_key: given.ravel()}, dist_key, (given.size,))
    terms = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2] + PIXEL_CENTER, "cy": K[1, 2] + PIXEL_CENTER}
    return SourceLens(model, terms | dict(zip(names, dist.tolist(), strict=False)), *size)
