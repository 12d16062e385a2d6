"""Pixels of points, and the derivatives that are good enough for a search."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.triangulation import SMALLEST_DEPTH_M
from pipeline.tracking.cue_kernels import pinhole_derivatives


def project_nearly(
    camera: Camera, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2 3"]]:
    """Exact pixels of world points, and nearly their derivatives by the points.

    Distortion changes the derivatives by a few percent at most and is left out of them, but not a fisheye's.
    """
    if not camera.lens.perspective:
        return camera.project_with_derivative(points)
    derivative = np.empty((len(points), 2, 3))
    focal = np.ascontiguousarray(np.diag(camera.K)[:2])
    pinhole_derivatives(points, camera.R, camera.t, focal, SMALLEST_DEPTH_M, derivative)
    return camera.project(points)[0], derivative
