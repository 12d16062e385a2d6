"""Kernel that sums spherical Gaussians for `specular_lobes`, sixteen points at a time.

Points past the end of the last block, and lights out of a lobe's reach, are lanes that stay dark.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import prange

from pipeline.base.float_lanes import LANES, above, any_above, every, fused, larger, load, square_root, store
from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2, dot

LOBE_CONSTANT = 1 / (math.sqrt(2) * math.pi ** (2 / 3))
"""The papers' published constant. It is not the normaliser on the sphere: the learned visibility absorbs the scale."""

SMALLEST_SINE2 = 1e-14
"""Added under the root of |p x q|^2. It bounds the slope of the root at p = q by 1e7 |p x q|, which vanishes there,
and moves the angle by at most 1e-7 rad: a hundred-thousandth of the smallest roughness, 0.01."""

REACH_SIGMAS = np.float32(6.0)
"""Light further than this from the lobe's centre is skipped: exp(-6^2 / 2) = 1.5e-8 is below float32's resolution of
the peak."""

HALVINGS = 5
EXPONENTIAL = np.array([(-1.0) ** k / math.factorial(k) for k in range(9)], np.float32)
"""exp(-x) is that of x / 2^HALVINGS, by its series, squared so often. Up to LARGEST_EXPONENT the series is cut off at
0.75^9 / 9! = 2e-7; squaring multiplies that by 32."""

LARGEST_EXPONENT = np.float32(24.0)

ARC_TANGENT = np.array([(-1.0) ** k / (2 * k + 1) for k in range(7)], np.float32)
"""Series of atan(t) / t in t^2. An angle below 90 degrees is four times that of t <= tan(22.5 degrees), where it is cut
off at 0.172^7 / 15 = 3e-7."""

CONSTANT, TINY = np.float32(LOBE_CONSTANT), np.float32(SMALLEST_SINE2)
ONE, HALF, TWO = (np.float32(number) for number in (1, 0.5, 2))
SHRINK = np.float32(2.0**-HALVINGS)
SMALLEST_HALF = np.float32(1e-7)
"""Of 1 + cosine, which is 0 opposite to the lobe's centre."""

WHOLE_SPHERE = np.float32(-2.0)
"""A cosine that no direction falls short of."""

PLACES = 8
"""Numbers of a point: its position, lobe's centre, sigma, and the cosine of the lobe's reach."""


@kernel_part(inline=True)
@no_type_check
def falling(x):
    """exp(-x) of lanes from 0 on; beyond LARGEST_EXPONENT, that of it."""
    y = (LARGEST_EXPONENT - larger(LARGEST_EXPONENT - x, every(np.float32(0.0)))) * SHRINK
    total = every(EXPONENTIAL[8])
    for k in range(8):
        total = fused(total, y, EXPONENTIAL[7 - k])
    for _ in range(HALVINGS):
        total = total * total
    return total


@kernel_part(inline=True)
@no_type_check
def acute_angle(sine, cosine):
    """Angle of lanes in [0, 90] degrees, radians."""
    half = sine / (ONE + cosine)
    quarter = half / (ONE + square_root(fused(half, half, every(ONE))))
    square = quarter * quarter
    total = every(ARC_TANGENT[6])
    for k in range(6):
        total = fused(total, square, ARC_TANGENT[5 - k])
    return np.float32(4.0) * quarter * total


@kernel_part(inline=True)
@no_type_check
def angle_of(sine, cosine):
    """Angle of lanes in [0, 180] degrees, radians: twice that of the direction half way."""
    half = sine / larger(ONE + cosine, every(SMALLEST_HALF))
    longer = square_root(fused(half, half, every(ONE)))
    return TWO * acute_angle(half / longer, ONE / longer)


@kernel_part()
@no_type_check
def turned_round(points, centers, sigmas, start, size):
    """Numbers of a block of points as [PLACES, LANES].

    No light is within reach of lanes past its end.
    """
    block = np.zeros((PLACES, LANES), np.float32)
    block[6] = ONE
    block[7] = TWO
    for i in range(size):
        for k in range(3):
            block[k, i] = points[start + i, k]
            block[3 + k, i] = centers[start + i, k]
        sigma = sigmas[start + i]
        block[6, i] = sigma
        block[7, i] = math.cos(REACH_SIGMAS * sigma) if REACH_SIGMAS * sigma < math.pi else WHOLE_SPHERE
    return block


@kernel(parallel=True)
@no_type_check
def gather_lobes(points, centers, sigmas, lights, intensities, value, slope):
    """Sums of each point and channel, and their derivatives by the lobe's centre and sigma."""
    channels, count = intensities.shape[1], points.shape[0]
    for block in prange((count + LANES - 1) // LANES):
        start = block * LANES
        size = min(LANES, count - start)
        place = turned_round(points, centers, sigmas, start, size)
        sums = np.zeros((channels, 5, LANES), np.float32)
        one, zero, nearest = every(ONE), every(np.float32(0.0)), every(SMALLEST_DISTANCE2_M2)
        qx, qy, qz = load(place, 3 * LANES), load(place, 4 * LANES), load(place, 5 * LANES)
        sigma, limit = load(place, 6 * LANES), load(place, 7 * LANES)
        narrow = one / sigma
        for n in range(lights.shape[0]):
            x, y, z = (
                lights[n, 0] - load(place, 0),
                lights[n, 1] - load(place, LANES),
                lights[n, 2] - load(place, 2 * LANES),
            )
            inverse2 = one / larger(dot(x, y, z, x, y, z), nearest)
            inverse = square_root(inverse2)
            x, y, z = x * inverse, y * inverse, z * inverse
            cosine = dot(x, y, z, qx, qy, qz)
            shown = above(cosine, limit)
            if not any_above(shown, zero):
                continue
            cx, cy, cz = y * qz - z * qy, z * qx - x * qz, x * qy - y * qx
            sine = square_root(dot(cx, cy, cz, cx, cy, cz) + TINY)
            scaled = angle_of(sine, cosine) * narrow
            lobe = shown * CONSTANT * narrow * falling(HALF * scaled * scaled) * inverse2
            # d angle = (cosine d sine - sine d cosine) / (sine^2 + cosine^2); d sine = (q - p cosine) . dq / sine
            turn = lobe * scaled * narrow / fused(sine, sine, cosine * cosine)
            along_q, along_p = turn * cosine / sine, turn * (cosine * cosine / sine + sine)
            gx, gy, gz = along_p * x - along_q * qx, along_p * y - along_q * qy, along_p * z - along_q * qz
            gs = lobe * (scaled * scaled - ONE) * narrow
            for c in range(channels):
                light, at = intensities[n, c], c * 5 * LANES
                store(sums, at, fused(lobe, light, load(sums, at)))
                store(sums, at + LANES, fused(gx, light, load(sums, at + LANES)))
                store(sums, at + 2 * LANES, fused(gy, light, load(sums, at + 2 * LANES)))
                store(sums, at + 3 * LANES, fused(gz, light, load(sums, at + 3 * LANES)))
                store(sums, at + 4 * LANES, fused(gs, light, load(sums, at + 4 * LANES)))
        for i in range(size):
            for c in range(channels):
                value[start + i, c] = sums[c, 0, i]
                for k in range(4):
                    slope[start + i, c, k] = sums[c, 1 + k, i]
