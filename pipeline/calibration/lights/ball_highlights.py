"""The bright spots in the image of a mirror ball, one of which is the light that is on."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from pipeline.base.conventions import PIXEL_CENTER

RIM_PX = 2.0
"""Highlights are looked for inside the outline and this far beyond it: rim highlights blur across it."""

HIGHLIGHT_FLOOR = 0.03
"""Share of the brightest pixel below which a pixel is no part of a highlight: leaves out glow, and takes in the edge
pixels that place the rest (on captures/walker 0.1 costs 7 % and 0.2 half of the accuracy)."""

WIDE_SPOT = 30
"""Pixels above a level of `CORE_LEVELS` from which they alone place a spot: its edge averages out, and the glow and the
streaks round a strong highlight lie to one side (a clipped one in a photograph has twice as much of them as itself)."""
CORE_LEVELS = (0.95, 0.5)
"""Shares of a spot's peak: a plateau that is clipped, or the image of a wide lamp; then what is within its blur."""

NEAR_RIM = 0.7
"""Distance from the ball's middle, over its radius, from which a highlight is an arc rather than a spot."""

NOISE_FACTOR = 8.0
"""Peak over the noise below which there is no highlight: 1e6 pixels exceed 5 by chance, the rest is margin."""

LONELY = 0.03
"""Brightness of a pixel's brightest neighbour, over its own, below which it is hot, and no light: a lens that blurs by
as little as 0.3 pixels, standard deviation, gives a neighbour 5 % of what it gives the middle."""

MOST_SPOTS = 4
"""Spots reported per image: the light, another that is on or its mirror image in something, and two to spare."""

LEAST_SHARE = 0.1
"""Brightness in sum, over the brightest spot's, below which a spot is a crumb of an arc or a reflection of a wall."""

FLUX_MARGIN_PX = 2
"""What shines this near a spot, too weakly to count for its place, counts for its brightness: a lens's blur."""


@dataclass(frozen=True)
class Spot:
    """One bright spot.

    Attributes:
        pixel: its middle.
        flux: sum of the brightness above the dark ball, per channel, pixel value x pixels.
        saturated: whether a pixel of it is clipped, so that `flux` is too small.
        distance: from the ball's middle over its radius: 1 at the rim.
    """

    pixel: Float64[np.ndarray, " 2"]
    flux: Float64[np.ndarray, " channels"]
    saturated: bool
    distance: float


def measure_spots(
    image: Float32[np.ndarray, "height width channels"],
    clipped: Bool[np.ndarray, "height width"],
    outline: Float64[np.ndarray, "points 2"],
) -> list[Spot]:
    """Bright spots within a ball's outline (pixels) in a linear image, brightest first.

    None in a dark ball.

    Near the rim a spot's middle is its average distance from the ball's middle and angle about it, not its average x
    and y: there a highlight is an arc, whose centre of mass lies inside it, and a tenth of a pixel is degrees.
    """
    low = np.maximum(np.floor(outline.min(0) - RIM_PX), 0).astype(int)
    high = np.ceil(outline.max(0) + RIM_PX).astype(int)
    crop = np.s_[low[1] : high[1], low[0] : high[0]]
    channels, within = image[crop].astype(np.float64), _ball_pixels(image[crop].shape[:2], outline - low)
    light = _above_dark(channels.mean(2), within)
    label, order = _components(light)
    if not order:
        return []
    grown = _grow(label, FLUX_MARGIN_PX)
    dark = channels[within & (grown == 0)].mean(0)
    middle = outline.mean(0)
    radius = np.linalg.norm(outline - middle, axis=1).mean()
    spots = []
    for one in order:
        rows, columns = _placing_pixels(light, label == one)
        offset = _place(np.stack([columns, rows], 1) + PIXEL_CENTER + low - middle, light[rows, columns], radius)
        flux = (channels[grown == one] - dark).sum(0)
        distance = float(np.linalg.norm(offset) / radius)
        spots.append(Spot(middle + offset, flux, bool(clipped[crop][label == one].any()), distance))
    return spots


def _placing_pixels(light: np.ndarray, spot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns: the largest piece of the spot's core if that is wide, else all of the spot."""
    peak = light[spot].max()
    for level in CORE_LEVELS:
        _, piece, sizes, _ = cv2.connectedComponentsWithStats((spot & (light > level * peak)).astype(np.uint8))
        largest = 1 + sizes[1:, cv2.CC_STAT_AREA].argmax()
        if sizes[largest, cv2.CC_STAT_AREA] >= WIDE_SPOT:
            return np.nonzero(piece == largest)
    return np.nonzero(spot)


def _place(offset: np.ndarray, weight: np.ndarray, radius: float) -> np.ndarray:
    """Weighted middle of pixels, given and returned from the ball's middle."""
    center = np.average(offset, axis=0, weights=weight)
    if np.linalg.norm(center) < NEAR_RIM * radius:
        return center
    heading = np.arctan2(center[1], center[0])
    turn = np.angle(np.exp(1j * (np.arctan2(offset[:, 1], offset[:, 0]) - heading)))
    angle = heading + np.average(turn, weights=weight)
    return np.average(np.linalg.norm(offset, axis=1), weights=weight) * np.array([np.cos(angle), np.sin(angle)])


def _ball_pixels(shape: tuple[int, int], outline: np.ndarray) -> np.ndarray:
    middle = outline.mean(0)
    reach = np.linalg.norm(outline - middle, axis=1).max()
    grown = middle + (outline - middle) * (1 + RIM_PX / reach)
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.round(grown - PIXEL_CENTER).astype(np.int32)], 1)
    return mask > 0


def _above_dark(gray: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Brightness above the dark ball, zero where it is no part of a highlight."""
    values = gray[within]
    dark = float(np.median(values))
    # One grey level of an 8-bit image is the least noise there is; images come scaled to 0 .. 1.
    noise = max(float(np.median(np.abs(values - dark))) / 0.6745, 1 / 255 / np.sqrt(12))
    light = np.where(within & ~_lonely(gray - dark, NOISE_FACTOR / 2 * noise), gray - dark, 0.0)
    peak = float(light.max())
    if peak < NOISE_FACTOR * noise:
        return np.zeros_like(light)
    return np.where(light > max(HIGHLIGHT_FLOOR * peak, NOISE_FACTOR / 2 * noise), light, 0.0)


def _lonely(light: np.ndarray, least: float) -> np.ndarray:
    """Mask of hot pixels: bright, and alone.

    Args:
        least: brightness that a neighbour can be told from darkness by.
    """
    ring = np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    return (LONELY * light > least) & (cv2.dilate(light, ring) < LONELY * light)


def _components(light: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Labels of the pixels that hang together, and the labels that shine most in sum, brightest first."""
    bright = light > 0
    # Thin arcs break into pieces: pieces one pixel apart are one highlight.
    count, label = cv2.connectedComponents(
        cv2.dilate(bright.astype(np.uint8), np.ones((3, 3), np.uint8)), connectivity=8
    )
    label = np.where(bright, label, 0)
    total = np.bincount(label.ravel(), weights=light.ravel(), minlength=count)
    order = [int(one) for one in np.argsort(-total)[:MOST_SPOTS] if total[one] > LEAST_SHARE * total.max()]
    return label, order


def _grow(label: np.ndarray, margin: int) -> np.ndarray:
    """Labels spread to all pixels within `margin`; where two meet, the larger label has it."""
    kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return cv2.dilate(label.astype(np.float32), kernel).astype(np.int64)
