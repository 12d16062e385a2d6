"""Drawing triangles: which samples they cover, and how deep they lie.

Every sample between a triangle's corners is tested against its edges, which count as inside, in float64: two triangles
leave no sample between them uncovered but by rounding. Most triangles of a template are a few samples wide, and a
branch per sample is then mispredicted half of the time; the loops below have none, and whole blocks of a row, so that
the compiler makes vector instructions of them.

Pixels have their centres at halves. A window is a part of the image: its first row and column, and those behind its
last.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.kernel_cache import unlocked_kernel

DEPTH_BLOCK = 4
"""Pixels of a row tested together when depth is drawn, a third as many as samples: one vector."""

SUPERSAMPLING = 3
"""Samples per pixel and axis when coverage is drawn: it is then good to a tenth of a pixel."""

BLOCK = 8
"""Samples of a row that are tested together: two vectors of four float64. Samples behind the last corner are outside
by the same test; a row of samples has room for them at its end."""


@unlocked_kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _corners(pixels, depth, face, scale):
    """x and y of a triangle's corners, and twice its signed area; 0 for one that is not drawn."""
    a, b, c = face[0], face[1], face[2]
    x = (pixels[a, 0] * scale, pixels[b, 0] * scale, pixels[c, 0] * scale)
    y = (pixels[a, 1] * scale, pixels[b, 1] * scale, pixels[c, 1] * scale)
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    drawn = depth[a] > 0 and depth[b] > 0 and depth[c] > 0 and np.isfinite(area)
    return x, y, area if drawn else 0.0


@unlocked_kernel
@no_type_check
def _samples(corners, start, end):
    """First and last number of the samples between a triangle's corners, from `start` and before `end`."""
    first, last = min(corners[0], corners[1], corners[2]), max(corners[0], corners[1], corners[2])
    lowest = min(max(np.ceil(first - PIXEL_CENTER), float(start)), float(end))
    return int(lowest), int(max(min(np.floor(last - PIXEL_CENTER), end - 1.0), start - 1.0))


@unlocked_kernel
@no_type_check
def drawn_window(pixels, depth, faces, height, width, margin):
    """Window of the pixels that the triangles cover, and of those up to `margin` beside them."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for n in range(faces.shape[0]):
        x, y, area = _corners(pixels, depth, faces[n], 1.0)
        if area != 0.0:
            left, right = min(left, x[0], x[1], x[2]), max(right, x[0], x[1], x[2])
            top, bottom = min(top, y[0], y[1], y[2]), max(bottom, y[0], y[1], y[2])
    first_row = int(min(max(np.floor(top) - margin, 0), height))
    first_column = int(min(max(np.floor(left) - margin, 0), width))
    end_row = int(max(min(np.ceil(bottom) + margin, height), first_row))
    end_column = int(max(min(np.ceil(right) + margin, width), first_column))
    return first_row, first_column, end_row, end_column


@unlocked_kernel
@no_type_check
def _fill(filled, pixels, depth, faces, above, before):
    """Set samples to 1 that a triangle covers.

    Args:
        filled: samples of a window, with `BLOCK` columns to spare; its first is row `above`, column `before`.
    """
    end_row, end_column = above + filled.shape[0], before + filled.shape[1] - BLOCK
    for n in range(faces.shape[0]):
        x, y, area = _corners(pixels, depth, faces[n], float(SUPERSAMPLING))
        if area == 0.0:
            continue
        sign = 1.0 if area > 0 else -1.0
        first, last = _samples(x, before, end_column)
        top, bottom = _samples(y, above, end_row)
        x0, x1, x2 = x
        right0, right1, right2 = sign * (x1 - x0), sign * (x2 - x1), sign * (x0 - x2)
        down0, down1, down2 = sign * (y[1] - y[0]), sign * (y[2] - y[1]), sign * (y[0] - y[2])
        count = (last - first + BLOCK) // BLOCK * BLOCK
        for row in range(top, bottom + 1):
            py = row + PIXEL_CENTER
            edge0, edge1, edge2 = right0 * (py - y[0]), right1 * (py - y[1]), right2 * (py - y[2])
            line = filled[row - above, first - before : first - before + count]
            for i in range(count):
                px = first + i + PIXEL_CENTER
                line[i] |= (
                    (edge0 - down0 * (px - x0) >= 0)
                    & (edge1 - down1 * (px - x1) >= 0)
                    & (edge2 - down2 * (px - x2) >= 0)
                )


@unlocked_kernel
@no_type_check
def fill_coverage(pixels, depth, faces, window):
    """Share of each pixel of a window that is covered, 0..255."""
    first_row, first_column, end_row, end_column = window
    height, width = end_row - first_row, end_column - first_column
    filled = np.zeros((height * SUPERSAMPLING, width * SUPERSAMPLING + BLOCK), np.uint8)
    _fill(filled, pixels, depth, faces, first_row * SUPERSAMPLING, first_column * SUPERSAMPLING)
    coverage, in_column = np.empty((height, width), np.uint8), np.empty(filled.shape[1], np.uint8)
    most = SUPERSAMPLING**2
    rounded = np.array([int(255.0 * count / most + 0.5) for count in range(most + 1)], np.uint8)
    for row in range(height):
        in_column[:] = 0
        for i in range(SUPERSAMPLING):
            line = filled[row * SUPERSAMPLING + i]
            for column in range(in_column.shape[0]):
                in_column[column] += line[column]
        for column in range(width):
            count = 0
            for j in range(SUPERSAMPLING):
                count += in_column[column * SUPERSAMPLING + j]
            coverage[row, column] = rounded[count]
    return coverage


@unlocked_kernel
@no_type_check
def fill_depth(pixels, depth, faces, height, width):
    """Least depth over the triangles that contain each pixel's centre.

    1/depth is linear in the image.
    """
    # Of the nearest surface; 0 where there is none.
    inverse = np.zeros((height, width + DEPTH_BLOCK))
    for n in range(faces.shape[0]):
        x, y, area = _corners(pixels, depth, faces[n], 1.0)
        if area == 0.0:
            continue
        first, last = _samples(x, 0, width)
        top, bottom = _samples(y, 0, height)
        x0, x1, x2 = x
        scale = 1.0 / area
        right0, right1, right2 = scale * (x2 - x1), scale * (x0 - x2), scale * (x1 - x0)
        down0, down1, down2 = scale * (y[2] - y[1]), scale * (y[0] - y[2]), scale * (y[1] - y[0])
        near0, near1, near2 = 1.0 / depth[faces[n, 0]], 1.0 / depth[faces[n, 1]], 1.0 / depth[faces[n, 2]]
        count = (last - first + DEPTH_BLOCK) // DEPTH_BLOCK * DEPTH_BLOCK
        for row in range(top, bottom + 1):
            py = row + PIXEL_CENTER
            edge0, edge1, edge2 = right0 * (py - y[1]), right1 * (py - y[2]), right2 * (py - y[0])
            line = inverse[row, first : first + count]
            for i in range(count):
                px = first + i + PIXEL_CENTER
                # Shares of the corners: the opposite edge's function over the whole area.
                share0, share1 = edge0 - down0 * (px - x1), edge1 - down1 * (px - x2)
                share2 = edge2 - down2 * (px - x0)
                here = share0 * near0 + share1 * near1 + share2 * near2
                within = (share0 >= 0) & (share1 >= 0) & (share2 >= 0) & (here > line[i])
                line[i] = here if within else line[i]
    nearest = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            nearest[row, column] = 1.0 / inverse[row, column]
    return nearest
