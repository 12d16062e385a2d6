"""An even environment, which stands for constant light that a set does not describe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float64

LIGHTS = 32
"""Enough that each covers 0.4 steradian, less than a cosine lobe resolves."""

DISTANCE_M = 10.0
"""Far beside any subject, so that the light is the same all over it."""

RADIANCE = 1.0
"""Of the environment: a white diffuse surface that sees all of it is as bright as the images' full scale."""

STANDS_FOR = (
    f"{LIGHTS} lights of one brightness, {DISTANCE_M:g} m away on all sides: the set does not say where light is from"
)


def even_light(
    center: Float64[np.ndarray, " 3"], frames: Sequence[int]
) -> tuple[pd.DataFrame, pd.DataFrame]:  # fmt: skip
    """Tables of lights and of patterns, all lit in every frame.

    Columns are light, x, y, z, and frame, light, intensity.
    Places are spread by the golden angle. Together they give the irradiance 4 pi / N per light and radiance.

    Args:
        center: of the subject, metres.
    """
    height = 1 - 2 * (np.arange(LIGHTS) + 0.5) / LIGHTS
    around = np.pi * (3 - np.sqrt(5)) * np.arange(LIGHTS)
    ring = np.sqrt(1 - height**2)
    places = center + DISTANCE_M * np.stack([ring * np.cos(around), height, ring * np.sin(around)], axis=1)
    names = [f"even{number:02d}" for number in range(LIGHTS)]
    intensity = RADIANCE * 4 * np.pi / LIGHTS * DISTANCE_M**2
    patterns = [(frame, name, intensity) for frame in frames for name in names]
    lights = pd.DataFrame({"light": names, **dict(zip("xyz", places.T, strict=True))})
    return lights, pd.DataFrame(patterns, columns=["frame", "light", "intensity"])
