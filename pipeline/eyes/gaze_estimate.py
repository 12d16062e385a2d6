"""Gaze from pixels: the direction about which an eye is dark in the middle, bright around.

What an eye shows depends on the angle from its axis: pupil, iris, white. That profile is the same in all frames of an
eye, and pictures differ by a factor. A direction is judged by how much of the pixels' variation the profile about it
explains. The profile starts as a dark disc as large as a cornea, and is then read off the pixels. What is found is the
axis of the eye, which is 5 degrees off the line of sight in people; where people say how they looked, that differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from pipeline.eyes.eye_pixels import EyePixels, meet_sphere
from pipeline.eyes.eye_shape import EyeShape

Status = Literal["estimated", "hidden", "unclear"]

WIDEST_DEG, COARSE_DEG = 50.0, 2.5
"""Directions that are tried first: no eye turns further, and an iris is ten times as wide as their distance."""

FINE = ((2.5, 0.5), (0.5, 0.1))
"""Reach and step, degrees, of the grids around the best direction so far."""

BIN_DEG, LAST_DEG = 3.0, 60.0
"""Width of a bin of the profile, and the angle from which on an eye is all white."""

DARK = 0.3
"""Brightness of an iris over that of the white around it, to begin with: between a black and a pale one."""

START = 0.75
"""Radius of the dark disc of the first profile over the cornea's: smaller than any iris, it comes to lie inside of one
and not half on a lid."""

WHITE = 75.0
"""Percentile of a picture's pixels that no pixel counts as brighter than: glints count as white."""

ROUNDS = 3
"""Times that directions are found, with the profile read off anew in between."""

FOREIGN = 0.5
"""Distance of a colour from the profile, over the white's, beyond which all are alike: what is so far off belongs to no
eye, such as a lid where the template has none, and must not draw the iris to it."""

LEAST_EXPLAINED = 0.4
"""Share of what is not white below which pixels show no iris: on the procedural head open eyes have 0.64 to 0.87, in
images three times as fine, in which glints do not blur with the iris, 0.45 to 0.63. Of patches of its skin that are as
dark as an iris, mouths have up to 0.34 and brows up to 0.44: one of 30 brows is taken for an eye
(`benchmarks/bench_gaze.py`)."""

PALEST = 0.55
"""Median brightness within a start's disc, over the white's, above which there is no iris: skin that darkens towards an
edge, where the profile learns a slope. On the procedural head open eyes have 0.20 to 0.41, a cheek 0.64 to 0.75; a pale
iris of half the white's brightness, with its black pupil, has less than that half."""

LEAST_VIEWS = 2
"""Pictures that have to show an eye: one alone cannot tell what it shows from what lies on the eye."""

SMALLEST_SIGMA_DEG = 0.05
"""Half of the last step between directions."""


@dataclass(frozen=True)
class GazeEstimate:
    """Estimate of where one eye looks in one frame.

    Attributes:
        status: "hidden": too few pixels show it, as behind closed lids; "unclear": they show no iris. Both leave the
            gaze undefined.
        direction: unit direction in the head's frame; NaN if undefined.
        sigma_deg: standard deviation of each of its two angles, by leaving out one picture after the other.
        explained: share of what is not white in the pixels that the profile explains.
        views, pixels: how many show the eye.
    """

    status: Status
    direction: Float64[np.ndarray, "3"]
    sigma_deg: float
    explained: float
    views: int
    pixels: int


def estimate_gaze(frames: Sequence[EyePixels], shape: EyeShape) -> list[GazeEstimate]:
    """Estimate where one eye looks in each of some fully lit frames.

    Args:
        frames: its pixels in each; none at all are a hidden eye.
        shape: of the eye, metres.
    """
    shown = {number: _Shown(pixels, shape) for number, pixels in enumerate(frames) if views_of(pixels) >= LEAST_VIEWS}
    dark = np.arange(0, LAST_DEG, BIN_DEG) < START * np.degrees(shape.limbus_angle)
    profile = np.repeat(np.where(dark, DARK, 1.0)[:, None], 3, 1)
    found: dict[int, np.ndarray] = {}
    if shown:
        ahead = np.mean([each.middle for each in shown.values()], axis=0)
        tried = grid_around(ahead, WIDEST_DEG, COARSE_DEG)
        found = {number: each.best(tried, profile) for number, each in shown.items()}
    for number in range(ROUNDS):
        found = {frame: each.refined(found[frame], profile) for frame, each in shown.items()}
        if shown and number < ROUNDS - 1:
            profile = read_profile([shown[frame].seen_about(found[frame]) for frame in shown], profile)
    return [
        shown[number].judged(found[number], profile, len(pixels)) if number in shown
        else GazeEstimate("hidden", np.full(3, np.nan), np.nan, 0.0, views_of(pixels), len(pixels))
        for number, pixels in enumerate(frames)
    ]  # fmt: skip


def views_of(pixels: EyePixels) -> int:
    """Number of pictures that show the eye."""
    return int(pixels.view[-1]) + 1 if len(pixels) else 0


def grid_around(
    middle: Float64[np.ndarray, "3"], reach_deg: float, step_deg: float
) -> Float64[np.ndarray, "directions 3"]:
    """Unit directions up to an angle from a middle one, which comes first.

    On a square grid of its tangent plane.
    """
    ahead = middle / np.linalg.norm(middle)
    side = np.linalg.svd(ahead[None])[2][1:]
    steps = np.arange(1, int(reach_deg / step_deg + 1e-9) + 1) * np.radians(step_deg)
    steps = np.concatenate([[0.0], steps, -steps])
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    angle = np.hypot(x, y)
    x, y, angle = (a[angle <= np.radians(reach_deg) + 1e-9] for a in (x, y, angle))
    share = np.sinc(angle / np.pi)[:, None]  # sin(angle) / angle
    return np.cos(angle)[:, None] * ahead + share * (x[:, None] * side[0] + y[:, None] * side[1])


def read_profile(
    seen: Sequence[tuple[np.ndarray, np.ndarray]], before: Float64[np.ndarray, "bins 3"]
) -> Float64[np.ndarray, "bins 3"]:
    """Median colour by angle from the axis, over the white's; as before where nothing was seen.

    Args:
        seen: of each frame, angles in degrees and colours over the white's.
    """
    angles, colors = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    number = np.minimum(np.round(angles / BIN_DEG).astype(np.int64), len(before) - 1)
    return np.array(
        [np.median(colors[number == k], 0) if (number == k).any() else before[k] for k in range(len(before))]
    )


class _Shown:
    """Pixels of one frame, whose colours are divided by each picture's white."""

    def __init__(self, pixels: EyePixels, shape: EyeShape) -> None:
        self.pixels, self.shape = pixels, shape
        self.rows = [np.flatnonzero(pixels.view == view) for view in range(views_of(pixels))]
        self.colors = np.ones((len(pixels), 3))
        for rows in self.rows:
            white = np.percentile(pixels.colors[rows], WHITE, axis=0)
            # Black pictures tell nothing, and count as white.
            self.colors[rows] = np.divide(pixels.colors[rows], white, out=np.ones((len(rows), 3)), where=white > 0)
        self.ball = meet_sphere(pixels.origins, pixels.directions, shape.radius_m)[0]
        hits = (pixels.origins + self.ball[:, None] * pixels.directions).mean(0)
        self.middle = hits / np.linalg.norm(hits)

    def angles(self, axes: np.ndarray) -> Float64[np.ndarray, "axes pixels"]:
        """Angles, degrees, between axes and what the pixels show, seen from the eye's centre."""
        origins, ways = self.pixels.origins, self.pixels.directions
        square, along = (origins * origins).sum(1), (origins * ways).sum(1)
        origin_axis, way_axis = axes @ origins.T, axes @ ways.T
        # The cornea's sphere about d g: |o - d g|^2 and (o - d g) . w.
        d = self.shape.cornea_offset_m
        middle = along - d * way_axis
        root = self.shape.cornea_radius_m**2 - (square - 2 * d * origin_axis + d * d) + middle**2
        cornea = np.where(root > 0, -middle - np.sqrt(np.maximum(root, 0)), np.inf)
        at = np.minimum(cornea, self.ball)
        length = np.sqrt(square + 2 * at * along + at**2)
        return np.degrees(np.arccos(np.clip((origin_axis + at * way_axis) / length, -1, 1)))

    def residuals(self, axes: np.ndarray, profile: np.ndarray) -> Float64[np.ndarray, "views axes"]:
        """Sums, by picture, of what the profile about each axis leaves, squared and cut at `FOREIGN`."""
        difference = np.minimum(self.colors, 1.0) - looked_up(profile, self.angles(axes))
        left = np.minimum((difference**2).sum(-1), FOREIGN**2)
        return np.stack([left[:, rows].sum(1) for rows in self.rows])

    def best(self, axes: np.ndarray, profile: np.ndarray) -> np.ndarray:
        """The axis whose profile leaves least."""
        return axes[self.residuals(axes, profile).sum(0).argmin()]

    def refined(self, axis: np.ndarray, profile: np.ndarray) -> np.ndarray:
        """The best axis near one, on finer and finer grids."""
        for reach, step in FINE:
            axis = self.best(grid_around(axis, reach, step), profile)
        return axis

    def seen_about(self, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles from an axis, and the colours there over the white's."""
        return self.angles(axis[None])[0], np.minimum(self.colors, 1.0)

    def brightness_about(self, axis: np.ndarray) -> float:
        """Median brightness of what shows of an iris about an axis, over the white's; that of white if nothing does."""
        angles, colors = self.seen_about(axis)
        middle = colors[angles < START * np.degrees(self.shape.limbus_angle)]
        return float(np.median(middle)) if len(middle) else 1.0

    def judged(self, axis: np.ndarray, profile: np.ndarray, pixels: int) -> GazeEstimate:
        """The estimate of an axis: whether it is one, and how well it is known."""
        tried = grid_around(axis, *FINE[0])
        left = self.residuals(tried, profile)
        plain = np.minimum(((np.minimum(self.colors, 1.0) - 1.0) ** 2).sum(1), FOREIGN**2).sum()
        explained = float(1 - left[:, 0].sum() / plain) if plain > 0 else 0.0
        if explained < LEAST_EXPLAINED or self.brightness_about(axis) > PALEST:
            return GazeEstimate("unclear", np.full(3, np.nan), np.nan, explained, len(self.rows), pixels)
        without = tried[(left.sum(0) - left).argmin(1)]
        moved = np.degrees(np.linalg.norm(without - axis, axis=1))
        # The jackknife, shared out over two angles.
        sigma = float(np.sqrt((len(left) - 1) / len(left) * (moved**2).sum() / 2))
        return GazeEstimate("estimated", axis, max(sigma, SMALLEST_SIGMA_DEG), explained, len(self.rows), pixels)


def looked_up(profile: Float64[np.ndarray, "bins 3"], angles: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n 3"]:
    """The profile at angles in degrees, linear between its bins."""
    place = np.minimum(angles / BIN_DEG, len(profile) - 1 - 1e-9)
    low = place.astype(np.int64)
    share = (place - low)[..., None]
    return profile[low] * (1 - share) + profile[low + 1] * share
