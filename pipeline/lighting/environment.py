"""Environment maps: light from all around as the pixels of a panorama, each a distant light.

Panoramas are equirectangular, y up, row 0 at the zenith; the left edge looks along -z and a quarter of the width
further along +x (Mitsuba's convention, so the same file lights both the same way). A pixel of radiance L that covers
the solid angle W is a distant light of irradiance L W; drawing lights by their luminance then is importance sampling by
luminance and solid angle, and summing over all of them is exact for the map as it is stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from pipeline.base.errors import InputError
from pipeline.capture.images import read_image
from pipeline.lighting.light_scene import LUMINANCE, Lights

WIDTH_OVER_HEIGHT = 2
"""Of a panorama of the whole sphere with square pixels at the horizon."""


@dataclass(frozen=True)
class Environment:
    """Radiance of a panorama, linear RGB."""

    radiance: Float32[np.ndarray, "height width 3"]

    def directions(self) -> Float64[np.ndarray, "height width 3"]:
        """Unit direction of each pixel's centre, in the world."""
        height, width = self.radiance.shape[:2]
        polar = np.pi * (np.arange(height) + 0.5)[:, None] / height
        around = 2 * np.pi * (np.arange(width) + 0.5)[None] / width
        across = np.sin(polar)
        return np.stack(
            [across * np.sin(around), np.broadcast_to(np.cos(polar), (height, width)), -across * np.cos(around)], -1
        )

    def solid_angles(self) -> Float64[np.ndarray, " height"]:
        """Solid angle of a pixel in each row, steradian: exact, so all pixels together have 4 pi."""
        height, width = self.radiance.shape[:2]
        edges = np.cos(np.pi * np.arange(height + 1) / height)
        return 2 * np.pi / width * -np.diff(edges)

    def irradiances(self) -> Float64[np.ndarray, "pixels 3"]:
        """Radiance times solid angle of every pixel, row by row."""
        return (self.radiance * self.solid_angles()[:, None, None]).reshape(-1, 3)

    def lights(self) -> Lights:
        """Every pixel as a distant light."""
        return Lights(self.directions().reshape(-1, 3), self.irradiances() @ LUMINANCE, distant=True)

    def reduced(self, height: int) -> Environment:
        """A smaller panorama of the same light.

        Each new pixel is the mean, by solid angle, of those it covers.

        `height` must divide the panorama's; a panorama that is no higher is returned as it is.
        """
        rows, columns = self.radiance.shape[:2]
        if rows <= height:
            return self
        factor = rows // height
        if rows % height or columns % factor:
            raise ValueError(f"expected a height that divides {rows} by a whole number, found {height}")
        weight = self.solid_angles().reshape(height, factor)
        blocks = self.radiance.reshape(height, factor, columns // factor, factor, 3).mean(3)
        mean = np.einsum("hf,hfwc->hwc", weight / weight.sum(1, keepdims=True), blocks)
        return Environment(mean.astype(np.float32))


def read_environment(path: Path) -> Environment:
    """Read a panorama from a Radiance .hdr or an OpenEXR file.

    Raises:
        InputError: if it is neither, is not twice as wide as high, or has values that are negative or not finite.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected an environment map, found no such file")
    if path.suffix.lower() == ".exr":
        radiance = read_image(path)
    else:
        stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.suffix.lower() == ".hdr" else None
        if stored is None or stored.ndim != 3:
            raise InputError(f"{path}: expected an environment map in .hdr or .exr, found something else")
        radiance = np.ascontiguousarray(stored[..., ::-1], dtype=np.float32)
    height, width = radiance.shape[:2]
    if width != WIDTH_OVER_HEIGHT * height:
        raise InputError(
            f"{path}: expected an equirectangular panorama, twice as wide as high, found {width} x {height}"
        )
    if not np.isfinite(radiance).all() or radiance.min() < 0:
        raise InputError(f"{path}: expected radiances of 0 or more, found some that are negative or not finite")
    return Environment(radiance)
