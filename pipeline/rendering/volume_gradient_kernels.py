"""Backward pass of marching rays through boxes of voxels.

Opacity is added along a ray, so the gradient of a sample does not depend on those before it: rays are marched again
from front to back. With g the gradient of the picture, c_k the features of a sample in one box, m_n their mean at the
step n that reaches an opacity of 1, where A before it is A_b,

    dL/dalpha = step (g . c_k + g_alpha)                 if no step reaches 1
    dL/dalpha = step (g . c_k - g . m_n)                 before step n: what a sample adds, step n has to give
    dL/dalpha = (1 - A_b) / sum(alpha) (g . c_k - g . m_n)                at step n

all finite. Rows of tiles are dealt to BANDS bands with gradients of their own, which are added up in their order: the
same bits on every run and any number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.rendering.projection_kernels import TILE
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE
from pipeline.rendering.volume_kernels import DENSITY, TINT, add_step, fade_at, place_in, voxel_at
from pipeline.rendering.volume_ray_kernels import (
    ENTERS,
    LEAVES,
    STRETCH_COLUMNS,
    direction_of,
    find_stretches,
    next_step,
)

BANDS = 4
"""Bands of a picture, each with gradients of its own: as many threads can work side by side."""

POSE_COLUMNS = 12
"""Gradients of a box's pose: of the matrix from the world, row by row, then of y, from which the centre's follows."""


@kernel_part(fastmath=True)
def features_backward(features, tinted, voxel, y, weight, grad, of_features, of_voxel, of_y):
    """Gradients of weight * (g . features at a place): of the features, the tint and the place.

    Returns g . features.
    """
    x0, x, x_per_unit = place_in(features.shape[1], y[0])
    y0, v, y_per_unit = place_in(features.shape[0], y[1])
    x1, y1 = min(x0 + 1, features.shape[1] - 1), min(y0 + 1, features.shape[0] - 1)
    shown = 0.0
    for c in range(features.shape[2]):
        a, b = features[y0, x0, c], features[y0, x1, c]
        d, e = features[y1, x0, c], features[y1, x1, c]
        low, high = (1 - x) * a + x * b, (1 - x) * d + x * e
        value = (1 - v) * low + v * high
        factor = voxel[TINT + tinted[c]] if tinted[c] >= 0 else 1.0
        shown += grad[c] * factor * value
        upstream = weight * grad[c]
        if tinted[c] >= 0:
            of_voxel[TINT + tinted[c]] += upstream * value
        upstream *= factor
        of_features[y0, x0, c] += upstream * (1 - v) * (1 - x)
        of_features[y0, x1, c] += upstream * (1 - v) * x
        of_features[y1, x0, c] += upstream * v * (1 - x)
        of_features[y1, x1, c] += upstream * v * x
        of_y[0] += upstream * x_per_unit * ((1 - v) * (b - a) + v * (e - d))
        of_y[1] += upstream * y_per_unit * (high - low)
    return shown


@kernel_part(fastmath=True)
def voxel_backward(voxels, y, of_voxel, of_voxels, of_y):
    """Gradients of a box's voxels and of the place, from those of the voxel between them."""
    x0, x, x_per_unit = place_in(voxels.shape[2], y[0])
    y0, v, y_per_unit = place_in(voxels.shape[1], y[1])
    z0, z, z_per_unit = place_in(voxels.shape[0], y[2])
    x1, y1, z1 = (min(x0 + 1, voxels.shape[2] - 1), min(y0 + 1, voxels.shape[1] - 1), min(z0 + 1, voxels.shape[0] - 1))
    for c in range(4):
        upstream = of_voxel[c]
        near = 0.0
        along_x, along_y = 0.0, 0.0
        for layer in range(2):
            k = z1 if layer else z0
            depth = z if layer else 1 - z
            a, b, d, e = voxels[k, y0, x0, c], voxels[k, y0, x1, c], voxels[k, y1, x0, c], voxels[k, y1, x1, c]
            low, high = (1 - x) * a + x * b, (1 - x) * d + x * e
            value = (1 - v) * low + v * high
            along_x += depth * ((1 - v) * (b - a) + v * (e - d))
            along_y += depth * (high - low)
            near = value - near  # the near one, then the difference to the far one
            of_voxels[k, y0, x0, c] += upstream * depth * (1 - v) * (1 - x)
            of_voxels[k, y0, x1, c] += upstream * depth * (1 - v) * x
            of_voxels[k, y1, x0, c] += upstream * depth * v * (1 - x)
            of_voxels[k, y1, x1, c] += upstream * depth * v * x
        of_y[0] += upstream * x_per_unit * along_x
        of_y[1] += upstream * y_per_unit * along_y
        of_y[2] += upstream * z_per_unit * near


@kernel_part(fastmath=True)
def step_backward(
    t, stretches, boxes, count, first, voxels, features, tinted, spheres, direction, grad, background, share, scratch,
    of_features, of_voxels, of_pose,
):  # fmt: skip
    """Gradients of all boxes at distance t: a sample of one adds share * alpha * (g . features + background)."""
    y, voxel, of_voxel, of_y = scratch[:3], scratch[3:7], scratch[7:11], scratch[11:14]
    for hit in range(first, count):
        if stretches[hit, ENTERS] > t:
            break
        if stretches[hit, LEAVES] < t:
            continue
        box = boxes[hit]
        factor = fade_at(stretches[hit], t, y)
        voxel_at(voxels[box], y, voxel)
        of_voxel[:] = 0.0
        of_y[:] = 0.0
        weight = share * factor * voxel[DENSITY]
        args = (features[box], tinted, voxel, y, weight, grad, of_features[box], of_voxel, of_y)
        of_alpha = share * (features_backward(*args) + background)
        of_voxel[DENSITY] = of_alpha * factor
        for axis in range(3):
            slope = -FADE_SCALE * FADE_POWER * y[axis] ** (FADE_POWER - 1)
            of_y[axis] += of_alpha * voxel[DENSITY] * factor * slope
        voxel_backward(voxels[box], y, of_voxel, of_voxels[box], of_y)
        for axis in range(3):
            for k in range(3):
                of_pose[box, 3 * axis + k] += of_y[axis] * (t * direction[k] - spheres[box, k])
            of_pose[box, 9 + axis] += of_y[axis]


@kernel(parallel=True, fastmath=True)
def march_backward(
    inverses, origins, spheres, voxels, features, tinted, tile_start, entries, tiles_across, R, K, step,
    ends, before, grad_image, grad_reached, grad_depth, of_features, of_voxels, of_pose,
):  # fmt: skip
    """Add gradients of features, voxels and poses, of each band to its own [bands, b, ...]."""
    height, width = ends.shape
    channels = features.shape[3]
    tiles_down = (tile_start.shape[0] - 1) // tiles_across
    for band in prange(of_pose.shape[0]):
        scratch, total, direction, grad = np.empty(14), np.empty(channels), np.empty(3), np.empty(channels)
        for tile_row in range(band, tiles_down, of_pose.shape[0]):
            for tile_column in range(tiles_across):
                tile = tile_row * tiles_across + tile_column
                own = entries[tile_start[tile] : tile_start[tile + 1]]
                if own.shape[0] == 0:
                    continue
                stretches, boxes = np.empty((own.shape[0] + 1, STRETCH_COLUMNS)), np.empty(own.shape[0] + 1, np.int64)
                for row in range(tile_row * TILE, min(tile_row * TILE + TILE, height)):
                    for column in range(tile_column * TILE, min(tile_column * TILE + TILE, width)):
                        of_depth = direction_of(R, K, row, column, direction) * grad_depth[row, column]
                        count = find_stretches(inverses, origins, spheres, direction, step, own, stretches, boxes)
                        for c in range(channels):
                            grad[c] = grad_image[row, column, c]
                        end, base, of_end, share = ends[row, column], grad_reached[row, column], 0.0, 0.0
                        if end >= 0:
                            t = (end + 0.5) * step
                            args = (t, stretches, boxes, count, 0, voxels, features, tinted, scratch[:7], total)
                            alpha = add_step(*args)
                            for c in range(channels):
                                of_end += grad[c] * total[c] / alpha
                            base, share = -of_end - of_depth * t, (1.0 - before[row, column]) / alpha
                        k, first = 0, 0
                        while end < 0 or k < end:
                            wanted, first = next_step(k, step, first, stretches, count)
                            if wanted < 0:
                                break
                            if wanted > k:
                                k = wanted
                                continue
                            t = (k + 0.5) * step
                            step_backward(
                                t, stretches, boxes, count, first, voxels, features, tinted, spheres, direction,
                                grad, base + of_depth * t, step, scratch, of_features[band], of_voxels[band],
                                of_pose[band],
                            )  # fmt: skip
                            k += 1
                        if end >= 0:
                            step_backward(
                                (end + 0.5) * step, stretches, boxes, count, 0, voxels, features, tinted, spheres,
                                direction, grad, -of_end, share, scratch, of_features[band], of_voxels[band],
                                of_pose[band],
                            )  # fmt: skip
