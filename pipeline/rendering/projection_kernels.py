"""Projection of Gaussians to footprints, one Gaussian at a time in float64.

Its backward pass is in `projection_gradient_kernels`.

Scalar code costs the same in either precision, and float64 removes what float32 cannot do for needles: at 3,000 px
``c_xx c_yy - c_xy^2`` has lost all its digits. The determinant still comes from the factor M = J R V diag(s), by
Cauchy-Binet: det(M M^T) = |m|^2, where m = a x b for the rows a, b of M. The component m_k is the product of the two
other scales times the k-th component, in the Gaussian's frame, of the cross product of the rows of J R, so it is a
product without cancellation also when M is close to rank 1.

A footprint is stored so that a row of pixels is one linear function, squared:
    q = h^2 + e^2,   h = d_y / sqrt(c_yy),   e = (x - x_row) sqrt(c_yy / det),   x_row = c_x + (c_xy / c_yy) d_y,
the completed square of d^T covariance^-1 d. It is a sum of two squares of moderate numbers, where the usual conic
subtracts numbers that, for needles, are 1e6 times larger than their difference.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.rendering.splat_conventions import FRUSTUM_MARGIN, MIN_ALPHA, MIN_QUATERNION_NORM

TILE = 16
"""Side of a tile in pixels; one row of it is one 512-bit vector of float32."""

# Columns of a footprint [g, 8] float64: px, px, 1/px, 1, 1/px, 1, 1, px. e grows by STEP, sqrt(c_yy / det), per pixel.
CENTER_X, CENTER_Y, INV_STD_Y, SHEAR, STEP, OPACITY, MAX_Q, EXTENT_Y = range(8)
FOOTPRINT_COLUMNS = 8

# Columns of the moments that the blending kernels sum per (Gaussian, tile): of g = dL/dq with 1, e, e^2, h, e h, h^2.
SUM_G, SUM_GE, SUM_GEE, SUM_GH, SUM_GEH, SUM_GHH = range(6)
MOMENT_COLUMNS = 6

EXTENT_SLACK = 1e-5
"""Added to the largest q of a footprint, relative and absolute. q <= 11.1 and float32 rounding moves alpha by less than
2e-6 relative, so no pixel with alpha >= MIN_ALPHA is left outside; its alpha alone decides whether it is drawn."""


@kernel_part()
def dot(a, b):
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel_part()
def cross(a, b):
    """Vector product of two triples."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel_part()
def combine(s, a, t, b):
    """s a + t b."""
    return (s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2])


@kernel_part()
def times(a, b):
    """Elementwise product."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@kernel_part()
def read_row(matrix, i):
    """Three numbers in float64; numba's `float` would leave a float32 what it is."""
    return (np.float64(matrix[i, 0]), np.float64(matrix[i, 1]), np.float64(matrix[i, 2]))


@kernel_part()
def unit_quaternion(quaternions, g):
    """(w, x, y, z) of length 1, and the length it had. No rotation and length 0 for what is too short."""
    w, x = np.float64(quaternions[g, 0]), np.float64(quaternions[g, 1])
    y, z = np.float64(quaternions[g, 2]), np.float64(quaternions[g, 3])
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if norm <= MIN_QUATERNION_NORM:
        return (1.0, 0.0, 0.0, 0.0), 0.0
    return (w / norm, x / norm, y / norm, z / norm), norm


@kernel_part()
def rotation_columns(q):
    """Columns of the rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@kernel_part()
def clamped_slope(slope, focal, principal, size):
    """The slope (x/z or y/z) where J is evaluated, and whether it is the mean's own."""
    margin = FRUSTUM_MARGIN * 0.5 * size / focal
    low, high = -principal / focal - margin, (size - principal) / focal + margin
    if slope < low:
        return low, False
    if slope > high:
        return high, False
    return slope, True


@kernel_part()
def jacobian_times_rotation(R, focal, slope_x, slope_y, depth):
    """Rows of J R, in px per metre of world."""
    forward = read_row(R, 2)
    row_x = combine(focal[0] / depth, read_row(R, 0), -focal[0] * slope_x / depth, forward)
    row_y = combine(focal[1] / depth, read_row(R, 1), -focal[1] * slope_y / depth, forward)
    return row_x, row_y


@kernel_part()
def gaussian_factor(row_x, row_y, columns, R, focal, slope_x, slope_y, depth, scales):
    """J R V (two rows), J R V diag(s) = M (two rows a, b) and m = a x b."""
    turned_x = (dot(row_x, columns[0]), dot(row_x, columns[1]), dot(row_x, columns[2]))
    turned_y = (dot(row_y, columns[0]), dot(row_y, columns[1]), dot(row_y, columns[2]))
    # The rows of J have the cross product f_x f_y / z^2 (slope_x, slope_y, 1); it turns with them.
    ray = combine(slope_x, read_row(R, 0), slope_y, read_row(R, 1))
    ray = combine(1.0, ray, 1.0, read_row(R, 2))
    area = focal[0] * focal[1] / (depth * depth)
    normal = (area * dot(ray, columns[0]), area * dot(ray, columns[1]), area * dot(ray, columns[2]))
    minors = (normal[0] * scales[1] * scales[2], normal[1] * scales[2] * scales[0], normal[2] * scales[0] * scales[1])
    return turned_x, turned_y, times(turned_x, scales), times(turned_y, scales), minors


@kernel_part()
def _pixel_range(center, half_extent, size):
    """First and last pixel whose centre lies within the half extent; empty (first > last) outside the image."""
    first = math.ceil(min(max(center - half_extent - 0.5, 0.0), size))
    last = math.floor(max(min(center + half_extent - 0.5, size - 1.0), -1.0))
    return first, last


@kernel(parallel=True)
def project(
    means, quaternions, scales, opacities, R, t, K, size, dilation, compensate, near, footprints, depths, tiles
):
    """Fill `footprints` [g, 8], `depths` [g] and `tiles` [g, 4].

    Tiles: first and last tile column, first and last tile row.

    Gaussians that touch no pixel get an empty range of tiles (first > last) and an undefined footprint.
    """
    focal, principal = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
    for g in prange(means.shape[0]):
        tiles[g, 0], tiles[g, 1], tiles[g, 2], tiles[g, 3] = 0, -1, 0, -1
        mean = read_row(means, g)
        depth = dot(read_row(R, 2), mean) + t[2]
        depths[g] = depth
        opacity = np.float64(opacities[g])
        if depth < near or opacity < MIN_ALPHA:
            continue
        slope_x = (dot(read_row(R, 0), mean) + t[0]) / depth
        slope_y = (dot(read_row(R, 1), mean) + t[1]) / depth
        at_x, _ = clamped_slope(slope_x, focal[0], principal[0], size[0])
        at_y, _ = clamped_slope(slope_y, focal[1], principal[1], size[1])
        row_x, row_y = jacobian_times_rotation(R, focal, at_x, at_y, depth)
        q, _ = unit_quaternion(quaternions, g)
        columns = rotation_columns(q)
        _, _, a, b, m = gaussian_factor(row_x, row_y, columns, R, focal, at_x, at_y, depth, read_row(scales, g))
        var_x, var_y = dot(a, a) + dilation, dot(b, b) + dilation
        determinant = dot(m, m) + dilation * (dot(a, a) + dot(b, b)) + dilation * dilation
        if compensate:
            opacity *= math.sqrt(dot(m, m) / determinant)
            if opacity < MIN_ALPHA:
                continue
        max_q = 2 * math.log(opacity / MIN_ALPHA) * (1 + EXTENT_SLACK) + EXTENT_SLACK
        center_x, center_y = slope_x * focal[0] + principal[0], slope_y * focal[1] + principal[1]
        first_x, last_x = _pixel_range(center_x, math.sqrt(max_q * var_x), size[0])
        extent_y = math.sqrt(max_q * var_y)
        first_y, last_y = _pixel_range(center_y, extent_y, size[1])
        if first_x > last_x or first_y > last_y:
            continue
        tiles[g, 0], tiles[g, 1] = first_x // TILE, last_x // TILE
        tiles[g, 2], tiles[g, 3] = first_y // TILE, last_y // TILE
        footprints[g, CENTER_X], footprints[g, CENTER_Y] = center_x, center_y
        footprints[g, INV_STD_Y] = 1 / math.sqrt(var_y)
        footprints[g, SHEAR] = dot(a, b) / var_y
        footprints[g, STEP] = math.sqrt(var_y / determinant)
        footprints[g, OPACITY], footprints[g, MAX_Q], footprints[g, EXTENT_Y] = opacity, max_q, extent_y
