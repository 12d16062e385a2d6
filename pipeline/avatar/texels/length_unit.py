"""Unit of lengths that suit a person, for subjects that are no person's size."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.texels import Atlas

PERSONS_M = (0.1, 10.0)
"""Longest sides of subjects whose lengths are those that settings and constants were made for: a hand to a horse."""


def length_unit_m(atlas: Atlas) -> float:
    """Length that takes the place of a metre where the avatar assumes lengths.

    These are the bounds of Gaussian scales, the rate of offsets, the nearest that a camera may be, and the like. A
    subject of a millimetre or of a hundred metres is learned as one of a metre would be, so that all that is made of
    it scales with it; for any subject in `PERSONS_M` a metre is a metre.

    Returns:
        1, or the longest side of the box around the template at rest, metres.
    """
    long_m = float(np.ptp(atlas.rest_vertices.astype(np.float64), axis=0).max(initial=0.0))
    low, high = PERSONS_M
    return 1.0 if low <= long_m <= high or not 0 < long_m < np.inf else long_m
