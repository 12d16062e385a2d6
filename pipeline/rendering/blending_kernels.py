"""Front-to-back blending of footprints, 16 x 16 pixels at a time.

One thread owns a tile: a loop over the tile's Gaussians, in it a loop over the rows that the footprint reaches, in it
loops over exactly 16 pixels, which compile to vector instructions. Tiles share nothing but read-only inputs, so the
result does not depend on the number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part
from pipeline.rendering.projection_kernels import (
    CENTER_X,
    CENTER_Y,
    EXTENT_Y,
    INV_STD_Y,
    MAX_Q,
    OPACITY,
    SHEAR,
    STEP,
    TILE,
)
from pipeline.rendering.splat_conventions import MAX_ALPHA, MEDIAN_TRANSMITTANCE, MIN_ALPHA, MIN_TRANSMITTANCE
from pipeline.rendering.vector_intrinsics import add_scaled

GAUSSIANS_PER_LIVE_CHECK = 16
"""A tile looks this often (in Gaussians) whether any of its pixels still lets light through."""

f32 = np.float32
MIN_EXPONENT = f32(-80.0)
"""exp of it is 2e-35, far below MIN_ALPHA; below -87 the exponent bits of the result would wrap around."""

LOG2_E = f32(1.4426950408889634)
EXP2 = tuple(f32(math.log(2) ** n / math.factorial(n)) for n in range(7))
"""Taylor coefficients of 2^f, |f| <= 0.5: the first one left out is 1.2e-7 at the ends, float32's own rounding."""


@kernel_part(inline=True, fastmath=True)
def exp_nonpositive(x):
    """exp(x) for float32 x <= 0; relative error below 1e-6 for x > -8. Branchless, so that 16 of them are vectors."""
    power = max(x, MIN_EXPONENT) * LOG2_E
    whole = np.int32(power - f32(0.5))
    f = power - f32(whole)
    p = EXP2[6]
    p = p * f + EXP2[5]
    p = p * f + EXP2[4]
    p = p * f + EXP2[3]
    p = p * f + EXP2[2]
    p = p * f + EXP2[1]
    p = p * f + EXP2[0]
    return p * np.int32((whole + np.int32(127)) << np.int32(23)).view(np.float32)


@kernel_part(inline=True)
def row_range(footprint, top, rows):
    """Rows of the tile, first and one past the last, that a footprint reaches.

    Their pixel centres lie within its height.
    """
    center, extent = footprint[CENTER_Y] - top - 0.5, footprint[EXTENT_Y]
    return math.ceil(max(center - extent, 0.0)), math.floor(min(center + extent, rows - 1.0)) + 1


@kernel_part(inline=True)
def reach(footprint, y, left):
    """Of pixel row y: the column nearest to the footprint's centre, e there, h, if reached.

    Counting e from the nearest pixel keeps its relative precision in float32, however steep the footprint.
    """
    dy = y + 0.5 - footprint[CENTER_Y]
    h = dy * footprint[INV_STD_Y]
    center = footprint[CENTER_X] + footprint[SHEAR] * dy - left
    column = math.floor(min(max(center, 0.0), TILE - 1.0))
    e = (column + 0.5 - center) * footprint[STEP]
    return np.float32(column), np.float32(e), np.float32(h), h * h + e * e <= footprint[MAX_Q]


@kernel_part(inline=True, fastmath=True)
def _blend_row(opacity, step, column, nearest_e, h, i, light, ends, weight, row):
    """Blending weights of one Gaussian in one row; updates light and ends. Returns their sum and the live pixels."""
    seen = f32(0)
    live = np.int32(0)
    for k in range(TILE):
        e = nearest_e + (f32(k) - column) * step
        alpha = min(f32(MAX_ALPHA), opacity * exp_nonpositive(f32(-0.5) * (h * h + e * e)))
        alpha = alpha if alpha >= f32(MIN_ALPHA) else f32(0)
        behind = light[row, k] * (f32(1) - alpha)
        end = ends[row, k]
        end = min(end, i) if behind <= f32(MIN_TRANSMITTANCE) else end
        on = i < end
        weight[k] = light[row, k] * alpha if on else f32(0)
        light[row, k] = behind if on else light[row, k]
        ends[row, k] = end
        live += np.int32(1) if on else np.int32(0)
        seen += weight[k]
    return seen, live


@kernel_part(inline=True, fastmath=True)
def _note_middle(z, light, weight, middle, row):
    """Where more than half of the light came as far as this Gaussian, its depth is the middle one so far."""
    for k in range(TILE):
        arriving = light[row, k] + weight[k]
        middle[row, k] = z if weight[k] > f32(0) and arriving > f32(MEDIAN_TRANSMITTANCE) else middle[row, k]


@kernel(parallel=True, fastmath=True)
def blend(footprints, channels, tile_start, entries, tiles_across, median, features, depth, transmittance, ends_image):
    """Blend `channels` [g, d + 1] into `features` [h, w, d] and `depth` [h, w].

    See `Splatted` for what `median` does.

    Also writes, [h, w] each, the transmittance left and the end of each pixel: the position, in the tile's list, of the
    first Gaussian that was not blended any more.
    """
    height, width = depth.shape
    count = channels.shape[1]
    for tile in prange(tile_start.shape[0] - 1):
        top, left = (tile // tiles_across) * TILE, (tile % tiles_across) * TILE
        rows, columns = min(TILE, height - top), min(TILE, width - left)
        start = tile_start[tile]
        length = tile_start[tile + 1] - start
        light = np.ones((TILE, TILE), np.float32)
        ends = np.full((TILE, TILE), length, np.int32)
        row_live = np.ones(TILE, np.bool_)
        row_live[rows:] = False
        blended = np.zeros((TILE, count, TILE), np.float32)
        weight = np.empty(TILE, np.float32)
        middle = np.zeros((TILE, TILE), np.float32)
        for i in range(length):
            g = entries[start + i]
            footprint = footprints[g]
            opacity, step = f32(footprint[OPACITY]), f32(footprint[STEP])
            first, last = row_range(footprint, top, rows)
            for row in range(first, last):
                column, e, h, reached = reach(footprint, top + row, left)
                if not (reached and row_live[row]):
                    continue
                seen, live = _blend_row(opacity, step, column, e, h, np.int32(i), light, ends, weight, row)
                row_live[row] = live > 0
                if seen > f32(0):
                    for c in range(count):
                        add_scaled(blended, (row * count + c) * TILE, weight, 0, channels[g, c])
                    if median:
                        _note_middle(channels[g, count - 1], light, weight, middle, row)
            if i % GAUSSIANS_PER_LIVE_CHECK == 0 and not row_live.any():
                break
        for row in range(rows):
            for k in range(columns):
                y, x = top + row, left + k
                transmittance[y, x], ends_image[y, x] = light[row, k], ends[row, k]
                depth[y, x] = (f32(1) - light[row, k]) * middle[row, k] if median else blended[row, count - 1, k]
                for c in range(count - 1):
                    features[y, x, c] = blended[row, c, k]
