"""Matching bright spots in mirror balls to lights.

A light's are those that rays from all balls and cameras agree on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.calibration.lights.mirror_ball import reflected_rays
from pipeline.calibration.lights.mirror_lights import Highlights, project_highlights
from pipeline.geometry.cameras import Camera

MAX_PAIRS = 120
"""Pairs of spots tried per light. With two spots in each of 9 images, 7 pairs of 30 are both of the same light."""

AGREE_PX = 1.0
"""Distance at which a spot stops speaking for a hypothesis: many times a centroid's noise, less than its width."""

RIVAL_SHARE = 0.5
"""Images that agree on a second light, over those that agree on the first, from which nobody can say which is meant."""

FEWEST_AGREEING = 2
"""Two rays meet somewhere if they are of one light, and by chance miss each other by many pixels."""

CONSTANT_SHARE = 0.5
"""Share of a ball's images with a spot at one place from which it is no light of the stage, but a lamp or a window: two
lights of a dome show within `AGREE_PX` of each other, half of all of them never."""
FEWEST_CONSTANT = 4
"""Images of one ball and camera below which no spot is called constant."""

SMALLEST_SINE2 = 1e-6
"""Squared sine of the angle between two rays (0.06 degrees) below which where they meet says nothing."""


@dataclass(frozen=True)
class HighlightMatches:
    """At most one spot per image.

    Attributes:
        rows: of the spots that matched, in their order.
        start: metres; about where each light is.
        rival: images that agree to `AGREE_PX` on another light instead, if they are too many to decide; else 0.
    """

    rows: Int64[np.ndarray, " matched"]
    start: Float64[np.ndarray, "lights 3"]
    rival: Int64[np.ndarray, " lights"]


def match_highlights(
    spots: Highlights, balls: Float64[np.ndarray, "balls 3"], cameras: Sequence[Camera], radius_m: float, lights: int
) -> HighlightMatches:
    """Match spots to every light: the pair of its mirrored rays that most images agree with.

    They meet at the light; and the spots that agree.
    """
    points, directions = np.zeros((2, len(spots.light), 3))
    for b, c in np.unique(np.stack([spots.ball, spots.camera], 1), axis=0):
        rows = (spots.ball == b) & (spots.camera == c)
        points[rows], directions[rows] = reflected_rays(balls[b], radius_m, cameras[c], spots.pixel[rows])
    image = spots.ball * len(cameras) + spots.camera
    start, rival = np.zeros((lights, 3)), np.zeros(lights, np.int64)
    matched = []
    for light in range(lights):
        rows = np.flatnonzero(spots.light == light)
        rows = rows[np.argsort(image[rows], kind="stable")]
        candidates = _meeting_points(rows, image, points, directions)
        repeated = np.tile(rows, len(candidates))
        spread_out = np.repeat(candidates, len(rows), 0)
        offset = project_highlights(spread_out, spots.select(repeated), balls, cameras, radius_m)
        length = np.linalg.norm(offset - spots.pixel[repeated], axis=1).reshape(len(candidates), -1)
        first = np.unique(image[rows], return_index=True)[1]
        best = _most_agreed(length, first)
        start[light] = candidates[best]
        agreeing = _votes(length[best], first)
        others = np.where(length[best] < AGREE_PX, np.inf, length)
        second = _votes(others[_most_agreed(others, first)], first)
        rival[light] = second if second >= max(FEWEST_AGREEING, RIVAL_SHARE * agreeing) else 0
        ends = np.append(first[1:], len(rows))
        matched += [rows[a + length[best, a:b].argmin()] for a, b in zip(first, ends, strict=True)]
    return HighlightMatches(np.sort(np.array(matched, np.int64)), start, rival)


def constant_spots(spots: Highlights) -> Bool[np.ndarray, " highlights"]:
    """Mask of the spots that are there whichever light is on.

    At the same place in half of their ball's and camera's images.
    """
    constant = np.zeros(len(spots.light), bool)
    for b, c in np.unique(np.stack([spots.ball, spots.camera], 1), axis=0):
        rows = np.flatnonzero((spots.ball == b) & (spots.camera == c))
        near = np.linalg.norm(spots.pixel[rows, None] - spots.pixel[rows], axis=2) < AGREE_PX
        light = spots.light[rows]
        images = len(np.unique(light))
        if images >= FEWEST_CONSTANT:
            constant[rows] = [len(np.unique(light[row])) > CONSTANT_SHARE * images for row in near]
    return constant


def _meeting_points(rows: np.ndarray, image: np.ndarray, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Hypotheses [n, 3]: where pairs of rays from different images meet; never none."""
    hit = rows[np.isfinite(directions[rows]).all(1)]
    pairs = np.stack(np.triu_indices(len(hit), 1), 1)
    pairs = pairs[image[hit[pairs[:, 0]]] != image[hit[pairs[:, 1]]]]
    first, second = hit[pairs[:: 1 + len(pairs) // MAX_PAIRS]].T
    meeting = _midpoints(points[first], directions[first], points[second], directions[second])
    # Rays that meet behind the ball, or nowhere, are no hypothesis; far ahead stands for them.
    meeting = meeting[np.isfinite(meeting).all(1)]
    if len(meeting):
        return meeting
    return points[hit[:1]] + directions[hit[:1]] if len(hit) else points[:1] + 1.0


def _most_agreed(length: np.ndarray, first: np.ndarray) -> int:
    """Hypothesis whose nearest spots, one per image, are nearest in sum; none counts for more than `AGREE_PX`."""
    return int(np.minimum.reduceat(np.minimum(length / AGREE_PX, 1), first, axis=1).sum(1).argmin())


def _votes(length: np.ndarray, first: np.ndarray) -> int:
    return int((np.minimum.reduceat(length, first) < AGREE_PX).sum())


def _midpoints(point_a: np.ndarray, ray_a: np.ndarray, point_b: np.ndarray, ray_b: np.ndarray) -> np.ndarray:
    """Midpoints between pairs of rays where they are nearest; NaN where they are parallel or meet behind an origin."""
    between, cosine = point_b - point_a, (ray_a * ray_b).sum(1)
    sine2 = 1 - cosine**2
    along_a, along_b = (between * ray_a).sum(1), (between * ray_b).sum(1)
    with np.errstate(invalid="ignore", divide="ignore"):
        a = (along_a - cosine * along_b) / sine2
        b = (cosine * along_a - along_b) / sine2
        middle = (point_a + a[:, None] * ray_a + point_b + b[:, None] * ray_b) / 2
    return np.where(((sine2 > SMALLEST_SINE2) & (a > 0) & (b > 0))[:, None], middle, np.nan)
