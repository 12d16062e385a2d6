"""Derivatives of points that a chain of joints carries, written where they are not zero.

A joint moves the points that hang below it, which is a few joints of many for each point: two thirds of the derivatives
are zero. `pipeline.geometry.kinematics.points_with_derivatives` is the slow twin.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.kernel_cache import unlocked_kernel


@unlocked_kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def add_point_derivatives(points, parts, carried, transforms, inverse, turning, root, pivot, scale, derivatives):
    """Set derivatives [points, 3, unknowns] of one frame's points, which are zeros before.

    Args:
        points: which of the points.
        parts: of all points [all, carriers, 4]; see `TrackedPoints`, as is `carried`, for the free joints only.
        transforms: of the carriers [carriers, 4, 4].
        inverse: from the template's frame into that below each free joint's rotation [free, 3, 4].
        turning: the negated linear part of its inverse, in the world and metres [free, 3, 3].
        root: rotation of the root [3, 3]; pivot: see `TrackedPoints`; scale: metres per unit of the template.
    """
    carriers, free = parts.shape[1], carried.shape[0]
    own, hanging, below = np.empty((carriers, 4)), np.empty(4), np.empty(3)
    used = np.empty(carriers, np.int64)
    for n in range(points.shape[0]):
        count = 0
        for k in range(carriers):
            part = parts[points[n], k]
            if part[0] == 0 and part[1] == 0 and part[2] == 0 and part[3] == 0:
                continue
            for a in range(4):
                t = transforms[k, a]
                own[count, a] = t[0] * part[0] + t[1] * part[1] + t[2] * part[2] + t[3] * part[3]
            used[count] = k
            count += 1
        below[:] = 0
        for k in range(count):
            for a in range(3):
                below[a] += scale * own[k, a]
        for a in range(3):
            derivatives[n, a, a] = 1.0
        _turned(derivatives[n, :, 3:6], -root, below - pivot)
        for j in range(free):
            hanging[:] = 0
            for k in range(count):
                if carried[j, used[k]] != 0:
                    for a in range(4):
                        hanging[a] += own[k, a]
            if hanging[0] == 0 and hanging[1] == 0 and hanging[2] == 0 and hanging[3] == 0:
                continue
            for a in range(3):
                t = inverse[j, a]
                below[a] = t[0] * hanging[0] + t[1] * hanging[1] + t[2] * hanging[2] + t[3] * hanging[3]
            _turned(derivatives[n, :, 6 + 3 * j : 9 + 3 * j], turning[j], below)


@unlocked_kernel
@no_type_check
def _turned(result, matrix, arm):
    """Set matrix @ [arm]x."""
    for a in range(3):
        m = matrix[a]
        result[a, 0] = m[1] * arm[2] - m[2] * arm[1]
        result[a, 1] = m[2] * arm[0] - m[0] * arm[2]
        result[a, 2] = m[0] * arm[1] - m[1] * arm[0]


@unlocked_kernel
@no_type_check
def carry_quadratic(points, derivatives, normal, carried):
    """Set normal @ derivatives, point by point, of one frame; `normal` is of all points."""
    for n in range(points.shape[0]):
        matrix, d = normal[points[n]], derivatives[n]
        for a in range(3):
            x, y, z = matrix[a, 0], matrix[a, 1], matrix[a, 2]
            for u in range(d.shape[1]):
                carried[n, a, u] = x * d[0, u] + y * d[1, u] + z * d[2, u]


@unlocked_kernel
@no_type_check
def carry_shared(points, derivatives, shared, rows, factor):
    """Set rows of `factor` [all own, unknowns] to shared^T @ derivatives, point by point.

    Args:
        shared: of all points [all, 3, own]; rows: first row of each point, negative for none.
    """
    for n in range(points.shape[0]):
        row = rows[points[n]]
        if row < 0:
            continue
        d, own = derivatives[n], shared[points[n]]
        for k in range(own.shape[1]):
            x, y, z = own[0, k], own[1, k], own[2, k]
            for u in range(d.shape[1]):
                factor[row + k, u] = x * d[0, u] + y * d[1, u] + z * d[2, u]
