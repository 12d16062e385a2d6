"""Kernels that gather light by Legendre degree, sixteen points at a time.

Forward and backward of `pipeline.lighting.zonal`.

A block of sixteen points is turned round, so that a coordinate of all of them is one vector. Points past the end of the
last block, and points that do not see a light, are lanes that this light leaves dark.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import prange

from pipeline.base.float_lanes import LANES, every, fused, larger, load, square_root, store
from pipeline.base.kernel_cache import kernel, kernel_part

DEGREES = 9
"""Degrees 0..8 (RFGCA section 3.2.1): as many as there ever are."""

SMALLEST_DISTANCE2_M2 = np.float32(1e-8)
"""Lights closer than 0.1 mm are taken at 0.1 mm: no LED is nearer, and I / d^2 stays finite in float32."""

STEP = np.array([(2 * degree + 3) / (degree + 2) for degree in range(DEGREES)], np.float32)
BACK = np.array([(degree + 1) / (degree + 2) for degree in range(DEGREES)], np.float32)
"""Bonnet's recurrence: P_(l+2) = STEP_l x P_(l+1) - BACK_l P_l."""

PLACES = 12
"""Numbers of a point: its position, then axis by axis the components of its axes."""


@kernel_part(inline=True)
@no_type_check
def dot(ax, ay, az, bx, by, bz):
    """Scalar product of vectors whose components are lanes."""
    return fused(az, bz, fused(ay, by, ax * bx))


@kernel_part()
@no_type_check
def turned_round(points, axes, start, size):
    """Positions and axes of a block as [PLACES, LANES]."""
    block = np.zeros((PLACES, LANES), np.float32)
    for i in range(size):
        for k in range(3):
            block[k, i] = points[start + i, k]
            for a in range(3):
                block[3 + 3 * a + k, i] = axes[start + i, k, a]
    return block


@kernel_part()
@no_type_check
def mark_seen(seen, light, start, size, clear):
    """Set `clear` to 1 for the points of a block that see a light, to 0 for others.

    Returns whether any does.
    """
    any_sees = False
    for i in range(size):
        p = start + i
        sees = (seen[light, p >> 3] & (128 >> (p & 7))) != 0
        any_sees |= sees
        clear[i] = np.float32(1.0) if sees else np.float32(0.0)
    return any_sees


@kernel(parallel=True)
@no_type_check
def gather_forward(points, axes, lights, intensities, seen, normalisation, out):
    """out[p, a, l, c] = norm_l sum_n seen I_nc / d^2 P_l(axis_a . w_n)."""
    channels, degrees = intensities.shape[1], normalisation.shape[0]
    count = points.shape[0]
    for block in prange((count + LANES - 1) // LANES):
        start = block * LANES
        size = min(LANES, count - start)
        place = turned_round(points, axes, start, size)
        total = np.zeros((3, degrees, channels, LANES), np.float32)
        clear = np.zeros(LANES, np.float32)
        one, nearest = every(np.float32(1.0)), every(SMALLEST_DISTANCE2_M2)
        for n in range(lights.shape[0]):
            if not mark_seen(seen, n, start, size, clear):
                continue
            dx = lights[n, 0] - load(place, 0)
            dy = lights[n, 1] - load(place, LANES)
            dz = lights[n, 2] - load(place, 2 * LANES)
            distance2 = larger(dot(dx, dy, dz, dx, dy, dz), nearest)
            inverse = one / square_root(distance2)
            arriving = load(clear, 0) / distance2
            for a in range(3):
                at = (3 + 3 * a) * LANES
                x = dot(dx, dy, dz, load(place, at), load(place, at + LANES), load(place, at + 2 * LANES)) * inverse
                value, following = one, x
                for degree in range(degrees):
                    light = arriving * value
                    for c in range(channels):
                        at = ((a * degrees + degree) * channels + c) * LANES
                        store(total, at, fused(light, intensities[n, c], load(total, at)))
                    after = fused(STEP[degree] * x, following, -BACK[degree] * value)
                    value, following = following, after
        for i in range(size):
            for a in range(3):
                for degree in range(degrees):
                    for c in range(channels):
                        out[start + i, a, degree, c] = total[a, degree, c, i] * normalisation[degree]


@kernel(parallel=True)
@no_type_check
def gather_backward(points, axes, lights, intensities, grad_out, seen, normalisation, grad_points, grad_axes):
    """Gradients of `gather_forward` with respect to points and axes."""
    channels, degrees = intensities.shape[1], normalisation.shape[0]
    count = points.shape[0]
    for block in prange((count + LANES - 1) // LANES):
        start = block * LANES
        size = min(LANES, count - start)
        place = turned_round(points, axes, start, size)
        weights = np.zeros((3, degrees, channels, LANES), np.float32)
        for i in range(size):
            for a in range(3):
                for degree in range(degrees):
                    for c in range(channels):
                        weights[a, degree, c, i] = grad_out[start + i, a, degree, c] * normalisation[degree]
        sums = np.zeros((PLACES, LANES), np.float32)
        clear = np.zeros(LANES, np.float32)
        zero, one = every(np.float32(0.0)), every(np.float32(1.0))
        nearest = every(SMALLEST_DISTANCE2_M2)
        for n in range(lights.shape[0]):
            if not mark_seen(seen, n, start, size, clear):
                continue
            wx = lights[n, 0] - load(place, 0)
            wy = lights[n, 1] - load(place, LANES)
            wz = lights[n, 2] - load(place, 2 * LANES)
            inverse2 = one / larger(dot(wx, wy, wz, wx, wy, wz), nearest)
            inverse = square_root(inverse2)
            wx, wy, wz = wx * inverse, wy * inverse, wz * inverse
            arriving = load(clear, 0) * inverse2
            # Derivatives with respect to log(1 / d^2), and to the direction w.
            fading, gx, gy, gz = zero, zero, zero, zero
            for a in range(3):
                at = (3 + 3 * a) * LANES
                ax, ay, az = load(place, at), load(place, at + LANES), load(place, at + 2 * LANES)
                x = dot(wx, wy, wz, ax, ay, az)
                value, following, change, following_change, slope = one, x, zero, one, zero
                for degree in range(degrees):
                    weight = zero
                    for c in range(channels):
                        at = ((a * degrees + degree) * channels + c) * LANES
                        weight = fused(load(weights, at), intensities[n, c], weight)
                    slope = fused(weight, change, slope)
                    fading = fused(weight, value, fading)
                    after = fused(STEP[degree] * x, following, -BACK[degree] * value)
                    grown = STEP[degree] * fused(x, following_change, following)
                    after_change = fused(change, -BACK[degree], grown)
                    value, following = following, after
                    change, following_change = following_change, after_change
                slope = slope * arriving
                at = (3 + 3 * a) * LANES
                store(sums, at, fused(slope, wx, load(sums, at)))
                store(sums, at + LANES, fused(slope, wy, load(sums, at + LANES)))
                store(sums, at + 2 * LANES, fused(slope, wz, load(sums, at + 2 * LANES)))
                gx, gy, gz = fused(slope, ax, gx), fused(slope, ay, gy), fused(slope, az, gz)
            fading = np.float32(2.0) * fading * arriving
            radial = dot(wx, wy, wz, gx, gy, gz)
            store(sums, 0, load(sums, 0) + inverse * (fading * wx - (gx - radial * wx)))
            store(sums, LANES, load(sums, LANES) + inverse * (fading * wy - (gy - radial * wy)))
            store(sums, 2 * LANES, load(sums, 2 * LANES) + inverse * (fading * wz - (gz - radial * wz)))
        for i in range(size):
            for k in range(3):
                grad_points[start + i, k] = sums[k, i]
                for a in range(3):
                    grad_axes[start + i, k, a] = sums[3 + 3 * a + k, i]
