"""A camera's projection with its derivatives, for bundle adjustment."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

INTRINSICS = ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""f = fx and aspect = fy / fx: pixels are nearly square, which is a prior on one number."""


def project_with_jacobian(
    intrinsics: Float64[np.ndarray, "n 9"], in_camera: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2 9"], Float64[np.ndarray, "n 2 3"]]:
    """Pixels of points in camera coordinates, and their derivatives by `INTRINSICS` and by the point."""
    f, aspect, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
    depth = in_camera[:, 2]
    x, y = in_camera[:, 0] / depth, in_camera[:, 1] / depth
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # of `radial` by r2
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fy = f * aspect
    zero, one = np.zeros_like(f), np.ones_like(f)
    by_intrinsics = np.stack([
        np.stack([xd, zero, one, zero, f * x * r2, f * x * r2**2, 2 * f * x * y, f * (r2 + 2 * x * x),
                  f * x * r2**3], 1),
        np.stack([aspect * yd, f * yd, zero, one, fy * y * r2, fy * y * r2**2, fy * (r2 + 2 * y * y), 2 * fy * x * y,
                  fy * y * r2**3], 1),
    ], 1)  # fmt: skip
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    by_xy = np.stack([
        np.stack([f * (radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x), f * cross], -1),
        np.stack([fy * cross, fy * (radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x)], -1),
    ], 1)  # fmt: skip
    by_point = np.concatenate([by_xy, -by_xy @ np.stack([x, y], -1)[..., None]], -1) / depth[:, None, None]
    return np.stack([f * xd + cx, fy * yd + cy], -1), by_intrinsics, by_point
