"""Positions of lights from their highlights in mirror balls, seen by calibrated cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.least_squares import Solution, solve_least_squares
from pipeline.geometry.mirror_ball import LEAST_SIGMA_PX, reflected_rays, reflection_points

MAX_PAIRS = 60
"""Pairs of highlights tried per light. A third of wrong ones leaves 4 pairs of 9 clean: a handful would do."""

AGREE_PX = 1.0
"""Distance at which a highlight stops speaking for a hypothesis: many times a centroid's noise, less than its width."""

SMALLEST_SINE2 = 1e-6
"""Squared sine of the angle between two rays (0.06 degrees) below which where they meet says nothing."""

STEP_M = 1e-5
"""Step of the central difference for the highlight's derivative by the light: truncation (STEP_M / distance)^2 = 1e-10,
rounding 1e-16 / 1e-5 = 1e-11, both relative."""


@dataclass(frozen=True)
class Highlights:
    """Where lights show in balls; one row per light, ball and camera, indices into lists of each."""

    light: Int64[np.ndarray, " highlights"]
    ball: Int64[np.ndarray, " highlights"]
    camera: Int64[np.ndarray, " highlights"]
    pixel: Float64[np.ndarray, "highlights 2"]

    def select(self, chosen: np.ndarray) -> Highlights:
        """The rows that a mask or an index array names."""
        return Highlights(self.light[chosen], self.ball[chosen], self.camera[chosen], self.pixel[chosen])


def locate_lights(
    highlights: Highlights,
    balls: Float64[np.ndarray, "balls 3"],
    cameras: Sequence[Camera],
    radius_m: float,
    lights: int,
) -> Solution:
    """All lights at once, from all their highlights; every light needs two.

    Residuals are highlight pixels, not directions: near the ball's rim a pixel of error turns the mirrored ray by tens
    of degrees, and counts for as little as it should. Parameters of the solution: x, y, z of each light.
    """
    start = _start_lights(highlights, balls, cameras, radius_m, lights)

    def project(light: np.ndarray) -> np.ndarray:
        return project_highlights(light, highlights, balls, cameras, radius_m)

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csr_array]:
        position = x.reshape(-1, 3)[highlights.light]
        ends = [(project(position + step), project(position - step)) for step in STEP_M * np.eye(3)]
        slopes = [(forward - backward) / (2 * STEP_M) for forward, backward in ends]
        values = np.stack(slopes, -1)
        columns = np.broadcast_to((highlights.light[:, None] * 3 + np.arange(3))[:, None], values.shape)
        rows = np.broadcast_to(np.arange(values[..., 0].size).reshape(-1, 2, 1), values.shape)
        jacobian = scipy.sparse.csr_array((values.ravel(), (rows.ravel(), columns.ravel())), (2 * len(values), len(x)))
        return project(position) - highlights.pixel, jacobian

    return solve_least_squares(evaluate, start.ravel(), LEAST_SIGMA_PX)


def project_highlights(
    lights: Float64[np.ndarray, "highlights 3"],
    highlights: Highlights,
    balls: Float64[np.ndarray, "balls 3"],
    cameras: Sequence[Camera],
    radius_m: float,
) -> Float64[np.ndarray, "highlights 2"]:
    """Pixels at which the lights show in the ball and camera of each row of `highlights`."""
    centers = np.stack([camera.center for camera in cameras])[highlights.camera]
    seen = reflection_points(balls[highlights.ball], radius_m, centers, lights)
    pixels = np.empty((len(seen), 2))
    for c, camera in enumerate(cameras):
        rows = highlights.camera == c
        pixels[rows] = camera.project(seen[rows])[0]
    return pixels


def _start_lights(
    highlights: Highlights, balls: np.ndarray, cameras: Sequence[Camera], radius_m: float, lights: int
) -> np.ndarray:
    """For each light, where two of its mirrored rays meet: the pair that most of its highlights agree with."""
    points, directions = np.zeros((2, len(highlights.light), 3))
    for b, c in np.unique(np.stack([highlights.ball, highlights.camera], 1), axis=0):
        rows = (highlights.ball == b) & (highlights.camera == c)
        points[rows], directions[rows] = reflected_rays(balls[b], radius_m, cameras[c], highlights.pixel[rows])
    start = np.zeros((lights, 3))
    for light in range(lights):
        rows = np.flatnonzero(highlights.light == light)
        hit = rows[np.isfinite(directions[rows]).all(1)]
        pairs = np.stack(np.triu_indices(len(hit), 1), 1)
        first, second = hit[pairs[:: 1 + len(pairs) // MAX_PAIRS]].T
        meeting = _midpoints(points[first], directions[first], points[second], directions[second])
        # Rays that meet behind the ball, or nowhere, are no hypothesis; far ahead stands for them.
        meeting = meeting[np.isfinite(meeting).all(1)]
        candidates = meeting if len(meeting) else points[hit[:1]] + directions[hit[:1]]
        repeated = np.tile(rows, len(candidates))
        residual = project_highlights(
            np.repeat(candidates, len(rows), 0), highlights.select(repeated), balls, cameras, radius_m
        )
        length = np.linalg.norm(residual - highlights.pixel[repeated], axis=1).reshape(len(candidates), -1)
        start[light] = candidates[np.minimum(length / AGREE_PX, 1).sum(1).argmin()]
    return start


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
