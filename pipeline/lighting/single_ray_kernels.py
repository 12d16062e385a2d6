"""One ray per point, to a light that it draws, and the shares of light that this tells.

Embree answers a ray in 240 nanoseconds. All else together has a quarter of that: what one step makes of a point the
next one uses at once, before it is gone from the nearest cache. The sums over all lights, which turn what arrived into
a share, are dearest. Only a ray that met nothing needs them; such rays are packed into lanes, and turned round.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.float_lanes import LANES, every, fused, inverse_root, larger, load, store
from pipeline.base.kernel_cache import kernel_part, unlocked_kernel
from pipeline.lighting.draw_kernels import cumulative_chances, lattice_number, light_at
from pipeline.lighting.ray_kernels import PAIRS_AT_ONCE, height, ray_kernel, write_rays

PLACES = 10
"""Numbers of a ray: its point, the normal, the light's place or direction, and its luminance over its chance."""

SMALLEST = np.float32(1e-37)
"""Stands for a sum of cosines that is 0: then the ray's own is 0, too, and so is its share."""


@ray_kernel
@no_type_check
def aim_at_drawn(
    points, normals, lights, distant, chances, uniform, texel, shift, center, half_extent, offset, clearance, farthest,
    rows, sources, ways, lengths,
):  # fmt: skip
    """Rays from points to the light that each draws, where that is above the horizon.

    Returns how many were written. Arguments that are not told here are those of `ray_kernels.aim`.

    Args:
        chances: probability of each light.
        uniform: a number in [0, 1) per point; or empty: the lattice number of its `texel` and the `shift`.
    """
    cumulative, table = cumulative_chances(chances)
    rays, lattice, count = 0, uniform.shape[0] == 0, points.shape[0]
    for start in range(0, count, PAIRS_AT_ONCE):
        n = np.uint64(rays)
        for i in range(start, min(start + PAIRS_AT_ONCE, count)):
            number = lattice_number(texel[i, 0], texel[i, 1], shift) if lattice else uniform[i]
            j = light_at(cumulative, table, number)
            rows[n, 0], rows[n, 1] = i, j
            above = height(
                lights[j, 0], lights[j, 1], lights[j, 2], points[i, 0], points[i, 1], points[i, 2], normals[i, 0],
                normals[i, 1], normals[i, 2], distant,
            )  # fmt: skip
            n += np.uint64(above > 0)
        write_rays(
            points, normals, lights, distant, center, half_extent, offset, clearance, farthest, rows, sources, ways,
            lengths, rays, np.int64(n),
        )  # fmt: skip
        rays = np.int64(n)
    return rays


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
    """Shares of sixteen rays, plain and by cosines, from what `shares_of_single_rays` packed."""
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


@unlocked_kernel
@no_type_check
def shares_of_single_rays(
    points, normals, lights, luminances, worth, distant, least2, rows, hits, block, shares, cosine_shares, sums,
    squares,
):  # fmt: skip
    """Estimate each point's shares of light from its only ray.

    0 if there is none, or if it met anything (a hit other than -1). Else L_j / p_j over the sum of all L_j, and
    L_j max(0, n . w_j) / p_j over the sum of all of these. In float32: relative to the largest cosine, errors are below
    (m + 16) 2^-23 for m lights, 8.5e-5 for 700, where a half float, as maps are stored, has 5e-4 and the draw itself 1.

    Args:
        lights, luminances: float32; the largest luminance 1.
        worth: L_j / p_j at a distance of 1; float32.
        rows: point and light of each ray.
        block: of each point, a number.
        sums, squares: of the shares in each block; added to.
    """
    for i in range(shares.shape[0]):
        shares[i], cosine_shares[i] = 0.0, 0.0
    packed, at = np.zeros((PLACES, LANES), np.float32), np.empty(LANES, np.uint32)
    found, least = np.empty((2, LANES), np.float32), every(np.float32(least2))
    size, rays = np.uint64(0), hits.shape[0]
    for r in range(rays):
        if hits[r] == -1:
            i, j = np.uint32(rows[r, 0]), np.uint32(rows[r, 1])
            for k in range(3):
                packed[k, size] = points[i, k]
                packed[3 + k, size] = normals[i, k]
                packed[6 + k, size] = lights[j, k]
            packed[9, size] = worth[j]
            at[size] = i
            size += np.uint64(1)
        if size == 0 or (size < LANES and r + 1 < rays):
            continue
        shares_of_lanes(packed, lights, luminances, distant, least, found)
        for k in range(size):
            i = at[k]
            share, b = np.float64(found[0, k]), block[i]
            shares[i], cosine_shares[i] = found[0, k], found[1, k]
            sums[b] += share
            squares[b] += share * share
        size = np.uint64(0)
