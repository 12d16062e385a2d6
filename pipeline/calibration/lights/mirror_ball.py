"""A mirror ball of known radius: where it is, and where a light shows in it.

The outline of a sphere fills a circular cone: every ray of the outline makes the angle asin(radius / distance) with
the ray to the centre. A light at L shows where the surface normal halves the angle between the directions to the
camera and to the light: Alhazen's problem, solved here by bisection in the plane of centre, camera and light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats
from jaxtyping import Float64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.least_squares import solve_least_squares

LEAST_SIGMA_PX = 1e-3
"""Outlines and highlights are never better known than this."""

LEAST_FACING = 1e-6
"""Sum of the cosines to camera and light that counts as grazing: a highlight is then 1e-6 as wide as in the middle."""

BISECTIONS = 52
"""Halvings of an angle below pi: down to the last bit of a double."""


DISAGREE_LEVEL = 0.01
"""Chance at which outlines that are as good as they seem are taken to disagree: with 20 balls, one in five rigs has a
ball whose covariance is a little too large."""


@dataclass(frozen=True)
class Ball:
    """A located ball.

    Attributes:
        center: metres.
        covariance: of the centre, widened where the cameras disagree.
        rms_px: outline residual, root mean square.
        disagreement: what one camera's outline says about the centre against what all say, in standard deviations
            (root mean square; 1 where the outlines' own noise is all there is, or only one camera looks).
    """

    center: Float64[np.ndarray, " 3"]
    covariance: Float64[np.ndarray, "3 3"]
    rms_px: float
    disagreement: float


def locate_ball(
    cameras: Sequence[Camera], outlines: Sequence[Float64[np.ndarray, "_ 2"]], radius_m: float
) -> Ball:  # fmt: skip
    """Centre of a sphere from its outlines (pixels) in one or more cameras, jointly.

    The cameras' own errors, and a wrong radius, show as outlines that say different things about the centre, each more
    surely than it should: the covariance is multiplied by chi^2 per degree of freedom (Birge 1932) where that is too
    large for chance.
    """
    center, covariance, rms_px = _fit_outlines(cameras, outlines, radius_m)
    chi2, freedom = 0.0, 3 * (len(cameras) - 1)
    for camera, outline in zip(cameras, outlines, strict=True) if freedom else ():
        alone, uncertain, _ = _fit_outlines([camera], [outline], radius_m)
        chi2 += (alone - center) @ np.linalg.solve(uncertain, alone - center)
    ratio = chi2 / freedom if freedom and scipy.stats.chi2.sf(chi2, freedom) < DISAGREE_LEVEL else 1.0
    return Ball(center, ratio * covariance, rms_px, float(np.sqrt(ratio)))


def outline_cone(
    camera: Camera, outline: Float64[np.ndarray, "_ 2"]
) -> tuple[Float64[np.ndarray, " 3"], float]:  # fmt: skip
    """Axis (unit) and half angle (radians) of the cone of rays through an outline (pixels)."""
    # The plane that cuts the cone: ray . axis = cos(half angle) for all rays.
    axis = np.linalg.lstsq(rays := camera.ray_directions(outline), np.ones(len(rays)), rcond=None)[0]
    length = np.linalg.norm(axis)
    return axis / length, float(np.arccos(min(1 / length, 1.0)))


def _fit_outlines(
    cameras: Sequence[Camera], outlines: Sequence[np.ndarray], radius_m: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre, its covariance and the residual in pixels."""
    rays = [camera.ray_directions(outline) for camera, outline in zip(cameras, outlines, strict=True)]
    cones = [outline_cone(camera, outline) for camera, outline in zip(cameras, outlines, strict=True)]
    starts = [c.center + axis * radius_m / np.sin(half) for c, (axis, half) in zip(cameras, cones, strict=True)]
    origin = np.concatenate([np.tile(c.center, (len(r), 1)) for c, r in zip(cameras, rays, strict=True)])
    focal = np.concatenate([np.full(len(r), c.K[0, 0]) for c, r in zip(cameras, rays, strict=True)])
    ray = np.concatenate(rays)

    def evaluate(center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        toward = center - origin
        distance = np.linalg.norm(toward, axis=1)
        axis = toward / distance[:, None]
        cosine, sine = (ray * axis).sum(1), np.linalg.norm(np.cross(ray, axis), axis=1)
        # Inside the ball there is no outline: the residual saturates and the step is refused.
        ratio = np.minimum(radius_m / distance, 1 - 1e-9)
        residual = np.arctan2(sine, cosine) - np.arcsin(ratio)
        by_angle = -(ray - cosine[:, None] * axis) / np.maximum(sine, 1e-12)[:, None] / distance[:, None]
        by_ratio = (ratio / np.sqrt(1 - ratio**2) / distance)[:, None] * axis
        return (focal * residual)[:, None], focal[:, None] * (by_angle + by_ratio)

    solution = solve_least_squares(evaluate, np.mean(starts, 0), LEAST_SIGMA_PX)
    return solution.parameters, solution.covariance, float(np.sqrt(np.mean(solution.residual**2)))


def reflection_points(
    ball: Float64[np.ndarray, "n 3"],
    radius_m: float,
    camera: Float64[np.ndarray, "n 3"],
    light: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n 3"]:
    """Points of spheres where a camera sees the mirror image of a light.

    The spheres are at `ball`; camera and light are outside.
    """
    to_camera, to_light = camera - ball, light - ball
    u = to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
    across = to_light - (to_light * u).sum(1, keepdims=True) * u
    length = np.linalg.norm(across, axis=1, keepdims=True)
    # Camera, light and centre on one line: any plane will do, the highlight is at u.
    v = across / np.where(length > 0, length, 1.0)
    distance, light_u, light_v = np.linalg.norm(to_camera, axis=1), (to_light * u).sum(1), length[:, 0]
    low, high = np.zeros(len(u)), np.arctan2(light_v, light_u)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        cosine, sine = np.cos(middle), np.sin(middle)
        # Signed angles from the normal: to the camera (clockwise) and to the light (counterclockwise).
        angle_c = np.arctan2(distance * sine, distance * cosine - radius_m)
        angle_l = np.arctan2(cosine * light_v - sine * light_u, light_u * cosine + light_v * sine - radius_m)
        too_near_camera = angle_c < angle_l
        low, high = np.where(too_near_camera, middle, low), np.where(too_near_camera, high, middle)
    angle = ((low + high) / 2)[:, None]
    return ball + radius_m * (np.cos(angle) * u + np.sin(angle) * v)


def reflection_derivatives(
    ball: Float64[np.ndarray, "n 3"],
    radius_m: float,
    camera: Float64[np.ndarray, "n 3"],
    light: Float64[np.ndarray, "n 3"],
    point: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], Float64[np.ndarray, "n 3 3"]]:
    """Derivatives of `reflection_points` by the ball's centre and by the light.

    At `point`, which it gave.

    In a basis T of the tangent plane the unit vectors c to the camera and l to the light obey T^t (c + l) = 0, and
    c + l = g n. By the implicit function theorem a turn of the normal, dn = T da, that answers motions db and dl is
    (radius T^t (C + L) T + g) da = T^t (L dl - (C + L) db), with C = (1 - c c^t) / distance, and L alike.
    """
    normal = (point - ball) / radius_m
    sideways = np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)])
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    T = np.stack([sideways, np.cross(normal, sideways)], -1)
    T_t = np.swapaxes(T, 1, 2)
    C, toward_camera = _turning(camera - point)
    L, toward_light = _turning(light - point)
    # Not positive only in the ball's shadow, where there is no highlight: steps that start there stay finite.
    g = np.maximum(((toward_camera + toward_light) * normal).sum(1), LEAST_FACING)
    left = radius_m * T_t @ (C + L) @ T + g[:, None, None] * np.eye(2)
    by_light = radius_m * T @ np.linalg.solve(left, T_t @ L)
    by_ball = np.eye(3) - radius_m * T @ np.linalg.solve(left, T_t @ (C + L))
    return by_ball, by_light


def _turning(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of the unit vector along each offset by the offset, and the unit vectors."""
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    unit = offset / distance
    return (np.eye(3) - unit[:, :, None] * unit[:, None]) / distance[..., None], unit


def reflected_rays(
    ball: Float64[np.ndarray, "3"], radius_m: float, camera: Camera, pixels: Float64[np.ndarray, "n 2"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Points on the ball seen at `pixels`, and unit directions in which they mirror.

    NaN where a ray misses the ball.
    """
    ray = camera.ray_directions(pixels)
    toward = ball - camera.center
    along = ray @ toward
    below_root = along**2 - toward @ toward + radius_m**2
    with np.errstate(invalid="ignore"):
        points = camera.center + (along - np.sqrt(below_root))[:, None] * ray
    normal = (points - ball) / radius_m
    return points, ray - 2 * (ray * normal).sum(1, keepdims=True) * normal
