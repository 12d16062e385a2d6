"""PSNR, SSIM, MS-SSIM and FLIP between two sRGB images; each docstring states its protocol."""

from __future__ import annotations

import flip_evaluator
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

SSIM_SIGMA = 1.5
"""Gaussian window of Wang et al. 2004, pixels; scikit-image cuts it at 3.5 sigma: 11 x 11 pixels."""

LPIPS_SMALLEST_SIDE = 32
"""Pixels; below 31 AlexNet's pooling leaves nothing of an image."""

SSIM_WINDOW = 11
"""Smallest image side for which SSIM exists, pixels."""

SSIM_C1 = 0.01**2
"""Constant of the luminance factor (Wang et al. 2004, equation 7): (K1 L)^2 with K1 = 0.01 and data range L = 1."""

MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the scales, finest first: Wang, Simoncelli and Bovik 2003, section 3.2, from a test with observers."""

MS_SSIM_SMALLEST_SIDE = (SSIM_WINDOW - 1) * 2 ** (len(MS_SSIM_WEIGHTS) - 1) + 1
"""161 pixels: four times halved and rounded up (81, 41, 21, 11), such a side still holds the window."""

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


def masked_psnr_db(
    rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"], foreground: Bool[np.ndarray, "h w"],
    image_pixels: int,
) -> float:  # fmt: skip
    """PSNR over all pixels of an image of which both sides were masked.

    None beside the subject has an error: it is that of the foreground, and 10 log10 of how many times more pixels the
    image has. NaN without foreground, or if the image's pixels are not known.
    """
    if not image_pixels or not foreground.any():
        return float("nan")
    return psnr_db(rendered, captured, foreground) + 10 * float(np.log10(image_pixels / foreground.sum()))


def ssim(rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"]) -> float:
    """Mean structural similarity (Wang et al. 2004).

    Gaussian window, data range 1, per channel, then averaged.

    NaN if a side is shorter than the window. Computed in float64: the variances are small differences.
    """
    if min(rendered.shape[:2]) < SSIM_WINDOW:
        return float("nan")
    x, y = rendered.astype(np.float64), captured.astype(np.float64)
    return float(structural_similarity(x, y, **SSIM))


def ms_ssim(rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"]) -> float:
    """Multi-scale SSIM of Wang, Simoncelli and Bovik 2003, equation 7.

    It is computed per channel, then averaged.

    The product over five scales of the mean of contrast x structure to the power of `MS_SSIM_WEIGHTS`, with the mean of
    the whole SSIM in place of it on the coarsest. From scale to scale images are averaged over 2 x 2 pixels, an odd
    last row or column with itself. A negative mean has no such power and counts 0. NaN if a side is shorter than
    `MS_SSIM_SMALLEST_SIDE`.
    """
    if min(rendered.shape[:2]) < MS_SSIM_SMALLEST_SIDE:
        return float("nan")
    x, y = rendered.astype(np.float64), captured.astype(np.float64)
    product, coarsest = np.ones(3), len(MS_SSIM_WEIGHTS) - 1
    for scale, weight in enumerate(MS_SSIM_WEIGHTS):
        similarity = structural_similarity(x, y, **SSIM, full=True)[1]
        if scale < coarsest:
            similarity = similarity / _luminance(x, y)
        product *= similarity[INSIDE].mean((0, 1)).clip(0) ** weight
        x, y = _halved(x), _halved(y)
    return float(product.mean())


SSIM = {
    "data_range": 1.0, "channel_axis": 2, "gaussian_weights": True, "sigma": SSIM_SIGMA, "use_sample_covariance": False,
}  # fmt: skip
"""How scikit-image is asked for the SSIM of the paper."""

INSIDE = (slice(SSIM_WINDOW // 2, -(SSIM_WINDOW // 2)),) * 2
"""Pixels whose window lies in the image: those that scikit-image averages over."""


def _luminance(x: Float[np.ndarray, "h w 3"], y: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """The factor of SSIM that compares local means (Wang et al. 2004, equation 6); positive where images are."""
    a, b = (gaussian_filter(image, SSIM_SIGMA, radius=SSIM_WINDOW // 2, axes=(0, 1)) for image in (x, y))
    return (2 * a * b + SSIM_C1) / (a**2 + b**2 + SSIM_C1)


def _halved(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h2 w2 3"]:
    """Means over blocks of 2 x 2 pixels; an odd last row or column stands twice."""
    height, width = image.shape[:2]
    even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2, 3).mean((1, 3))


def flip(rendered: Float[np.ndarray, "h w 3"], captured: Float[np.ndarray, "h w 3"]) -> float:
    """Mean LDR-FLIP of Andersson et al. 2020 at 67 pixels per degree; inputs are sRGB in [0, 1]."""
    reference, test = (np.ascontiguousarray(image, dtype=np.float32) for image in (captured, rendered))
    parameters = {"ppd": FLIP_PIXELS_PER_DEGREE}
    return float(flip_evaluator.evaluate(reference, test, "LDR", True, False, True, parameters)[1])


def foreground_box(foreground: Bool[np.ndarray, "h w"], at_least: int = 1) -> tuple[slice, slice]:
    """Rows and columns of the smallest box around the foreground.

    It is grown to `at_least` pixels a side where the image allows.

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
