"""Positions of lights from their highlights in mirror balls, seen by calibrated cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError
from pipeline.calibration.lights.mirror_ball import LEAST_SIGMA_PX, Ball, reflection_derivatives, reflection_points
from pipeline.geometry.cameras import Camera, project_with_jacobian
from pipeline.geometry.least_squares import solve_least_squares

INFORMATION_PER_WEIGHT = 1.2107
"""What an observation tells under Cauchy's loss, over its weight / sigma^2, if noise is Gaussian. Of two components the
weights then average 0.7785 and the fit is 94.26 % efficient (quadrature, for `least_squares.CAUCHY`)."""


@dataclass(frozen=True)
class Highlights:
    """Highlights of lights in balls, one row per light, ball and camera.

    Indices into lists of each.
    """

    light: Int64[np.ndarray, " highlights"]
    ball: Int64[np.ndarray, " highlights"]
    camera: Int64[np.ndarray, " highlights"]
    pixel: Float64[np.ndarray, "highlights 2"]

    def select(self, chosen: np.ndarray) -> Highlights:
        """The rows that a mask or an index array names."""
        return Highlights(self.light[chosen], self.ball[chosen], self.camera[chosen], self.pixel[chosen])


@dataclass(frozen=True)
class LocatedLights:
    """Lights and balls in the cameras' frame.

    Attributes:
        position: of each light, metres.
        covariance: of all positions together, three rows per light; lights share the balls' uncertainty.
        balls: centres, which the highlights had their say in.
        residual: highlights, predicted minus measured, pixels.
        weight: of each highlight, 1 = fully counted, 0 = ignored.
        sigma_px: standard deviation of one coordinate of a highlight.
        spread: area in the image per area at the light, square to its way to the ball, pixels^2 / m^2.
    """

    position: Float64[np.ndarray, "lights 3"]
    covariance: Float64[np.ndarray, "coordinates coordinates"]
    balls: Float64[np.ndarray, "balls 3"]
    residual: Float64[np.ndarray, "highlights 2"]
    weight: Float64[np.ndarray, " highlights"]
    sigma_px: float
    spread: Float64[np.ndarray, " highlights"]

    @property
    def own_covariance(self) -> Float64[np.ndarray, "lights 3 3"]:
        """Each light's own, whatever the others are."""
        own = np.arange(len(self.position))
        return self.covariance.reshape(len(own), 3, len(own), 3)[own, :, own]


def locate_lights(
    highlights: Highlights,
    balls: Sequence[Ball],
    cameras: Sequence[Camera],
    radius_m: float,
    start: Float64[np.ndarray, "lights 3"],
) -> LocatedLights:
    """Locate all lights and all balls at once.

    From all highlights and from what the outlines said of the balls.

    Residuals are highlight pixels, not directions: near the ball's rim a pixel of error turns the mirrored ray by tens
    of degrees, and counts for as little as it should. The outlines enter as a Gaussian about each ball's centre, so
    that the covariance of a light holds the balls' uncertainty too: lights without a second ball or camera to tell the
    two apart share it. The cameras' errors are not in it.

    Raises:
        InputError: if a light has no place to start from.
    """
    centers = np.stack([ball.center for ball in balls])
    # center = centers + root z with z standard normal: a prior whose covariance the solver need not know.
    roots = np.stack([np.linalg.cholesky(ball.covariance) for ball in balls])
    split = centers.size

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return centers + np.einsum("bij,bj->bi", roots, x[:split].reshape(-1, 3)), x[split:].reshape(-1, 3)

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csr_array]:
        pixel, by_ball, by_light, _ = _project(*unpack(x), highlights, cameras, radius_m)
        values = np.concatenate([by_ball @ roots[highlights.ball], by_light], -1)
        first = np.stack([highlights.ball * 3, split + highlights.light * 3], 1)
        column = np.broadcast_to((first[:, :, None] + np.arange(3)).reshape(-1, 1, 6), values.shape)
        row = np.broadcast_to(np.arange(2 * len(values)).reshape(-1, 2, 1), values.shape)
        jacobian = scipy.sparse.csr_array((values.ravel(), (row.ravel(), column.ravel())), (2 * len(values), len(x)))
        return pixel - highlights.pixel, jacobian

    if len(lost := np.flatnonzero(~np.isfinite(start).all(1))):
        raise InputError(
            f"calibration.lights: expected highlights whose mirrored rays meet, found none that do for {len(lost)} of "
            f"{len(start)} lights; are the cameras calibrated well (verdicts_cameras.csv), and is radius_m the balls'?"
        )
    x = np.concatenate([np.zeros(split), start.ravel()])
    prior_sigma = np.concatenate([np.ones(split), np.full(start.size, np.inf)])
    solution = solve_least_squares(evaluate, x, LEAST_SIGMA_PX, x, prior_sigma)
    covariance, sigma_px = _uncertainty(*evaluate(solution.parameters), solution.weight, 1 / prior_sigma**2)
    moved, position = unpack(solution.parameters)
    spread = _project(moved, position, highlights, cameras, radius_m)[3]
    covariance = covariance[split:, split:]
    return LocatedLights(position, covariance, moved, solution.residual, solution.weight, sigma_px, spread)


def _uncertainty(
    residual: np.ndarray, jacobian: scipy.sparse.csr_array, weight: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, float]:
    """Covariance of the parameters and the noise of one component of a residual.

    Huber's (1981, section 7.6) for an M-estimator, whose noise comes from all residuals as the loss sees them: the
    median alone would take three times as many highlights to say as much.
    """
    weighted = scipy.sparse.diags_array(np.repeat(weight, 2)) @ jacobian
    told = (jacobian.T @ weighted).toarray()
    power = weight**2 * (residual**2).sum(1)
    # Of the loss's influence, weight x r, averaged over the two components: with Cauchy's weights it is weight^2.
    slope = weight**2
    variance, fitted = 0.0, len(precision)
    # Parameters that a prior holds take less than a degree of freedom each; three rounds settle how much.
    for _ in range(3):
        few = 1 + fitted / residual.size * slope.var() / slope.mean() ** 2
        variance = few**2 * power.sum() / max(residual.size - fitted, 1) * weight.mean() / slope.mean() ** 2
        variance = max(variance, LEAST_SIGMA_PX**2)
        normal = told / variance + np.diag(precision)
        fitted = np.trace(np.linalg.solve(normal, told / variance))
    return np.linalg.inv(normal), float(np.sqrt(INFORMATION_PER_WEIGHT * variance))


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


def _project(
    balls: np.ndarray, lights: np.ndarray, highlights: Highlights, cameras: Sequence[Camera], radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of highlights, their derivatives by ball and by light, and `LocatedLights.spread`."""
    eye = np.stack([camera.center for camera in cameras])[highlights.camera]
    R = np.stack([camera.R for camera in cameras])[highlights.camera]
    ball, light = balls[highlights.ball], lights[highlights.light]
    point = reflection_points(ball, radius_m, eye, light)
    by_ball, by_light = reflection_derivatives(ball, radius_m, eye, light, point)
    in_camera = np.einsum("nij,nj->ni", R, point - eye)
    pixel, by_point = _project_in_cameras(cameras, highlights.camera, in_camera)
    by_point = by_point @ R
    by_light = by_point @ by_light
    # The light's motion along its ray moves nothing, so J J^t is that of the two motions across.
    spread = np.sqrt(np.maximum(np.linalg.det(by_light @ np.swapaxes(by_light, 1, 2)), 0))
    return pixel, by_point @ by_ball, by_light, spread


def _project_in_cameras(
    cameras: Sequence[Camera], camera: np.ndarray, in_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [n, 2] and their derivatives [n, 2, 3] by points [n, 3], each in the coordinates of its own camera."""
    pixel, by_point = np.empty((len(camera), 2)), np.empty((len(camera), 2, 3))
    for lens in dict.fromkeys(each.lens for each in cameras):
        intrinsics = {c: each.intrinsics() for c, each in enumerate(cameras) if each.lens is lens}
        rows = np.flatnonzero(np.isin(camera, list(intrinsics)))
        if len(rows):
            inside = np.stack([intrinsics[c] for c in camera[rows].tolist()])
            pixel[rows], _, by_point[rows] = project_with_jacobian(lens, inside, in_camera[rows])
    return pixel, by_point
