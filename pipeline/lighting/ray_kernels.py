"""The arithmetic around shadow rays, one pass each.

What arrives at a point, which light it draws, its ray, its sum.

Embree answers a ray in about a hundred nanoseconds, as long as a few NumPy operations on it take; these loops keep all
of the rest below a quarter of that. They run on one thread each and without the interpreter's lock, so frames are
computed side by side. Lights are rows [x, y, z] of positions, or, with `distant`, of unit directions towards them: then
they have no distance, and light does not fall off. `least2` bounds squared distances to lights from below.
"""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np

kernel = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp", "reassoc"})
"""Without nnan and ninf: those would let the compiler drop what keeps unusual values harmless. NumPy's division, which
gives infinity where Python's raises: a loop that may raise is not vectorised (eight times slower)."""


@kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def share_of_arriving(points, normals, axes, luminances, distant, least2, arrived, cosine_arrived):
    """Divide, in place, sums over lights that are seen by sums over all lights.

    What arrived at each point by the sum of L_j, what arrived times cosines by the sum of L_j max(0, n . w_j). Where
    nothing arrived, nothing is summed; where nothing can fall, the share is 0.

    The sums are in the number type of the lights: float64, or where a single drawn light is all that is known of a
    point, float32: eight lights at a time, four times as fast, and with a thousand lights the sums are dearer than the
    rays. The relative error then is below (4 + m / 8) 2^-24 for m lights, 8e-6 for a thousand: a half float, as maps
    are stored, has 5e-4.

    Args:
        axes: the lights' x, then y, then z [3, lights]; luminances: the largest of them 1.
    """
    number = luminances.dtype.type
    one, nothing, least = number(1), number(0), number(least2)
    x, y, z = axes[0], axes[1], axes[2]
    for i in range(points.shape[0]):
        if not arrived[i] > 0:
            continue
        total, cosine_total = nothing, nothing
        px, py, pz = number(points[i, 0]), number(points[i, 1]), number(points[i, 2])
        nx, ny, nz = number(normals[i, 0]), number(normals[i, 1]), number(normals[i, 2])
        if distant:
            for j in range(luminances.shape[0]):
                along = nx * x[j] + ny * y[j] + nz * z[j]
                total += luminances[j]
                cosine_total += luminances[j] * (along if along > nothing else nothing)
        else:
            for j in range(luminances.shape[0]):
                dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
                squared = dx * dx + dy * dy + dz * dz
                inverse = one / np.sqrt(squared if squared > least else least)
                light, along = luminances[j] * inverse * inverse, nx * dx + ny * dy + nz * dz
                total += light
                cosine_total += light * inverse * (along if along > nothing else nothing)
        arrived[i] /= total
        cosine_arrived[i] = cosine_arrived[i] / cosine_total if cosine_total > nothing else 0.0


@kernel
@no_type_check
def lattice_numbers(texel, across, down, shift, uniform):
    """Fractional part of across * column + down * row + shift, per texel."""
    for i in range(texel.shape[0]):
        number = texel[i, 0] * down + texel[i, 1] * across + shift
        uniform[i] = number - np.floor(number)


@kernel
@no_type_check
def block_variances(values, block, count, variance):
    """Add to every texel the unbiased variance of the values in its block; 0 where it is alone.

    Args:
        block: number of each texel's block, unsigned (numba checks signed indices for being negative).
        count: texels in each block.
    """
    mean, spread = np.zeros(count.shape[0]), np.zeros(count.shape[0])
    for i in range(values.shape[0]):
        mean[block[i]] += values[i]
    for b in range(count.shape[0]):
        mean[b] /= max(count[b], 1.0)
    for i in range(values.shape[0]):
        spread[block[i]] += (values[i] - mean[block[i]]) ** 2
    for b in range(count.shape[0]):
        spread[b] /= max(count[b] - 1.0, 1.0)
    for i in range(values.shape[0]):
        variance[i] += spread[block[i]]


@kernel
@no_type_check
def draw_by_weight(weights, uniform, chosen, probability):
    """Draw one light per point with probability proportional to its weight.

    By inversion of the cumulative distribution.

    A table tells where in it to start looking (Chen and Asau 1974): a step or two from there is the light.
    """
    cumulative = np.cumsum(weights)
    last, cells = len(weights) - 1, 4 * len(weights)
    total = cumulative[last]
    start, light = np.empty(cells + 1, np.int32), 0
    for c in range(cells + 1):
        while light < last and cumulative[light] <= c / cells * total:
            light += 1
        start[c] = light
    for i in range(uniform.shape[0]):
        j, target = start[int(uniform[i] * cells)], uniform[i] * total
        # Rounding may put the start one light too far, and carry the target up to the very end.
        while j > 0 and cumulative[j - 1] > target:
            j -= 1
        while j < last and cumulative[j] <= target:
            j += 1
        chosen[i] = j
        probability[i] = weights[j] / total


@kernel
@no_type_check
def draw_by_arrival(points, lights, luminances, distant, least2, per_arriving, uniform, chosen, probability):
    """Draw one light per point with probability proportional to what would arrive.

    `per_arriving`: 1 over the sum of all.

    A second pass over the lights instead of a table of points x lights: memory does not grow with the lights.
    """
    for i in range(points.shape[0]):
        target, reached, j, light = uniform[i] / per_arriving[i], 0.0, -1, 0.0
        while j + 1 < lights.shape[0] and reached <= target:
            j += 1
            light = luminances[j]
            if not distant:
                dx, dy, dz = lights[j, 0] - points[i, 0], lights[j, 1] - points[i, 1], lights[j, 2] - points[i, 2]
                light /= max(dx * dx + dy * dy + dz * dz, least2)
            reached += light
        chosen[i] = j
        probability[i] = light * per_arriving[i]


@kernel
@no_type_check
def aim(
    points,
    normals,
    lights,
    chosen,
    first,
    distant,
    center,
    half_extent,
    offset,
    clearance,
    farthest,
    rows,
    sources,
    ways,
    lengths,
):
    """Rays from points to lights, of the pairs whose light is above the horizon.

    Returns how many were written.

    Args:
        chosen: a light per point; or empty: lights from `first` on, as many as there is room for in `rows`.
        center, half_extent: of Embree's scene, where rays are written: centred, the half extent 1.
        offset: how far along its normal a ray starts, in that scene.
        clearance: share of the way that a ray leaves out at its end.
        farthest: length of rays to distant lights, in that scene.
        rows: point and light of each ray [., 2]; written, as are all that follow, the first n entries.
        sources, ways: origins and unit directions.
    """
    n, count, several = 0, points.shape[0], chosen.shape[0] > 0
    shrink, step = 1.0 / half_extent, offset * half_extent
    cx, cy, cz = center[0], center[1], center[2]
    for block in range(1 if several else rows.shape[0] // max(count, 1)):
        for i in range(count):
            j = chosen[i] if several else first + block
            nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
            px, py, pz = points[i, 0], points[i, 1], points[i, 2]
            dx, dy, dz = lights[j, 0], lights[j, 1], lights[j, 2]
            if not distant:
                dx, dy, dz = dx - px, dy - py, dz - pz
            if not dx * nx + dy * ny + dz * nz > 0:
                continue
            length = farthest
            if not distant:
                dx, dy, dz = dx - step * nx, dy - step * ny, dz - step * nz
                full = np.sqrt(dx * dx + dy * dy + dz * dz)
                inverse = 1.0 / max(full, 1e-300)
                dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
                length = full * shrink * (1.0 - clearance)
            rows[n, 0], rows[n, 1] = i, j
            sources[n, 0] = (px - cx) * shrink + offset * nx
            sources[n, 1] = (py - cy) * shrink + offset * ny
            sources[n, 2] = (pz - cz) * shrink + offset * nz
            ways[n, 0], ways[n, 1], ways[n, 2] = dx, dy, dz
            lengths[n] = length
            n += 1
    return n


@kernel
@no_type_check
def add_clear_rays(
    points, normals, lights, luminances, distant, least2, probability, rows, hits, arrived, cosine_arrived
):
    """Add L_j of every ray that met nothing (-1), plain and cosine-weighted. Over the probability, if that is given."""
    drawn = probability.shape[0] > 0
    for r in range(hits.shape[0]):
        if hits[r] != -1:
            continue
        i, j = rows[r, 0], rows[r, 1]
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


@kernel
@no_type_check
def add_seen_bits(points, normals, light, luminance, distant, least2, bits, arrived, cosine_arrived):
    """Add one light at the points whose bit is set.

    The most significant bit of a byte comes first, as np.packbits has it.
    """
    for i in range(points.shape[0]):
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
