"""The arithmetic around shadow rays: the ray of a point and a light, and sums over lights.

Embree answers a ray in one or two hundred nanoseconds, as long as a few NumPy operations on it take; these loops keep
all of the rest at a quarter of that. They run on one thread each and without the interpreter's lock, so frames are
computed side by side. Asserted widths of arrays spare a multiplication per index. Lights are rows [x, y, z] of
positions, or, with `distant`, of unit directions towards them: then they have no distance, and light does not fall off.
`least2` bounds squared distances to lights from below.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.kernel_cache import EXACT_FUNCTIONS, kernel

ray_kernel = kernel(nogil=True, error_model="numpy", fastmath=EXACT_FUNCTIONS)
"""Decorates a kernel as `unlocked_kernel` does, and lets sums be reordered."""

PAIRS_AT_ONCE = 4096
"""Pairs that are found before their rays are made: their points still lie in the nearest cache."""


@ray_kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def share_of_arriving(points, normals, axes, luminances, distant, least2, arrived, cosine_arrived):
    """Divide, in place, sums over lights that are seen by sums over all lights.

    What arrived at each point by the sum of L_j, what arrived times cosines by the sum of L_j max(0, n . w_j). Where
    nothing arrived, nothing is summed; where nothing can fall, the share is 0.

    Args:
        axes: the lights' x, then y, then z [3, lights]; luminances: the largest of them 1.
    """
    x, y, z = axes[0], axes[1], axes[2]
    for i in range(points.shape[0]):
        if not arrived[i] > 0:
            continue
        total, cosine_total = 0.0, 0.0
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        if distant:
            for j in range(luminances.shape[0]):
                along = nx * x[j] + ny * y[j] + nz * z[j]
                total += luminances[j]
                cosine_total += luminances[j] * (along if along > 0.0 else 0.0)
        else:
            for j in range(luminances.shape[0]):
                dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
                squared = dx * dx + dy * dy + dz * dz
                inverse = 1.0 / np.sqrt(squared if squared > least2 else least2)
                light, along = luminances[j] * inverse * inverse, nx * dx + ny * dy + nz * dz
                total += light
                cosine_total += light * inverse * (along if along > 0.0 else 0.0)
        arrived[i] /= total
        cosine_arrived[i] = cosine_arrived[i] / cosine_total if cosine_total > 0 else 0.0


@ray_kernel
@no_type_check
def height(x, y, z, px, py, pz, nx, ny, nz, distant):
    """Height of a light over the face at a point; of a distant light, its cosine.

    Of numbers: called with the arrays that they stand in, it makes maps of single rays a fifth slower.
    """
    if distant:
        return x * nx + y * ny + z * nz
    return (x - px) * nx + (y - py) * ny + (z - pz) * nz


@ray_kernel
@no_type_check
def write_rays(
    points, normals, lights, distant, center, half_extent, offset, clearance, farthest, rows, sources, ways, lengths,
    begin, end,
):  # fmt: skip
    """Rays `begin` to `end` of the pairs in `rows`; arguments as of `aim`."""
    assert points.shape[1] == normals.shape[1] == lights.shape[1] == sources.shape[1] == ways.shape[1] == 3
    assert rows.shape[1] == 2
    shrink, step = 1.0 / half_extent, offset * half_extent
    cx, cy, cz = center[0], center[1], center[2]
    for r in range(np.uint64(begin), np.uint64(end)):
        i, j = np.uint32(rows[r, 0]), np.uint32(rows[r, 1])
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        dx, dy, dz = lights[j, 0], lights[j, 1], lights[j, 2]
        length = farthest
        if not distant:
            dx, dy, dz = dx - px - step * nx, dy - py - step * ny, dz - pz - step * nz
            full = np.sqrt(dx * dx + dy * dy + dz * dz)
            inverse = 1.0 / max(full, 1e-300)
            dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
            length = full * shrink * (1.0 - clearance)
        sources[r, 0] = (px - cx) * shrink + offset * nx
        sources[r, 1] = (py - cy) * shrink + offset * ny
        sources[r, 2] = (pz - cz) * shrink + offset * nz
        ways[r, 0], ways[r, 1], ways[r, 2] = dx, dy, dz
        lengths[r] = length


@ray_kernel
@no_type_check
def aim(
    points, normals, lights, distant, chosen, first, center, half_extent, offset, clearance, farthest, rows, sources,
    ways, lengths,
):  # fmt: skip
    """Rays from points to lights, of the pairs whose light is above the horizon.

    Returns how many were written. First some pairs are found, without a branch to guess wrong, then their rays made.

    Args:
        chosen: a light per point; or empty: lights from `first` on, as many as there is room for in `rows`.
        center, half_extent: of Embree's scene, where rays are written: centred, the half extent 1.
        offset: how far along its normal a ray starts, in that scene.
        clearance: share of the way that a ray leaves out at its end.
        farthest: length of rays to distant lights, in that scene.
        rows: point and light of each ray [., 2]; written, as are all that follow, the first n entries.
        sources, ways: origins and unit directions.
    """
    assert points.shape[1] == normals.shape[1] == lights.shape[1] == 3 and rows.shape[1] == 2
    rays, several, count = 0, chosen.shape[0] > 0, points.shape[0]
    for block in range(1 if several else rows.shape[0] // max(count, 1)):
        for start in range(0, count, PAIRS_AT_ONCE):
            n = np.uint64(rays)
            for i in range(np.uint64(start), np.uint64(min(start + PAIRS_AT_ONCE, count))):
                j = np.uint32(chosen[i] if several else first + block)
                rows[n, 0], rows[n, 1] = i, j
                above = height(
                    lights[j, 0], lights[j, 1], lights[j, 2], points[i, 0], points[i, 1], points[i, 2], normals[i, 0],
                    normals[i, 1], normals[i, 2], distant,
                )  # fmt: skip
                n += np.uint64(above > 0)
            write_rays(
                points, normals, lights, distant, center, half_extent, offset, clearance, farthest, rows, sources,
                ways, lengths, rays, np.int64(n),
            )  # fmt: skip
            rays = np.int64(n)
    return rays


@ray_kernel
@no_type_check
def add_clear_rays(
    points, normals, lights, luminances, distant, least2, probability, rows, hits, arrived, cosine_arrived
):
    """Add L_j of every ray that met nothing (-1), plain and cosine-weighted. Over the probability, if that is given."""
    assert points.shape[1] == normals.shape[1] == lights.shape[1] == 3 and rows.shape[1] == 2
    drawn = probability.shape[0] > 0
    for r in range(hits.shape[0]):
        if hits[r] != -1:
            continue
        i, j = np.uint32(rows[r, 0]), np.uint32(rows[r, 1])
        dx, dy, dz = lights[j, 0], lights[j, 1], lights[j, 2]
        light, cosine = luminances[j], 0.0
        if distant:
            cosine = dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]
        else:
            dx, dy, dz = dx - points[i, 0], dy - points[i, 1], dz - points[i, 2]
            squared = max(dx * dx + dy * dy + dz * dz, least2)
            light /= squared
            cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / np.sqrt(squared)
        if drawn:
            light /= probability[i]
        arrived[i] += light
        cosine_arrived[i] += light * max(cosine, 0.0)


@ray_kernel
@no_type_check
def add_seen_bits(points, normals, light, luminance, distant, least2, bits, arrived, cosine_arrived):
    """Add one light at the points whose bit is set.

    The most significant bit of a byte comes first, as np.packbits has it.
    """
    assert points.shape[1] == normals.shape[1] == 3
    for i in range(np.uint64(points.shape[0])):
        if not bits[i >> 3] & (128 >> (i & 7)):
            continue
        dx, dy, dz, strength = light[0], light[1], light[2], luminance
        if not distant:
            dx, dy, dz = dx - points[i, 0], dy - points[i, 1], dz - points[i, 2]
            squared = max(dx * dx + dy * dy + dz * dz, least2)
            strength /= squared
            inverse = 1.0 / np.sqrt(squared)
            dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        cosine = dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]
        arrived[i] += strength
        cosine_arrived[i] += strength * max(cosine, 0.0)
