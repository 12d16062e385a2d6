"""Over- and underexposed images: a plateau at the top of stored levels, or too few levels."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float

from pipeline.base.verdicts import Grade

LEVELS = ["top", "at_top", "step"]
"""Columns of what `stored_levels` measures."""

CLIPPED_WEAK, CLIPPED_FAILED = 0.012, 0.12
"""Share of the subject's pixels that are clipped from which a camera is weak, and failed. A clipped pixel that should
be half a stop brighter than white errs by srgb(sqrt(2)) - 1 = 0.164. A share of 0.012 of them makes a mean square of
10^-3.5, an error of 35 dB, as large as that of the best avatars; ten times as many, 25 dB, more than of poor ones."""

COARSE_WEAK, COARSE_FAILED = 0.29, 0.91
"""Distance of stored levels, over the subject's median, from which a camera is weak, and failed. Rounding errs by
1 / sqrt(12) of it; brightened until the median is a mid grey of 0.18, where sRGB rises by 1.195, that is 35 dB for 0.29
(a median of 3.5 counts) and 25 dB for 0.91 (1.1 counts)."""

SAME_LEVEL = 1e-6
"""Relative difference of two numbers that one stored level gives: rounding of float32."""

SAMPLES = 4096
"""Pixels by which the distance of levels is told: each of the 256 levels of a byte gets 16 of them, on average."""

BRIGHTEST = 0.25
"""Share of a camera's images that are judged, the brightest: the others have few lights on."""


def stored_levels(pixels: Float[np.ndarray, "pixels 3"]) -> tuple[float, float, float]:
    """Measure the subject's pixels in one image, linear RGB.

    Returns:
        the largest value of any channel; the share of pixels at it, less the share at the next lower level (a plateau:
        where nothing is clipped, the tail is no thicker at its end than before); and the distance of stored levels
        over the median of green, infinite if that is not above 0.
    """
    brightest = pixels.max(1)
    top = float(brightest.max())
    plateau = (brightest >= top - SAME_LEVEL * abs(top)) & (top > 0)
    rest = brightest[~plateau]
    below = float((rest >= rest.max() - SAME_LEVEL * abs(rest.max())).sum()) if len(rest) else 0.0
    green = np.sort(pixels[:: -(-len(pixels) // SAMPLES), 1].astype(np.float64))
    middle, near = float(np.median(green)), green[int(0.25 * len(green)) : int(np.ceil(0.75 * len(green)))]
    gaps = np.diff(near)
    gaps = gaps[gaps > SAME_LEVEL * abs(middle)]
    # One level through half of the pixels: the next is as far away as the others are.
    step = float(np.median(gaps)) if len(gaps) else float(np.ptp(green))
    return top, max(float(plateau.sum()) - below, 0.0) / len(pixels), step / middle if middle > 0 else np.inf


def level_flaws(images: pd.DataFrame) -> list[tuple[Grade, str]]:
    """Judge the images of one camera.

    Args:
        images: r, g, b and `LEVELS` of each.
    """
    bright = images[["r", "g", "b"]].mean(axis=1)
    judged = images[bright >= bright.quantile(1 - BRIGHTEST)]
    top = images.top.max()
    full = judged.top >= top - SAME_LEVEL * abs(top)
    # What clips stops at one value in all images.
    shared = (images.top >= top - SAME_LEVEL * abs(top)).sum() > 1 or len(images) == 1
    clipped = float((judged.at_top * full).mean()) if shared else 0.0
    step = float(judged.step.median())
    flaws: list[tuple[Grade, str]] = []
    if clipped > CLIPPED_WEAK:
        grade: Grade = "failed" if clipped > CLIPPED_FAILED else "weak"
        flaws.append((grade, f"overexposed: {clipped:.1%} of the subject at the largest value stored, {top:.3g}"))
    if step > COARSE_WEAK:
        grade = "failed" if step > COARSE_FAILED else "weak"
        flaws.append((grade, f"underexposed: the subject's median is {1 / step:.1f} times the distance of levels"))
    return flaws
