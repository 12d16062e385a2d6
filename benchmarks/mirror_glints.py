"""Where the mirror law puts a light in an eye, in float64, and where a picture shows it: two sides to compare."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pipeline.calibration.lights.mirror_ball import reflection_points
from pipeline.eyes.eye_shape import EyeShape


class Pinhole(Protocol):
    """A camera without distortion: an image record, or a `Camera`."""

    R: np.ndarray
    t: np.ndarray
    K: np.ndarray


def glint_points(
    center: np.ndarray, axis: np.ndarray, shape: EyeShape, camera: np.ndarray, light: np.ndarray, clear: float = 0.0,
    clear_m: float = 0.0,
) -> list[np.ndarray]:  # fmt: skip
    """Where an eye mirrors a point light into a camera: on the cornea, and on the eyeball beside it; often only one.

    None at all if either sphere's own reflection is within `clear` radians of the crease, seen from the sphere's
    centre, or within `clear_m` metres along the sphere: the other sphere then shows a part of the glint.
    """
    found = []
    height = shape.radius_m * np.cos(shape.limbus_angle)
    spheres = [(0.0, shape.radius_m)] + [(shape.cornea_offset_m, shape.cornea_radius_m)] * (not shape.is_sphere)
    for offset, radius in spheres:
        middle = center + offset * axis
        point = reflection_points(middle[None], radius, camera[None], light[None])[0]
        normal = (point - middle) / radius
        lit = normal @ (camera - point) > 0 and normal @ (light - point) > 0
        from_crease = np.arccos((height - offset) / radius) - np.arccos(np.clip(normal @ axis, -1, 1))
        if lit and not shape.is_sphere and abs(from_crease) < max(clear, clear_m / radius):
            return []
        if lit and (shape.is_sphere or (from_crease > 0) == (offset > 0)):
            found.append(point)
    return found


def project(image: Pinhole, point: np.ndarray) -> np.ndarray:
    """Pixel coordinates of a world point; the first pixel's centre is (0.5, 0.5)."""
    x = image.K @ (image.R @ point + image.t)
    return x[:2] / x[2]


def centroid(picture: np.ndarray, near: np.ndarray, within: float) -> np.ndarray:
    """Centre of gravity of what is brighter than a tenth of the peak within some pixels of a point."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    weight = np.where(np.hypot(x - near[0], y - near[1]) < within, picture, 0.0)
    weight = np.where(weight > 0.1 * weight.max(), weight, 0.0)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
