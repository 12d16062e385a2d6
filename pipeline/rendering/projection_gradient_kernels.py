"""Backward pass of the projection. From moments of dL/dq over a footprint to gradients of the Gaussian."""

from __future__ import annotations

import math

from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.rendering.projection_kernels import (
    INV_STD_Y,
    OPACITY,
    SHEAR,
    STEP,
    SUM_G,
    SUM_GE,
    SUM_GEE,
    SUM_GEH,
    SUM_GH,
    SUM_GHH,
    clamped_slope,
    combine,
    cross,
    dot,
    gaussian_factor,
    jacobian_times_rotation,
    read_row,
    rotation_columns,
    times,
    unit_quaternion,
)


@kernel_part()
def _footprint_gradient(s, f):
    """Gradients of center_x, center_y, c_xy, c_yy, det, opacity from the moments s of g = dL/dq and the footprint f."""
    inv_std_y, shear, step = f[INV_STD_Y], f[SHEAR], f[STEP]
    inv_yy = inv_std_y * inv_std_y
    center_x = -2 * step * s[SUM_GE]
    center_y = -2 * inv_std_y * s[SUM_GH] - shear * center_x
    grad_shear = -2 * step / inv_std_y * s[SUM_GEH]
    # q = u d_y^2 + w (x - x_row)^2 with u = 1 / c_yy and w = step^2 = c_yy / det, so dL/du = sum(g h^2) / u and
    # dL/dw = sum(g e^2) / w; the shear is c_xy / c_yy.
    grad_xy = grad_shear * inv_yy
    grad_yy = inv_yy * (s[SUM_GEE] - s[SUM_GHH] - shear * grad_shear)
    grad_det = -s[SUM_GEE] * step * step * inv_yy
    return center_x, center_y, grad_xy, grad_yy, grad_det, -2 * s[SUM_G] / f[OPACITY]


@kernel_part()
def _factor_gradient(a, b, m, dilation, grad_xy, grad_yy, grad_det, grad_area):
    """Gradients of the rows a, b of M; det = |m|^2 + dilation (|a|^2 + |b|^2) + dilation^2, m = a x b, area = |m|."""
    area = math.sqrt(dot(m, m))
    along_m = 2 * grad_det + (grad_area / area if area > 0 else 0.0)
    grad_a = combine(2 * dilation * grad_det, a, along_m, cross(b, m))
    grad_b = combine(2 * (grad_yy + dilation * grad_det), b, along_m, cross(m, a))
    return combine(1.0, grad_a, grad_xy, b), combine(1.0, grad_b, grad_xy, a)


@kernel_part()
def _quaternion_gradient(q, norm, g0, g1, g2):
    """Gradient of a quaternion of length `norm` and direction q from those of the columns of its rotation matrix."""
    if norm == 0:
        return 0.0, 0.0, 0.0, 0.0
    w, x, y, z = q
    # g_j[i] is the gradient of V_ij.
    gw = 2 * (x * (g1[2] - g2[1]) + y * (g2[0] - g0[2]) + z * (g0[1] - g1[0]))
    gx = 2 * (y * (g1[0] + g0[1]) + z * (g2[0] + g0[2]) + w * (g1[2] - g2[1])) - 4 * x * (g1[1] + g2[2])
    gy = 2 * (x * (g1[0] + g0[1]) + z * (g2[1] + g1[2]) + w * (g2[0] - g0[2])) - 4 * y * (g0[0] + g2[2])
    gz = 2 * (x * (g2[0] + g0[2]) + y * (g2[1] + g1[2]) + w * (g0[1] - g1[0])) - 4 * z * (g0[0] + g1[1])
    along = w * gw + x * gx + y * gy + z * gz
    return (gw - along * w) / norm, (gx - along * x) / norm, (gy - along * y) / norm, (gz - along * z) / norm


@kernel_part()
def _mean_gradient(R, focal, slope, at, inside, depth, grad_row_x, grad_row_y, grad_center, grad_depth):
    """Gradient of the mean in the world: through its pixel, through J (its depth and clamped slopes) and as a depth."""
    turned_x, turned_y = dot(grad_row_x, read_row(R, 2)), dot(grad_row_y, read_row(R, 2))
    # Rows of J R: f_x / z (R_0 - at_x R_2) and f_y / z (R_1 - at_y R_2).
    grad_inverse_depth_x = focal[0] * (dot(grad_row_x, read_row(R, 0)) - at[0] * turned_x)
    grad_inverse_depth_y = focal[1] * (dot(grad_row_y, read_row(R, 1)) - at[1] * turned_y)
    grad_slope_x = grad_center[0] * focal[0] - (focal[0] / depth * turned_x if inside[0] else 0.0)
    grad_slope_y = grad_center[1] * focal[1] - (focal[1] / depth * turned_y if inside[1] else 0.0)
    grad_z = grad_depth - (grad_inverse_depth_x + grad_inverse_depth_y) / (depth * depth)
    grad_z -= (grad_slope_x * slope[0] + grad_slope_y * slope[1]) / depth
    turned = combine(grad_slope_x / depth, read_row(R, 0), grad_slope_y / depth, read_row(R, 1))
    return combine(1.0, turned, grad_z, read_row(R, 2))


@kernel(parallel=True)
def project_backward(
    means, quaternions, scales, opacities, R, t, K, size, dilation, compensate, footprints, slot_start, slots,
    grad_means, grad_quaternions, grad_scales, grad_opacities, grad_features,
):  # fmt: skip
    """Sum each Gaussian's slots, in order, and write its gradients. Those of invisible Gaussians stay untouched."""
    focal, principal = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
    count = grad_features.shape[1]
    for g in prange(means.shape[0]):
        if slot_start[g] == slot_start[g + 1]:
            continue
        grad_depth = 0.0
        sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for slot in range(slot_start[g], slot_start[g + 1]):
            for c in range(count):
                grad_features[g, c] += slots[slot, c]
            grad_depth += slots[slot, count]
            sums = (
                sums[0] + slots[slot, count + 1], sums[1] + slots[slot, count + 2], sums[2] + slots[slot, count + 3],
                sums[3] + slots[slot, count + 4], sums[4] + slots[slot, count + 5], sums[5] + slots[slot, count + 6],
            )  # fmt: skip
        mean = read_row(means, g)
        depth = dot(read_row(R, 2), mean) + t[2]
        slope = ((dot(read_row(R, 0), mean) + t[0]) / depth, (dot(read_row(R, 1), mean) + t[1]) / depth)
        at_x, inside_x = clamped_slope(slope[0], focal[0], principal[0], size[0])
        at_y, inside_y = clamped_slope(slope[1], focal[1], principal[1], size[1])
        row_x, row_y = jacobian_times_rotation(R, focal, at_x, at_y, depth)
        q, norm = unit_quaternion(quaternions, g)
        columns = rotation_columns(q)
        scale = read_row(scales, g)
        turned_x, turned_y, a, b, m = gaussian_factor(row_x, row_y, columns, R, focal, at_x, at_y, depth, scale)

        grad_x, grad_y, grad_xy, grad_yy, grad_det, grad_opacity = _footprint_gradient(sums, footprints[g])
        grad_area = 0.0
        if compensate:
            determinant = dot(m, m) + dilation * (dot(a, a) + dot(b, b)) + dilation * dilation
            grad_area = grad_opacity * opacities[g] / math.sqrt(determinant)
            share = math.sqrt(dot(m, m) / determinant)
            grad_det -= 0.5 * grad_opacity * opacities[g] * share / determinant
            grad_opacity *= share
        grad_a, grad_b = _factor_gradient(a, b, m, dilation, grad_xy, grad_yy, grad_det, grad_area)

        # M = (J R V) diag(s)
        grad_scale = combine(1.0, times(grad_a, turned_x), 1.0, times(grad_b, turned_y))
        grad_a, grad_b = times(grad_a, scale), times(grad_b, scale)
        grad_row_x = combine(1.0, combine(grad_a[0], columns[0], grad_a[1], columns[1]), grad_a[2], columns[2])
        grad_row_y = combine(1.0, combine(grad_b[0], columns[0], grad_b[1], columns[1]), grad_b[2], columns[2])
        grad_quaternion = _quaternion_gradient(
            q, norm, combine(grad_a[0], row_x, grad_b[0], row_y),
            combine(grad_a[1], row_x, grad_b[1], row_y), combine(grad_a[2], row_x, grad_b[2], row_y),
        )  # fmt: skip
        at, inside, grad_center = (at_x, at_y), (inside_x, inside_y), (grad_x, grad_y)
        grad_mean = _mean_gradient(
            R, focal, slope, at, inside, depth, grad_row_x, grad_row_y, grad_center, grad_depth
        )  # fmt: skip
        for k in range(3):
            grad_means[g, k] = grad_mean[k]
            grad_scales[g, k] = grad_scale[k]
        for k in range(4):
            grad_quaternions[g, k] = grad_quaternion[k]
        grad_opacities[g] = grad_opacity
