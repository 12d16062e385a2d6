"""Marching rays through boxes of voxels, 16 x 16 pixels at a time.

One thread owns a tile. A ray first finds the stretches of itself that lie in the tile's boxes, nearest first, then
looks at each step into those that it is in, and ends where its opacity is 1. Tiles share nothing but read-only inputs,
so the result does not depend on the number of threads. Arithmetic is in float64 whatever the type of the arrays.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.rendering.projection_kernels import TILE
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE
from pipeline.rendering.volume_ray_kernels import (
    ENTERS,
    LEAVES,
    SLOPE,
    START,
    STRETCH_COLUMNS,
    direction_of,
    find_stretches,
    next_step,
)

DENSITY, TINT = 0, 1
"""Channels of a voxel: the density, and from the second on the three of the tint."""


@kernel_part(fastmath=True)
def place_in(size, y):
    """The voxel below a coordinate, the share of the one above, and voxels per unit."""
    per_unit = 0.5 * (size - 1)
    at = (min(max(y, -1.0), 1.0) + 1.0) * per_unit
    low = min(int(at), max(size - 2, 0))
    return low, at - low, per_unit


@kernel_part(fastmath=True)
def fade_at(stretch, t, y):
    """Factor by which a box ends at its faces, at distance t of a ray; fills in the place there."""
    total = 0.0
    for axis in range(3):
        y[axis] = stretch[START + axis] + t * stretch[SLOPE + axis]
        total += y[axis] ** FADE_POWER
    return math.exp(-FADE_SCALE * total)


@kernel_part(fastmath=True)
def voxel_at(voxels, y, found):
    """The four channels of a box's voxels at a place."""
    x0, x, _ = place_in(voxels.shape[2], y[0])
    y0, v, _ = place_in(voxels.shape[1], y[1])
    z0, z, _ = place_in(voxels.shape[0], y[2])
    x1, y1, z1 = (min(x0 + 1, voxels.shape[2] - 1), min(y0 + 1, voxels.shape[1] - 1), min(z0 + 1, voxels.shape[0] - 1))
    for c in range(4):
        near = (1 - v) * ((1 - x) * voxels[z0, y0, x0, c] + x * voxels[z0, y0, x1, c])
        near += v * ((1 - x) * voxels[z0, y1, x0, c] + x * voxels[z0, y1, x1, c])
        far = (1 - v) * ((1 - x) * voxels[z1, y0, x0, c] + x * voxels[z1, y0, x1, c])
        far += v * ((1 - x) * voxels[z1, y1, x0, c] + x * voxels[z1, y1, x1, c])
        found[c] = (1 - z) * near + z * far


@kernel_part(fastmath=True)
def add_features(features, tinted, voxel, y, weight, total):
    """Add the features of a box's columns at a place, tinted and weighted."""
    x0, x, _ = place_in(features.shape[1], y[0])
    y0, v, _ = place_in(features.shape[0], y[1])
    x1, y1 = min(x0 + 1, features.shape[1] - 1), min(y0 + 1, features.shape[0] - 1)
    for c in range(features.shape[2]):
        low = (1 - x) * features[y0, x0, c] + x * features[y0, x1, c]
        high = (1 - x) * features[y1, x0, c] + x * features[y1, x1, c]
        factor = voxel[TINT + tinted[c]] if tinted[c] >= 0 else 1.0
        total[c] += weight * factor * ((1 - v) * low + v * high)


@kernel_part(fastmath=True)
def add_step(t, stretches, boxes, count, first, voxels, features, tinted, scratch, total):
    """Alpha of all boxes at distance t of a ray, and in `total` their features weighted by it.

    `scratch` [7] holds a place and a voxel. Boxes before `first` are behind.
    """
    total[:] = 0.0
    alpha = 0.0
    y, voxel = scratch[:3], scratch[3:]
    for hit in range(first, count):
        if stretches[hit, ENTERS] > t:
            break
        if stretches[hit, LEAVES] < t:
            continue
        box = boxes[hit]
        factor = fade_at(stretches[hit], t, y)
        voxel_at(voxels[box], y, voxel)
        of_box = factor * voxel[DENSITY]
        if of_box > 0.0:
            alpha += of_box
            add_features(features[box], tinted, voxel, y, of_box, total)
    return alpha


@kernel(parallel=True, fastmath=True)
def march_forward(
    inverses, origins, spheres, voxels, features, tinted, tile_start, entries, tiles_across, R, K, step,
    image, reached, depth, ends, before,
):  # fmt: skip
    """Fill in features [h, w, d], opacity [h, w], depth [h, w], `ends` and `before` [h, w].

    `ends` is the step that reached an opacity of 1, -1 if none did; `before` the opacity that it found.
    """
    height, width = depth.shape
    channels = features.shape[3]
    for tile in prange(tile_start.shape[0] - 1):
        own = entries[tile_start[tile] : tile_start[tile + 1]]
        stretches, boxes = np.empty((own.shape[0] + 1, STRETCH_COLUMNS)), np.empty(own.shape[0] + 1, np.int64)
        scratch, total, sums, direction = np.empty(7), np.empty(channels), np.empty(channels), np.empty(3)
        top, left = (tile // tiles_across) * TILE, (tile % tiles_across) * TILE
        for row in range(top, min(top + TILE, height)):
            for column in range(left, min(left + TILE, width)):
                depth_per_m = direction_of(R, K, row, column, direction)
                count = find_stretches(inverses, origins, spheres, direction, step, own, stretches, boxes)
                sums[:] = 0.0
                opacity, far, end, k, first = 0.0, 0.0, -1, 0, 0
                while True:
                    # A step found behind a gap may itself fall between boxes that are thinner than it.
                    wanted, first = next_step(k, step, first, stretches, count)
                    if wanted < 0:
                        break
                    if wanted > k:
                        k = wanted
                        continue
                    t = (k + 0.5) * step
                    alpha = add_step(t, stretches, boxes, count, first, voxels, features, tinted, scratch, total)
                    if alpha > 0.0:
                        added = min(step * alpha, 1.0 - opacity)
                        for c in range(channels):
                            sums[c] += added / alpha * total[c]
                        far += added * t
                        if step * alpha >= 1.0 - opacity:
                            end = k
                            break
                        opacity += added
                    k += 1
                before[row, column], ends[row, column] = opacity, end
                reached[row, column], depth[row, column] = opacity if end < 0 else 1.0, far * depth_per_m
                for c in range(channels):
                    image[row, column, c] = sums[c]
