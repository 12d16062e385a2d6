"""Colour matrices, and the sRGB transfer function (IEC 61966-2-1), for arrays and tensors.

Images are shown and scored in sRGB. Neither direction clips: below zero both curves go on along their straight piece,
above one along the power, so that noise and highlights survive a round trip. Where a display's range is meant, clip
to [0, 1] first.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from pipeline.base.array_module import is_tensor

Colors = TypeVar("Colors")
"""A NumPy array or a torch tensor of floats."""

BREAK_LINEAR = 0.0031308
BREAK_SRGB = 0.04045
SLOPE = 12.92
"""Slope of the curve below the break. On a straight line, value and gradient are finite at zero."""

GAMMA = 2.2
"""Exponent of images that are a plain power of light, which is not sRGB: that is straight near black."""


_SECOND = ("rg", "rb", "gb", "rr", "gg", "bb")
_THIRD = ("rrg", "ggb", "bbr")
_MIXED = (*_THIRD, "rrb", "ggr", "bbg")
_CUBES = ("rrr", "ggg", "bbb")
_FOURTH = ("rrrg", "rrrb", "gggr", "gggb", "bbbr", "bbbg", "rrgb", "rggb", "rgbb", "rrgg", "rrbb", "ggbb", "rrrr",
           "gggg", "bbbb")  # fmt: skip

POLYNOMIALS: dict[int, tuple[str, ...]] = {
    3: (), 4: ("",), 5: ("rgb", ""), 7: ("rg", "rb", "gb", ""), 8: ("rg", "rb", "gb", "rgb", ""),
    10: (*_SECOND, ""), 11: (*_SECOND, "rgb", ""), 14: (*_SECOND, "rgb", *_CUBES, ""),
    16: (*_SECOND, "rgb", *_THIRD, *_CUBES), 17: (*_SECOND, "rgb", *_THIRD, *_CUBES, ""),
    19: (*_SECOND, "rgb", *_MIXED, *_CUBES), 20: (*_SECOND, "rgb", *_MIXED, *_CUBES, ""),
    22: (*_SECOND, "rgb", *_MIXED, *_CUBES, "rrgb", "rggb", "rgbb"),
    35: (*_SECOND, "rgb", *_MIXED, *_CUBES, *_FOURTH, ""),
}  # fmt: skip
"""Columns of a colour matrix after R, G and B, by their number: products of channels, "" being 1. The polynomials
of Cheung et al. 2004, in the order of Westland and Ripamonti 2004, table 8.2, which programs share."""


def corrected(rgb_linear: Colors, matrix: Colors) -> Colors:
    """Colours [..., 3] by a matrix 3 x 3, one of 3 x 4 with a column to add, or a polynomial's.

    Args:
        rgb_linear: colours.
        matrix: 3 rows; the number of its columns says which products of channels they go with, see `POLYNOMIALS`.
    """
    turned = rgb_linear @ matrix[:, :3].T
    for column, product in enumerate(POLYNOMIALS[matrix.shape[1]], 3):
        weights = matrix[:, column]
        if not product:
            turned = turned + weights
            continue
        term = rgb_linear[..., "rgb".index(product[0])]
        for channel in product[1:]:
            term = term * rgb_linear[..., "rgb".index(channel)]
        turned = turned + term[..., None] * weights
    return turned


def srgb_from_linear(rgb_linear: Colors) -> Colors:
    """Encode linear RGB of any shape."""
    power = 1.055 * rgb_linear.clip(BREAK_LINEAR, None) ** (1 / 2.4) - 0.055
    return _choose(rgb_linear <= BREAK_LINEAR, SLOPE * rgb_linear, power)


def linear_from_srgb(rgb_srgb: Colors) -> Colors:
    """Decode sRGB of any shape."""
    power = ((rgb_srgb.clip(BREAK_SRGB, None) + 0.055) / 1.055) ** 2.4
    return _choose(rgb_srgb <= BREAK_SRGB, rgb_srgb / SLOPE, power)


def linear_from_gamma(stored: Colors) -> Colors:
    """Decode values of any shape that are light to the power of 1 / `GAMMA`.

    Below zero the curve is mirrored.
    """
    return np.sign(stored) * np.abs(stored) ** GAMMA


DECODERS = {"srgb": linear_from_srgb, "gamma_2.2": linear_from_gamma}
"""How stored values become light, by the name of the transfer function."""


def _choose(condition, below, above):
    return below.where(condition, above) if is_tensor(below) else np.where(condition, below, above)
