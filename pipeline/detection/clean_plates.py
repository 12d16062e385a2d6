"""Masks by clean plates: pixels that differ from an image of the empty stage.

It is of the same camera under the same light.

A pixel differs if its colour is further from the plate's than the noise of both explains. The noise is measured on the
plate, by level of brightness, as the spread of pixels about the median of their neighbours; texture counts as noise, so
that a moved wire does not become the subject. What is as black as the stage behind it, such as hair, cannot be told
from it: holes inside the outline are filled, a black fringe is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

LEVELS = 16
"""Ranges of brightness that noise is measured in, with equally many pixels each."""

MAD_TO_DEVIATION = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation. Pixels that differ from the median of their
3 x 3 neighbourhood are as far from it as from the true value, to 2 % (a million Gaussian pixels)."""

DIFFERENT = 5.0
"""Distance from the plate, in standard deviations of a mean over 3 x 3 pixels, that counts: of a chi distribution with
three degrees of freedom, one pixel in 65,000 is beyond."""

CLOSED = 150
"""Gaps of the outline up to the longer side over this are closed: one of 4 pixels in 600."""

LEAST_SHARE = 0.001
"""Of the image: smaller parts are no part of the subject."""


@dataclass(frozen=True)
class PlateNoise:
    """Standard deviation of a plate's pixels about their neighbours, by channel and brightness.

    Attributes:
        levels: brightness, rising.
        deviations: of the pixels about that brightness.
    """

    levels: Float64[np.ndarray, "channels levels"]
    deviations: Float64[np.ndarray, "channels levels"]

    def at(self, image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
        """Deviation of pixels as bright as these."""
        found = [np.interp(image[..., c], self.levels[c], self.deviations[c]) for c in range(3)]
        return np.stack(found, -1).astype(np.float32)


def measure_noise(plate: Float32[np.ndarray, "h w 3"]) -> PlateNoise:
    """Noise of a clean plate."""
    smooth = np.stack([cv2.medianBlur(np.ascontiguousarray(plate[..., c]), 3) for c in range(3)], -1)
    residual, levels, deviations = np.abs(plate - smooth), [], []
    for c in range(3):
        order = np.argsort(smooth[..., c], axis=None, kind="stable")
        parts = np.array_split(order, LEVELS)
        levels.append([float(smooth[..., c].flat[part].mean()) for part in parts])
        # The median itself is one of the nine in a ninth of the cases: those zeros are left out.
        spread = [residual[..., c].flat[part] for part in parts]
        deviations.append([float(np.median(each[each > 0])) if (each > 0).any() else 0.0 for each in spread])
    return PlateNoise(np.maximum.accumulate(np.array(levels), axis=1), MAD_TO_DEVIATION * np.array(deviations))


def mask_by_plate(
    image: Float32[np.ndarray, "h w 3"], plate: Float32[np.ndarray, "h w 3"], noise: PlateNoise, step: float
) -> UInt8[np.ndarray, "h w"]:
    """Mask of the subject, 255 where the image differs from the plate.

    Args:
        image, plate: linear, of the same camera under the same light.
        noise: of the plate.
        step: smallest difference that the files can store, in the same units; noise is no smaller.
    """
    mean = cv2.blur(image - plate, (3, 3))
    # Of the difference of two images, over nine pixels.
    deviation = np.maximum(noise.at(plate), np.float32(step)) * np.float32(np.sqrt(2) / 3)
    distance = np.sqrt(((mean / deviation) ** 2).sum(-1))
    return np.where(_tidied(distance > DIFFERENT), 255, 0).astype(np.uint8)


def _tidied(different: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Gaps closed, holes filled, small parts left out."""
    side = max(different.shape)
    reach = max(1, round(side / CLOSED / 2))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    padded = np.pad(different.astype(np.uint8), 2 * reach)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc)[2 * reach : -2 * reach, 2 * reach : -2 * reach]
    # The mean over 3 x 3 pixels reached one pixel beyond the outline.
    closed = cv2.erode(closed, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(closed)
    large = [each for each in outlines if cv2.contourArea(each) >= LEAST_SHARE * closed.size]
    cv2.drawContours(filled, large, -1, 1, cv2.FILLED)
    return filled.astype(bool)
