"""One ray per point, to a light that it draws, and the shares of light that this tells.

Embree answers a ray in 300 nanoseconds. All else together has a quarter of that: a few thousand points are drawn, aimed
at, asked for and summed up before the next, while all about them is in the nearest caches. The sums over all lights,
which turn what arrived into a share, are dearest. Only a ray that met nothing needs them; such rays are packed into
lanes, and turned round.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.float_lanes import LANES, every, fused, inverse_root, larger, load, store
from pipeline.base.kernel_cache import kernel_part, unlocked_kernel
from pipeline.lighting.draw_kernels import drawing_table, lattice_number, light_at, whole_number
from pipeline.lighting.embree_kernels import meets_something, room_for_ray
from pipeline.lighting.ray_kernels import PAIRS_AT_ONCE, height, ray_kernel, write_rays

PLACES = 10
"""Numbers of a ray: its point, the normal, the light's place or direction, and its luminance over its chance."""

SMALLEST = np.float32(1e-37)
"""Stands for a sum of cosines that is 0: then the ray's own is 0, too, and so is its share."""


@ray_kernel
@no_type_check
def draw_above_horizon(points, normals, lights, distant, beyond, start, uniform, texel, shift, begin, end, rows):
    """Draw a light for each of the points `begin` to `end`; keep those above the horizon.

    Returns how many are kept. Arguments are those of `trace_single_rays`, `ray_kernels.aim` and `light_at`.
    """
    assert points.shape[1] == normals.shape[1] == lights.shape[1] == 3 and rows.shape[1] == texel.shape[1] == 2
    n, lattice = np.uint64(0), uniform.shape[0] == 0
    for i in range(np.uint64(begin), np.uint64(end)):
        number = lattice_number(texel[i, 0], texel[i, 1], shift) if lattice else whole_number(uniform[i])
        j = light_at(beyond, start, number)
        rows[n, 0], rows[n, 1] = i, j
        above = height(
            lights[j, 0], lights[j, 1], lights[j, 2], points[i, 0], points[i, 1], points[i, 2], normals[i, 0],
            normals[i, 1], normals[i, 2], distant,
        )  # fmt: skip
        n += np.uint64(above > 0)
    return np.int64(n)


@kernel_part(inline=True)
@no_type_check
def falling(px, py, pz, nx, ny, nz, x, y, z, luminance, least2, distant):
    """Light of each lane's lamp at its point, and the same weighted by the cosine."""
    nothing = every(np.float32(0))
    if distant:
        return luminance, luminance * larger(fused(nx, x, fused(ny, y, nz * z)), nothing)
    dx, dy, dz = x - px, y - py, z - pz
    inverse = inverse_root(larger(fused(dx, dx, fused(dy, dy, dz * dz)), least2))
    light = luminance * (inverse * inverse)
    return light, light * inverse * larger(fused(nx, dx, fused(ny, dy, nz * dz)), nothing)


@kernel_part(inline=True)
@no_type_check
def shares_of_lanes(packed, lights, luminances, distant, least2, found):
    """Shares of sixteen rays, plain and by cosines, from what `trace_single_rays` packed."""
    px, py, pz = load(packed, 0), load(packed, LANES), load(packed, 2 * LANES)
    nx, ny, nz = load(packed, 3 * LANES), load(packed, 4 * LANES), load(packed, 5 * LANES)
    total, cosine_total = every(np.float32(0)), every(np.float32(0))
    for j in range(lights.shape[0]):
        light, cosine_light = falling(
            px, py, pz, nx, ny, nz, every(lights[j, 0]), every(lights[j, 1]), every(lights[j, 2]),
            every(luminances[j]), least2, distant,
        )  # fmt: skip
        total, cosine_total = total + light, cosine_total + cosine_light
    light, cosine_light = falling(
        px, py, pz, nx, ny, nz, load(packed, 6 * LANES), load(packed, 7 * LANES), load(packed, 8 * LANES),
        load(packed, 9 * LANES), least2, distant,
    )  # fmt: skip
    store(found, 0, light / total)
    store(found, LANES, cosine_light / larger(cosine_total, every(SMALLEST)))


@kernel_part(inline=True)
@no_type_check
def write_shares(found, at, size, block, shares, cosine_shares, sums, squares):
    """Write the shares of the first `size` lanes to their points, and add them to their blocks."""
    for k in range(size):
        i = at[k]
        share, b = np.float64(found[0, k]), block[i]
        shares[i], cosine_shares[i] = found[0, k], found[1, k]
        sums[b] += share
        squares[b] += share * share


@unlocked_kernel
@no_type_check
def trace_single_rays(
    scene, points, face_normals, normals, lights, distant, least2, chances, uniform, texel, shift, frame, narrow_lights,
    luminances, worth, block, shares, cosine_shares, sums, squares,
):  # fmt: skip
    """Draw a light for each point, trace whether it is seen, and estimate shares of light.

    Returns the number of rays: there is none to a light below the horizon of the point's face.

    A share is 0 without a ray, or if it met anything. Else L_j / p_j over the sum of all L_j, and
    L_j max(0, n . w_j) / p_j over the sum of all of these. In float32: relative to the largest cosine, errors are below
    (m + 16) 2^-23 for m lights, 8.5e-5 for 700, where a half float, as maps are stored, has 5e-4 and the draw itself 1.

    Args:
        scene: of Embree; `frame`: from `center` to `farthest`, as of `ray_kernels.aim`.
        lights, distant: as of `ray_kernels.aim`; `narrow_lights`: the same in float32.
        chances: probability of each light.
        uniform: a number in [0, 1) per point; or empty: the lattice number of its `texel` and the `shift`.
        luminances: float32; the largest 1.
        worth: L_j / p_j at a distance of 1; float32.
        block: of each point, a number.
        sums, squares: of the shares in each block; added to.
    """
    beyond, start = drawing_table(chances)
    rows, lengths = np.empty((PAIRS_AT_ONCE, 2), np.int32), np.empty(PAIRS_AT_ONCE, np.float32)
    sources, ways = np.empty((PAIRS_AT_ONCE, 3), np.float32), np.empty((PAIRS_AT_ONCE, 3), np.float32)
    ray, packed, at = room_for_ray(), np.zeros((PLACES, LANES), np.float32), np.empty(LANES, np.uint32)
    found, least = np.empty((2, LANES), np.float32), every(np.float32(least2))
    rays, count = 0, points.shape[0]
    for begin in range(0, count, PAIRS_AT_ONCE):
        end, size = min(begin + PAIRS_AT_ONCE, count), np.uint64(0)
        for i in range(begin, end):
            shares[i], cosine_shares[i] = 0.0, 0.0
        n = draw_above_horizon(
            points, face_normals, lights, distant, beyond, start, uniform, texel, shift, begin, end, rows
        )
        write_rays(points, face_normals, lights, distant, *frame, rows, sources, ways, lengths, 0, n)
        for r in range(n):
            i, j = np.uint32(rows[r, 0]), np.uint32(rows[r, 1])
            for k in range(3):
                packed[k, size] = points[i, k]
                packed[3 + k, size] = normals[i, k]
                packed[6 + k, size] = narrow_lights[j, k]
            packed[9, size] = worth[j]
            at[size] = i
            size += np.uint64(not meets_something(scene, ray, r, sources, ways, lengths[r]))
            if size < LANES and r + 1 < n:
                continue
            shares_of_lanes(packed, narrow_lights, luminances, distant, least, found)
            write_shares(found, at, size, block, shares, cosine_shares, sums, squares)
            size = np.uint64(0)
        rays += n
    return rays
