"""The outline of a mirror ball before a bright backdrop."""

from __future__ import annotations

import cv2
import numpy as np
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


def measure_outline(gray: Float32[np.ndarray, "height width"]) -> Float64[np.ndarray, "points 2"] | None:
    """Outline of the dark ball to a fraction of a pixel; None if there is no ball.

    First pixel centre at (0.5, 0.5).

    The edge is where brightness is half way between inside and outside along each ray from the middle: on a linear
    image that is unbiased, because a pixel on the edge holds its covered share.
    """
    dark = _dark_pixels(gray)
    contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    discs = [contour for contour in contours if _is_round(contour) and not _touches_border(contour, gray.shape)]
    if not discs:
        return None
    disc = max(discs, key=cv2.contourArea)
    inside = np.zeros(gray.shape, np.uint8)
    cv2.drawContours(inside, [disc], -1, 1, cv2.FILLED)
    level = (np.median(gray[dark == 0]) + np.median(gray[inside > 0])) / 2
    return _refine_outline(gray, disc[:, 0].astype(np.float64), float(level))


def why_no_ball(gray: Float32[np.ndarray, "height width"]) -> str:
    """Name what an image holds in which `measure_outline` finds no ball."""
    contours, _ = cv2.findContours(_dark_pixels(gray), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cut = any(_is_cut_disc(contour, gray.shape) for contour in contours)
    return "a ball that touches the image's border" if cut else "no round dark disc before a bright backdrop"


def _dark_pixels(gray: np.ndarray) -> np.ndarray:
    """255 where the image is on the dark side of Otsu's threshold, else 0."""
    top = max(float(np.percentile(gray, 99.5)), 1e-12)
    scaled = np.clip(gray / top * 255, 0, 255).astype(np.uint8)
    return cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)[1]


def _refine_outline(gray: np.ndarray, rough: np.ndarray, level: float) -> np.ndarray:
    """The edge near a rough outline (OpenCV's pixels) where brightness rises through `level`, at equal angles."""
    from scipy.ndimage import map_coordinates  # Here, as the review does without: it takes long to import.

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
    profile = map_coordinates(gray, [y, x], order=1, mode="nearest")
    in_image = ((x >= 0) & (y >= 0) & (x <= gray.shape[1] - 1) & (y <= gray.shape[0] - 1)).all(1)
    edge = radius - band + EDGE_STEP_PX * _crossing(profile, level)
    good = in_image & np.isfinite(edge)
    return middle + edge[good, None] * ray[good] + PIXEL_CENTER


def _is_round(contour: np.ndarray) -> bool:
    _, _, width, height = cv2.boundingRect(contour)
    _, around = cv2.minEnclosingCircle(contour)
    return min(width, height) >= LEAST_DIAMETER_PX and cv2.contourArea(contour) > LEAST_ROUNDNESS * np.pi * around**2


def _touches_border(contour: np.ndarray, shape: tuple[int, int]) -> bool:
    x, y, width, height = cv2.boundingRect(contour)
    return x == 0 or y == 0 or x + width == shape[1] or y + height == shape[0]


def _is_cut_disc(contour: np.ndarray, shape: tuple[int, int]) -> bool:
    """True if the rest of a contour that the border cuts lies on a circle of a ball's size."""
    points = contour[:, 0].astype(np.float64)
    inner = points[((points > 0) & (points < [shape[1] - 1, shape[0] - 1])).all(1)]
    if not _touches_border(contour, shape) or len(inner) < LEAST_DIAMETER_PX:
        return False
    # x^2 + y^2 = 2 a x + 2 b y + c (Kasa 1976).
    a, b, c = np.linalg.lstsq(np.c_[2 * inner, np.ones(len(inner))], (inner**2).sum(1), rcond=None)[0]
    radius = np.sqrt(max(c + a * a + b * b, 0.0))
    away = np.abs(np.hypot(inner[:, 0] - a, inner[:, 1] - b) - radius)
    return bool(2 * radius >= LEAST_DIAMETER_PX and np.percentile(away, 90) < max(EDGE_BAND * radius, 1.0))


def _crossing(profile: np.ndarray, level: float) -> np.ndarray:
    """First index, with its fraction, at which each row rises through `level`; NaN if it does not."""
    above = profile >= level
    rises = above[:, 1:] & ~above[:, :-1]
    first = rises.argmax(1)
    rows = np.arange(len(profile))
    low, high = profile[rows, first], profile[rows, first + 1]
    fraction = (level - low) / np.where(high > low, high - low, 1.0)
    return np.where(rises.any(1), first + fraction, np.nan)
