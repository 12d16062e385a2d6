"""Kernel that sums the gloss of microfacets for `microfacet`, sixteen points at a time.

Points past the end of the last block, and points that do not see a light, are lanes that this light leaves dark. Their
numbers stay finite: cosines and lengths have smallest values.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import prange

from pipeline.base.float_lanes import LANES, above, any_above, every, fused, larger, load, square_root, store
from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.lighting.lobe_kernels import LOBE_CONSTANT, SMALLEST_SINE2, acute_angle, falling
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2, dot, mark_seen

DIELECTRIC_F0 = 0.04
"""Reflectance of skin, cloth and plastic at normal incidence (refractive index 1.5). A factor per point scales it."""

LOBE_SCALE = 4 * LOBE_CONSTANT / (math.sqrt(2) * DIELECTRIC_F0)
"""Over alpha, D of the Gaussian at its middle: D G F / 4 is C / sigma there for light and camera straight above."""

SMALLEST_COSINE = np.float32(1e-4)
"""Light or camera closer to the surface's plane than this: nothing. The reflected light vanishes with the cosine of
the light; the guard keeps the 1 / cosine of the masking term in float32's range."""

GAUSSIAN_REACH = np.float32(18.0)
"""(angle / alpha)^2 beyond which the Gaussian counts as nothing: exp(-18) = 1.5e-8 is below float32's resolution of its
middle. The sine, which is at hand before the angle, is never larger than it."""

SMALLEST_SINE = np.float32(math.sqrt(SMALLEST_SINE2))
"""Sine of the angle at the middle of a highlight."""

SMALLEST_LENGTH2 = np.float32(1e-12)
"""Of w_i + w_o, squared. Lanes whose light is seen are far above it: both cosines are positive."""

F0, ONE, HALF, TWO, PI = (np.float32(number) for number in (DIELECTRIC_F0, 1, 0.5, 2, math.pi))
SCALE = np.float32(LOBE_SCALE)

PLACES = 10
"""Numbers of a point: its position, normal, direction to the camera, and alpha."""


@kernel_part()
@no_type_check
def turned_round(points, normals, to_camera, alpha, start, size):
    """Numbers of a block of points as [PLACES, LANES].

    Lanes past its end have no normal, and so no light.
    """
    block = np.zeros((PLACES, LANES), np.float32)
    block[9] = ONE
    for i in range(size):
        for k in range(3):
            block[k, i] = points[start + i, k]
            block[3 + k, i] = normals[start + i, k]
            block[6 + k, i] = to_camera[start + i, k]
        block[9, i] = alpha[start + i]
    return block


@kernel(parallel=True)
@no_type_check
def gather_reflections(points, normals, to_camera, alpha, lights, intensities, seen, gaussian, value, slope):
    """Radiance of each point and channel, and its derivatives by the normal and alpha."""
    channels, count = intensities.shape[1], points.shape[0]
    for block in prange((count + LANES - 1) // LANES):
        start = block * LANES
        size = min(LANES, count - start)
        place = turned_round(points, normals, to_camera, alpha, start, size)
        sums = np.zeros((channels, 5, LANES), np.float32)
        clear = np.zeros(LANES, np.float32)
        one, zero = every(ONE), every(np.float32(0.0))
        nearest, shortest, lowest = every(SMALLEST_DISTANCE2_M2), every(SMALLEST_LENGTH2), every(SMALLEST_COSINE)
        nx, ny, nz = load(place, 3 * LANES), load(place, 4 * LANES), load(place, 5 * LANES)
        ox, oy, oz = load(place, 6 * LANES), load(place, 7 * LANES), load(place, 8 * LANES)
        a, co = load(place, 9 * LANES), dot(nx, ny, nz, ox, oy, oz)
        faces = above(co, lowest)
        a2, co = a * a, larger(co, lowest)
        rest = ONE - a2
        root_o = square_root(fused(rest * co, co, a2))
        for j in range(lights.shape[0]):
            if not mark_seen(seen, j, start, size, clear):
                continue
            x, y, z = (
                lights[j, 0] - load(place, 0),
                lights[j, 1] - load(place, LANES),
                lights[j, 2] - load(place, 2 * LANES),
            )
            inverse2 = one / larger(dot(x, y, z, x, y, z), nearest)
            inverse = square_root(inverse2)
            x, y, z = x * inverse, y * inverse, z * inverse
            ci = dot(nx, ny, nz, x, y, z)
            shown = faces * load(clear, 0) * above(ci, lowest)
            if not any_above(shown, zero):
                continue
            ci = larger(ci, lowest)
            hx, hy, hz = x + ox, y + oy, z + oz
            length = square_root(larger(dot(hx, hy, hz, hx, hy, hz), shortest))
            inverse = one / length
            hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
            ch = dot(nx, ny, nz, hx, hy, hz)
            # cos^2 (alpha^2 - 1) + 1 with |n x h|^2 for 1 - cos^2: nothing cancels in the highlights of small alpha.
            sx, sy, sz = ny * hz - nz * hy, nz * hx - nx * hz, nx * hy - ny * hx
            sine2 = dot(sx, sy, sz, sx, sy, sz)
            # D with the derivatives of its logarithm; with those of f the gradient needs no second pass.
            if gaussian:
                shown = shown * above(GAUSSIAN_REACH * a2, sine2)
                if not any_above(shown, zero):
                    continue
                sine = larger(square_root(sine2), every(SMALLEST_SINE))
                angle = acute_angle(sine, larger(ch, zero))
                power = angle * angle / a2
                d, by_ch, by_a2 = SCALE / a * falling(power), TWO * angle / (sine * a2), (power - HALF) / a2
                hx, hy, hz = hx - ch * nx, hy - ch * ny, hz - ch * nz  # no angle changes with the normal's length
            else:
                t = fused(a2 * ch, ch, sine2)
                d, by_ch, by_a2 = a2 / (PI * t * t), (TWO + TWO) * ch * rest / t, one / a2 - TWO * ch * ch / t
            # w_o . h is half the length of w_i + w_o, which keeps its digits where both graze the surface.
            grazing = ONE - HALF * length
            grazing2 = grazing * grazing
            fresnel = F0 + (ONE - F0) * grazing2 * grazing2 * grazing
            root_i = square_root(fused(rest * ci, ci, a2))
            q = ci * root_o + co * root_i
            f = shown * d * fresnel * ci / (TWO * q) * inverse2
            by_ci = one / ci - (root_o + co * rest * ci / root_i) / q
            by_co = (ci * rest * co / root_o + root_i) / q
            by_a2 = by_a2 - (ci * (ONE - co * co) / root_o + co * (ONE - ci * ci) / root_i) / (TWO * q)
            gx = f * (by_ch * hx + by_ci * x - by_co * ox)
            gy = f * (by_ch * hy + by_ci * y - by_co * oy)
            gz = f * (by_ch * hz + by_ci * z - by_co * oz)
            ga = f * by_a2 * TWO * a
            for c in range(channels):
                light, at = intensities[j, c], c * 5 * LANES
                store(sums, at, fused(f, light, load(sums, at)))
                store(sums, at + LANES, fused(gx, light, load(sums, at + LANES)))
                store(sums, at + 2 * LANES, fused(gy, light, load(sums, at + 2 * LANES)))
                store(sums, at + 3 * LANES, fused(gz, light, load(sums, at + 3 * LANES)))
                store(sums, at + 4 * LANES, fused(ga, light, load(sums, at + 4 * LANES)))
        for i in range(size):
            for c in range(channels):
                value[start + i, c] = sums[c, 0, i]
                for k in range(4):
                    slope[start + i, c, k] = sums[c, 1 + k, i]
