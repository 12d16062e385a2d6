"""The arithmetic around shadow rays, one pass each: what arrives at a point, which light it draws, its ray, its sum.

Embree answers a ray in about a hundred nanoseconds, as long as a few NumPy operations on it take; these loops keep all
of the rest below a quarter of that. They run on one thread each and without the interpreter's lock, so frames are
computed side by side. Lights are rows [x, y, z] of positions, or, with `distant`, of unit directions towards them: then
they have no distance, and light does not fall off. Everything is in Embree's scaled scene (half extent 1), where
`least2` bounds squared distances from below.
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
def arriving_sums(points, normals, axes, luminances, distant, least2, wanted, arriving, falling):
    """Over all lights, at each point that is wanted: sum of L_j, and of L_j max(0, n . w_j).

    In float32, which takes eight lights at a time: with a thousand lights this is dearer than the rays. The relative
    error is below (4 + m / 8) 2^-24 for m lights, 8e-6 for a thousand: a half float, as maps are stored, has 5e-4.

    Args:
        axes: the lights' x, then y, then z [3, lights], float32; luminances: float32, the largest of them 1.
    """
    one, nothing, least = np.float32(1), np.float32(0), np.float32(least2)
    x, y, z = axes[0], axes[1], axes[2]
    for i in range(points.shape[0]):
        if not wanted[i]:
            continue
        total, cosine_total = nothing, nothing
        px, py, pz = np.float32(points[i, 0]), np.float32(points[i, 1]), np.float32(points[i, 2])
        nx, ny, nz = np.float32(normals[i, 0]), np.float32(normals[i, 1]), np.float32(normals[i, 2])
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
        arriving[i], falling[i] = total, cosine_total


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
    """One light per point with probability proportional to its weight, by inversion of the cumulative distribution."""
    cumulative = np.cumsum(weights)
    last = len(weights) - 1
    for i in range(uniform.shape[0]):
        # Rounding may carry the target up to the very end of the distribution.
        j = min(np.searchsorted(cumulative, uniform[i] * cumulative[last], side="right"), last)
        chosen[i] = j
        probability[i] = weights[j] / cumulative[last]


@kernel
@no_type_check
def draw_by_arrival(points, lights, luminances, distant, least2, arriving, uniform, chosen, probability):
    """One light per point with probability proportional to what would arrive; `arriving` is the sum over all lights.

    A second pass over the lights instead of a table of points x lights: memory does not grow with the lights.
    """
    for i in range(points.shape[0]):
        target, reached, j, light = uniform[i] * arriving[i], 0.0, -1, 0.0
        while j + 1 < lights.shape[0] and reached <= target:
            j += 1
            light = luminances[j]
            if not distant:
                dx, dy, dz = lights[j, 0] - points[i, 0], lights[j, 1] - points[i, 1], lights[j, 2] - points[i, 2]
                light /= max(dx * dx + dy * dy + dz * dz, least2)
            reached += light
        chosen[i] = j
        probability[i] = light / arriving[i]


@kernel
@no_type_check
def aim(points, normals, lights, chosen, first, distant, offset, clearance, farthest, rows, sources, ways, lengths):
    """Rays from points to lights, of the pairs whose light is above the horizon; returns how many were written.

    Args:
        chosen: a light per point; or empty: lights from `first` on, as many as there is room for in `rows`.
        offset: how far along its normal a ray starts.
        clearance: share of the way that a ray leaves out at its end.
        farthest: length of rays to distant lights.
        rows: point and light of each ray [., 2]; written, as are all that follow, the first n entries.
        sources, ways: origins and unit directions.
    """
    n, count = 0, points.shape[0]
    several = chosen.shape[0] > 0
    for block in range(1 if several else rows.shape[0] // max(count, 1)):
        for i in range(count):
            j = chosen[i] if several else first + block
            nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
            dx, dy, dz = lights[j, 0], lights[j, 1], lights[j, 2]
            if not distant:
                dx, dy, dz = dx - points[i, 0], dy - points[i, 1], dz - points[i, 2]
            if not dx * nx + dy * ny + dz * nz > 0:
                continue
            length = farthest
            if not distant:
                dx, dy, dz = dx - offset * nx, dy - offset * ny, dz - offset * nz
                full = np.sqrt(dx * dx + dy * dy + dz * dz)
                inverse = 1.0 / max(full, 1e-300)
                dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
                length = full * (1.0 - clearance)
            rows[n, 0], rows[n, 1] = i, j
            sources[n, 0] = points[i, 0] + offset * nx
            sources[n, 1] = points[i, 1] + offset * ny
            sources[n, 2] = points[i, 2] + offset * nz
            ways[n, 0], ways[n, 1], ways[n, 2] = dx, dy, dz
            lengths[n] = length
            n += 1
    return n


@kernel
@no_type_check
def add_clear_rays(points, normals, lights, luminances, distant, least2, probability, rows, hits, arrived, falling):
    """Add L_j of every ray that met nothing (-1), plain and cosine-weighted; over the probability, if that is given."""
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
        falling[i] += light * max(cosine, 0.0)


@kernel
@no_type_check
def add_seen_bits(points, normals, light, luminance, distant, least2, bits, arrived, falling):
    """Add one light at the points whose bit is set (most significant bit of a byte first, as np.packbits has it)."""
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
        falling[i] += strength * max(cosine, 0.0)
