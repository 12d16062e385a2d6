"""Irradiance maps of drawn lights, made ready to be learned from: blurred until their noise is small."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32
from scipy.ndimage import gaussian_filter

from pipeline.geometry.texels import Atlas

NOISE_LEFT = 0.05
"""Standard error of a blurred map. One draw a texel on 256 squared texels has 0.5, which takes a blur of 2.8 texels; on
a recorded body that brought the map nearest to the exact one (RMS 0.06; 2 to 4 texels are alike), as a wider blur takes
more from the edges of shadows than it takes from the noise."""

MOST_TEXELS = 8.0
"""Standard deviation of the widest blur: shadows of limbs are a few times as wide."""


def smooth_drawn(
    atlas: Atlas,
    irradiance: Float32[np.ndarray, " t"],
    falling: Float32[np.ndarray, " t"],
    error: Float32[np.ndarray, " t"],
) -> tuple[Float32[np.ndarray, " t"], Float32[np.ndarray, " t"]]:
    """Both maps of `pipeline.lighting.irradiance`, blurred over the atlas as far as the first one's noise asks for.

    A Gaussian of standard deviation s averages 4 pi s^2 texels, which leaves 1 / (2 sqrt(pi) s) of the error of
    independent ones. Only texels count, so that nothing leaks in from outside the charts. Exact maps stay as they are.

    Args:
        error: standard error of `irradiance`; 0 where all lights were summed.
    """
    noise = float(np.sqrt(np.mean(np.square(error, dtype=np.float64)))) if len(error) else 0.0
    if noise <= NOISE_LEFT:
        return irradiance, falling
    width = min(noise / (2 * math.sqrt(math.pi) * NOISE_LEFT), MOST_TEXELS)
    weight = gaussian_filter(atlas.to_map(np.ones(atlas.texel_count)), width)

    def blurred(values: np.ndarray) -> np.ndarray:
        image = gaussian_filter(atlas.to_map(values.astype(np.float64)), width)
        return (atlas.from_map(image) / atlas.from_map(weight)).astype(np.float32)

    return blurred(irradiance), blurred(falling)
