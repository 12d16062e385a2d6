"""Measuring images of a mirror ball: its outline before a bright backdrop, and the highlight of one light in it."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.ndimage
from jaxtyping import Float32, Float64

from pipeline.base.conventions import PIXEL_CENTER

OUTLINE_POINTS = 360

LEAST_DIAMETER_PX = 16
"""Smaller discs are dust, and no probe for directions: a pixel would be 14 degrees at their centre."""

LEAST_ROUNDNESS = 0.85
"""Area over the area of the circle round it. A ball at 40 degrees off axis, an ellipse of 1 : 0.87, passes."""

EDGE_BAND = 0.06
"""Half width, over the ball's radius, of the band in which the edge is looked for; at least `EDGE_LEAST_PX`."""
EDGE_LEAST_PX = 4.0
EDGE_STEP_PX = 0.25

RIM_PX = 2.0
"""Highlights are looked for inside the outline and this far beyond it: rim highlights blur across it."""

HIGHLIGHT_FLOOR = 0.03
"""Share of the highlight's peak below which a pixel is not part of it: leaves out glow, and takes in the edge pixels
that place the rest (on captures/walker 0.1 costs 7 % and 0.2 half of the accuracy)."""

NEAR_RIM = 0.7
"""Distance from the ball's middle, over its radius, from which a highlight is an arc rather than a spot."""

NOISE_FACTOR = 8.0
"""Peak over the noise below which there is no highlight: 1e6 pixels exceed 5 by chance, the rest is margin."""


def measure_outline(gray: Float32[np.ndarray, "height width"]) -> Float64[np.ndarray, "points 2"] | None:
    """Outline of the dark ball to a fraction of a pixel (first pixel centre at (0.5, 0.5)); None if there is no ball.

    The edge is where brightness is half way between inside and outside along each ray from the middle: on a linear
    image that is unbiased, because a pixel on the edge holds its covered share.
    """
    dark = _dark_pixels(gray)
    contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    discs = [contour for contour in contours if _is_disc(contour, gray.shape)]
    if not discs:
        return None
    disc = max(discs, key=cv2.contourArea)
    inside = np.zeros(gray.shape, np.uint8)
    cv2.drawContours(inside, [disc], -1, 1, cv2.FILLED)
    level = (np.median(gray[dark == 0]) + np.median(gray[inside > 0])) / 2
    return _refine_outline(gray, disc[:, 0].astype(np.float64), float(level))


def _dark_pixels(gray: np.ndarray) -> np.ndarray:
    """255 where the image is on the dark side of Otsu's threshold, else 0."""
    top = max(float(np.percentile(gray, 99.5)), 1e-12)
    scaled = np.clip(gray / top * 255, 0, 255).astype(np.uint8)
    return cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)[1]


def _refine_outline(gray: np.ndarray, rough: np.ndarray, level: float) -> np.ndarray:
    """The edge near a rough outline (OpenCV's pixels) where brightness rises through `level`, at equal angles."""
    middle = (rough.min(0) + rough.max(0)) / 2
    offset = rough - middle
    rough_angle = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(rough_angle)
    angle = np.linspace(-np.pi, np.pi, OUTLINE_POINTS, endpoint=False)
    radius = np.interp(angle, rough_angle[order], np.linalg.norm(offset, axis=1)[order], period=2 * np.pi)
    band = max(EDGE_LEAST_PX, EDGE_BAND * float(radius.mean()))
    steps = np.arange(-band, band + EDGE_STEP_PX, EDGE_STEP_PX)
    ray = np.stack([np.cos(angle), np.sin(angle)], 1)
    x, y = np.moveaxis(middle + (radius[:, None] + steps)[..., None] * ray[:, None], -1, 0)
    profile = scipy.ndimage.map_coordinates(gray, [y, x], order=1, mode="nearest")
    in_image = ((x >= 0) & (y >= 0) & (x <= gray.shape[1] - 1) & (y <= gray.shape[0] - 1)).all(1)
    edge = radius - band + EDGE_STEP_PX * _crossing(profile, level)
    good = in_image & np.isfinite(edge)
    return middle + edge[good, None] * ray[good] + PIXEL_CENTER


def _is_disc(contour: np.ndarray, shape: tuple[int, int]) -> bool:
    x, y, width, height = cv2.boundingRect(contour)
    _, around = cv2.minEnclosingCircle(contour)
    whole = x > 0 and y > 0 and x + width < shape[1] and y + height < shape[0]
    round_enough = cv2.contourArea(contour) > LEAST_ROUNDNESS * np.pi * around**2
    return whole and min(width, height) >= LEAST_DIAMETER_PX and round_enough


def _crossing(profile: np.ndarray, level: float) -> np.ndarray:
    """First index, with its fraction, at which each row rises through `level`; NaN if it does not."""
    above = profile >= level
    rises = above[:, 1:] & ~above[:, :-1]
    first = rises.argmax(1)
    rows = np.arange(len(profile))
    low, high = profile[rows, first], profile[rows, first + 1]
    fraction = (level - low) / np.where(high > low, high - low, 1.0)
    return np.where(rises.any(1), first + fraction, np.nan)


def measure_highlight(
    gray: Float32[np.ndarray, "height width"], outline: Float64[np.ndarray, "points 2"]
) -> Float64[np.ndarray, "2"] | None:
    """Middle of the brightest highlight within the outline, pixels; None if nothing stands out of the noise.

    Near the rim the average is over distance from the ball's middle and angle about it, not over x and y: there a
    highlight is an arc, whose centre of mass lies inside it, and a tenth of a pixel is degrees.
    """
    low = np.maximum(np.floor(outline.min(0) - RIM_PX), 0).astype(int)
    high = np.ceil(outline.max(0) + RIM_PX).astype(int)
    light = _above_dark(gray[low[1] : high[1], low[0] : high[0]], outline - low)
    if light is None:
        return None
    rows, columns = _brightest_component(light)
    weight = light[rows, columns]
    middle = outline.mean(0)
    offset = np.stack([columns, rows], 1) + PIXEL_CENTER + low - middle
    center = np.average(offset, axis=0, weights=weight)
    if np.linalg.norm(center) < NEAR_RIM * np.linalg.norm(outline - middle, axis=1).mean():
        return middle + center
    heading = np.arctan2(center[1], center[0])
    turn = np.angle(np.exp(1j * (np.arctan2(offset[:, 1], offset[:, 0]) - heading)))
    angle = heading + np.average(turn, weights=weight)
    distance = np.average(np.linalg.norm(offset, axis=1), weights=weight)
    return middle + distance * np.array([np.cos(angle), np.sin(angle)])


def _above_dark(gray: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """Brightness above the dark ball, zero where it is not part of a highlight; None if there is none."""
    middle = outline.mean(0)
    reach = np.linalg.norm(outline - middle, axis=1).max()
    grown = middle + (outline - middle) * (1 + RIM_PX / reach)
    mask = np.zeros(gray.shape, np.uint8)
    cv2.fillPoly(mask, [np.round(grown - PIXEL_CENTER).astype(np.int32)], 1)
    values = gray[mask > 0]
    dark = float(np.median(values))
    # One grey level of an 8-bit image is the least noise there is; images come scaled to 0 .. 1.
    noise = max(float(np.median(np.abs(values - dark))) / 0.6745, 1 / 255 / np.sqrt(12))
    light = np.where(mask > 0, gray - dark, 0.0)
    peak = float(light.max())
    if peak < NOISE_FACTOR * noise:
        return None
    return np.where(light > max(HIGHLIGHT_FLOOR * peak, NOISE_FACTOR / 2 * noise), light, 0.0)


def _brightest_component(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels that hang together and shine most in sum."""
    bright = light > 0
    # Thin arcs break into pieces: pieces one pixel apart are one highlight.
    _, label = cv2.connectedComponents(cv2.dilate(bright.astype(np.uint8), np.ones((3, 3), np.uint8)), connectivity=8)
    label = np.where(bright, label, 0)
    total = np.bincount(label.ravel(), weights=light.ravel())
    return np.nonzero((label == total.argmax()) & bright)
