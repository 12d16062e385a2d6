"""Backward pass of the blending: back to front through each tile.

One thread owns a tile, as in the forward pass; the gradient of a Gaussian has one slot per tile that it touches,
written by that tile alone and summed later in a fixed order. No atomics: the same bits on every run and any number of
threads.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.rendering.blending_kernels import exp_nonpositive, reach, row_range
from pipeline.rendering.projection_kernels import (
    MOMENT_COLUMNS,
    OPACITY,
    STEP,
    SUM_G,
    SUM_GE,
    SUM_GEE,
    SUM_GEH,
    SUM_GH,
    SUM_GHH,
    TILE,
)
from pipeline.rendering.splat_conventions import MAX_ALPHA, MIN_ALPHA
from pipeline.rendering.vector_intrinsics import add_product, add_scaled, lane_sum

f32 = np.float32


@kernel_part(inline=True, fastmath=True)
def _unblend_row(opacity, step, column, nearest_e, h, i, light, ends, weight, inverse, raw, row):
    """The weights of `_blend_row` again, from the light behind the Gaussian; `light` becomes the light before it.

    Also writes 1 / (1 - alpha), and the alpha before the limit MAX_ALPHA where it has a gradient, 0 elsewhere.
    """
    seen = f32(0)
    for k in range(TILE):
        e = nearest_e + (f32(k) - column) * step
        unlimited = opacity * exp_nonpositive(f32(-0.5) * (h * h + e * e))
        alpha = min(f32(MAX_ALPHA), unlimited)
        alpha = alpha if alpha >= f32(MIN_ALPHA) else f32(0)
        alpha = alpha if i < ends[row, k] else f32(0)
        inverse[k] = f32(1) / (f32(1) - alpha)
        light[row, k] *= inverse[k]
        weight[k] = alpha * light[row, k]
        raw[k] = alpha if unlimited <= f32(MAX_ALPHA) else f32(0)
        seen += weight[k]
    return seen


@kernel_part(inline=True, fastmath=True)
def _add_moments(step, column, nearest_e, h, light, behind, weight, inverse, raw, shade, moments, row):
    """dL/dq of a row of pixels, times what its footprint parameters' gradients need, lane by lane; updates `behind`.

    dL/dalpha_i = T_i s_i - (sum_{j > i} w_j s_j) / (1 - alpha_i), with s = dL/dpixel . channels (Kerbl et al. 2023,
    appendix); `behind` is that sum, with the gradient of alpha as its background.
    """
    for k in range(TILE):
        e = nearest_e + (f32(k) - column) * step
        slope = light[row, k] * shade[k] - behind[row, k] * inverse[k]
        behind[row, k] += weight[k] * shade[k]
        g = f32(-0.5) * raw[k] * slope
        moments[SUM_G, k] += g
        moments[SUM_GE, k] += g * e
        moments[SUM_GEE, k] += g * e * e
        moments[SUM_GH, k] += g * h
        moments[SUM_GEH, k] += g * e * h
        moments[SUM_GHH, k] += g * h * h


@kernel(parallel=True, fastmath=True)
def blend_backward(
    footprints, channels, tile_start, entries, tiles_across, tiles, slot_start, transmittance, ends_image,
    grad_features, grad_depth, grad_alpha, slots,
):  # fmt: skip
    """Write gradients of (Gaussian, tile) to rows of `slots` [s, d + 1 + 6].

    Back to front through each tile.

    The first d + 1 columns are the gradient of the channels, the others the moments of dL/dq (`SUM_G` ...).
    """
    height, width = grad_depth.shape
    count = channels.shape[1]
    for tile in prange(tile_start.shape[0] - 1):
        tile_row, tile_column = tile // tiles_across, tile % tiles_across
        top, left = tile_row * TILE, tile_column * TILE
        rows, columns = min(TILE, height - top), min(TILE, width - left)
        light = np.ones((TILE, TILE), np.float32)
        behind = np.zeros((TILE, TILE), np.float32)
        ends = np.zeros((TILE, TILE), np.int32)
        row_end = np.zeros(TILE, np.int32)
        grad_image = np.zeros((TILE, count, TILE), np.float32)
        for row in range(rows):
            for k in range(columns):
                y, x = top + row, left + k
                light[row, k], ends[row, k] = transmittance[y, x], ends_image[y, x]
                behind[row, k] = -grad_alpha[y, x] * transmittance[y, x]
                row_end[row] = max(row_end[row], ends[row, k])
                grad_image[row, count - 1, k] = grad_depth[y, x]
                for c in range(count - 1):
                    grad_image[row, c, k] = grad_features[y, x, c]
        weight, inverse = np.empty(TILE, np.float32), np.empty(TILE, np.float32)
        raw, shade = np.empty(TILE, np.float32), np.empty(TILE, np.float32)
        sums = np.zeros((count + MOMENT_COLUMNS, TILE), np.float32)
        moments = sums[count:]
        for i in range(row_end.max() - 1, -1, -1):
            g = entries[tile_start[tile] + i]
            footprint = footprints[g]
            opacity, step = f32(footprint[OPACITY]), f32(footprint[STEP])
            first, last = row_range(footprint, top, rows)
            touched = False
            for row in range(first, last):
                column, e, h, reached = reach(footprint, top + row, left)
                if not (reached and i < row_end[row]):
                    continue
                seen = _unblend_row(opacity, step, column, e, h, np.int32(i), light, ends, weight, inverse, raw, row)
                if seen > f32(0):
                    touched = True
                    shade[:] = f32(0)
                    for c in range(count):
                        at = (row * count + c) * TILE
                        add_scaled(shade, 0, grad_image, at, channels[g, c])
                        add_product(sums, c * TILE, weight, 0, grad_image, at)
                    _add_moments(step, column, e, h, light, behind, weight, inverse, raw, shade, moments, row)
            if touched:
                across = tiles[g, 1] - tiles[g, 0] + 1
                slot = slot_start[g] + (tile_row - tiles[g, 2]) * across + tile_column - tiles[g, 0]
                for c in range(count + MOMENT_COLUMNS):
                    slots[slot, c] = lane_sum(sums, c * TILE)
                sums[:] = f32(0)
