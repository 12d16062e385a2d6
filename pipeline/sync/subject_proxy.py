"""Expected brightness of the subject in each camera under each LED, by a matte ellipsoid.

The ellipsoid stands in for the subject; it is what the masks say on average: its centre is where the rays through their
middles meet, its axes follow from how far they spread. Its brightness under a near light is integrated over its
surface, so a light behind the subject as a camera sees it counts little, which a sum of I / d^2 at the centre cannot
say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh import unit_or

SURFACE_POINTS = 512
"""Points of the surface that are summed over: a Lambert sphere's brightness is then right to 1 % at any phase angle up
to 120 degrees, a tenth of what a real body differs from an ellipsoid."""

THINNEST = 0.2
"""Semi-axes of a subject are no shorter than this share of the longest: too few cameras leave one open. The bodies at
hand have 0.22 and 0.25."""

WITHOUT_MASKS_M = 0.01
"""Radius of the sphere that stands in where there are no masks to measure: small, a point with a shape."""

BOUNCED = 0.05
"""Share of the light that reaches a camera by way of other surfaces, from wherever the lamp is. Without it the dark
side of the subject is too dark: with 0 to 0.1 the residuals of two path-traced captures are smallest."""


@dataclass(frozen=True)
class Ellipsoid:
    """Centre and, as columns, semi-axes, metres, world."""

    center: Float64[np.ndarray, " 3"]
    axes: Float64[np.ndarray, "3 3"]


def subject_center(
    cameras: Mapping[str, Camera], pixels: Mapping[str, Float64[np.ndarray, " 2"]]
) -> Float64[np.ndarray, " 3"]:
    """The point nearest to the rays through one pixel per camera (least squares), metres, world."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for name, pixel in pixels.items():
        direction = cameras[name].ray_directions(np.asarray(pixel)[None])[0]
        across = np.eye(3) - np.outer(direction, direction)
        normal, right = normal + across, right + across @ cameras[name].center
    # The minimum-norm solution: a single camera, or parallel ones, leave the distance open.
    return np.linalg.lstsq(normal, right, rcond=None)[0]


def fit_ellipsoid(
    cameras: Mapping[str, Camera],
    pixels: Mapping[str, Float64[np.ndarray, " 2"]],
    covariances: Mapping[str, Float64[np.ndarray, "2 2"]],
) -> Ellipsoid:
    """The ellipsoid whose silhouettes spread as the masks do.

    A filled ellipse with the semi-axes' matrix A has the covariance A / 4, and under weak perspective (J: pixels per
    metre) the silhouette of the ellipsoid S is J S J^T, so S follows from linear equations, three per camera.

    Args:
        cameras: of the images' resolution.
        pixels: mean of each camera's masks.
        covariances: of the pixels of each camera's masks, pixels^2; cameras with NaN are left out.
    """
    center = subject_center(cameras, pixels)
    rows, spreads = [], []
    for name, covariance in covariances.items():
        camera = cameras[name]
        if not np.isfinite(covariance).all():
            continue
        jacobian = camera.K[:2, :2] @ camera.R[:2] / (camera.R @ center + camera.t)[2]
        for i, j in ((0, 0), (0, 1), (1, 1)):
            product = np.outer(jacobian[i], jacobian[j])
            rows.append((product + product.T).ravel() / 2)  # symmetric, so the solution of least norm is
            spreads.append(4 * covariance[i, j])
    if not rows:
        return Ellipsoid(center, WITHOUT_MASKS_M * np.eye(3))
    shape = np.linalg.lstsq(np.array(rows), np.array(spreads), rcond=None)[0].reshape(3, 3)
    squares, directions = np.linalg.eigh(shape)
    lengths = np.sqrt(np.maximum(squares, max(squares[-1] * THINNEST**2, WITHOUT_MASKS_M**2)))
    return Ellipsoid(center, directions * lengths)


def shading_response(
    subject: Ellipsoid, lights: Float64[np.ndarray, "lights 3"], cameras: Float64[np.ndarray, "cameras 3"]
) -> Float64[np.ndarray, "cameras lights"]:
    """Mean irradiance per radiant intensity, 1/m^2, over what a camera sees of the subject.

    Args:
        lights, cameras: positions, metres, world.
    """
    unit = _sphere_points(SURFACE_POINTS)
    points = subject.center + unit @ subject.axes.T
    # A surface element of the sphere, n dA, becomes cofactor(axes) n dA, along inverse(axes)^T n.
    area = unit @ np.linalg.inv(subject.axes)
    normals = unit_or(area, 0.0)
    to_camera = unit_or(cameras[:, None] - points, 0.0)
    seen = np.maximum((to_camera * normals).sum(-1), 0) * np.linalg.norm(area, axis=1)
    response = np.empty((len(cameras), len(lights)))
    for index, light in enumerate(lights):
        offset = light - points
        squared = (offset**2).sum(-1)
        irradiance = np.maximum((offset * normals).sum(-1), 0) / (squared * np.sqrt(squared))
        response[:, index] = seen @ irradiance
    response /= seen.sum(1, keepdims=True)
    return (1 - BOUNCED) * response + BOUNCED * response.mean(0)


def _sphere_points(count: int) -> np.ndarray:
    """Points [count, 3] spread evenly over the unit sphere (Fibonacci's lattice)."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    around, azimuth = np.sqrt(1 - height**2), np.pi * (1 + np.sqrt(5)) * index
    return np.stack([around * np.cos(azimuth), height, around * np.sin(azimuth)], 1)
