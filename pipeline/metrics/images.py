"""PSNR, SSIM and FLIP between two sRGB images; each docstring states its protocol."""

from __future__ import annotations

import flip_evaluator
import numpy as np
from jaxtyping import Bool, Float
from skimage.metrics import structural_similarity

SSIM_SIGMA = 1.5
"""Gaussian window of Wang et al. 2004, pixels; scikit-image cuts it at 3.5 sigma: 11 x 11 pixels."""

SSIM_WINDOW = 11
"""Smallest image side for which SSIM exists, pixels."""

FLIP_PIXELS_PER_DEGREE = 67.0
"""FLIP's own default viewing condition: a 0.7 m wide 4K display seen from 0.7 m."""


def psnr_db(
    rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"], foreground: Bool[np.ndarray, "h w"]
) -> float:
    """Peak signal-to-noise ratio, peak 1, over the foreground pixels only.

    Infinite for equal images, NaN without foreground. Background is left out because two black backgrounds agree for
    free: averaging over them adds decibels that depend on the crop.
    """
    if not foreground.any():
        return float("nan")
    error = rendered[foreground].astype(np.float64) - captured[foreground].astype(np.float64)
    mean_square = float(np.mean(error**2))
    return float("inf") if mean_square == 0 else -10 * float(np.log10(mean_square))


def ssim(rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"]) -> float:
    """Mean structural similarity of Wang et al. 2004: Gaussian window, data range 1, per channel, then averaged.

    NaN if a side is shorter than the window. Computed in float64: the variances are small differences.
    """
    if min(rendered.shape[:2]) < SSIM_WINDOW:
        return float("nan")
    return float(
        structural_similarity(
            rendered.astype(np.float64),
            captured.astype(np.float64),
            data_range=1.0,
            channel_axis=2,
            gaussian_weights=True,
            sigma=SSIM_SIGMA,
            use_sample_covariance=False,
        )
    )


def flip(rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"]) -> float:
    """Mean LDR-FLIP of Andersson et al. 2020 at 67 pixels per degree; inputs are sRGB in [0, 1]."""
    reference, test = (np.ascontiguousarray(image, dtype=np.float32) for image in (captured, rendered))
    parameters = {"ppd": FLIP_PIXELS_PER_DEGREE}
    return float(flip_evaluator.evaluate(reference, test, "LDR", True, False, True, parameters)[1])


def foreground_box(foreground: Bool[np.ndarray, "h w"], at_least: int = 1) -> tuple[slice, slice]:
    """Rows and columns of the smallest box around the foreground, grown to `at_least` pixels where the image allows.

    Without foreground: the whole image.
    """
    if not foreground.any():
        return slice(0, foreground.shape[0]), slice(0, foreground.shape[1])
    sides = []
    for axis, length in enumerate(foreground.shape):
        hit = np.flatnonzero(foreground.any(axis=1 - axis))
        first, size = int(hit[0]), max(int(hit[-1] - hit[0]) + 1, min(at_least, length))
        first = max(0, min(first - (size - (int(hit[-1]) - int(hit[0]) + 1)) // 2, length - size))
        sides.append(slice(first, first + size))
    return sides[0], sides[1]
