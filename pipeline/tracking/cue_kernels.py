"""Residuals of cues and what they add to a quadratic of the points.

Each kernel is one pass over the points. As arrays, each of some thirty operations per point would go through memory.
`derivative` is of a point's pixel by its position [points, 2, 3]. Points are given by frame and number; none occurs
twice in one call. Results are added in the order of the points.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.kernel_cache import unlocked_kernel


@unlocked_kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _cell(x, y, height, width, edge_px):
    """Row and column of the upper left of a pixel's four neighbours, and its way to the others."""
    # A coordinate that is not a number fails both comparisons in the first line, and is taken for 0.
    x, y = x - PIXEL_CENTER if x > PIXEL_CENTER else 0.0, y - PIXEL_CENTER if y > PIXEL_CENTER else 0.0
    x, y = min(x, width - 1 - edge_px), min(y, height - 1 - edge_px)
    row, column = int(y), int(x)
    return row, column, x - column, y - row


@unlocked_kernel
@no_type_check
def near_outline(distance, corner, pixels, depth, chosen, height, width, most_px, edge_px, number, target):
    """Find points whose distance from a drawn outline is less than `most_px`; returns how many.

    Args:
        distance: signed, of a part of an image [rows, columns] that starts at `corner`; beyond it, as at its rim.
        pixels, depth: of all points; chosen: which ones are looked at, as far as they are in the image.
        number, target: set to the places in `chosen` of those found, and to their distances.
    """
    count = 0
    for n in range(chosen.shape[0]):
        x, y = pixels[chosen[n], 0], pixels[chosen[n], 1]
        if not (depth[chosen[n]] > 0 and 0 < x < width and 0 < y < height):
            continue
        row, column, u, v = _cell(x - corner[1], y - corner[0], distance.shape[0], distance.shape[1], edge_px)
        a, b = np.float64(distance[row, column]), np.float64(distance[row, column + 1])
        c, d = np.float64(distance[row + 1, column]), np.float64(distance[row + 1, column + 1])
        value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        if abs(value) < most_px:
            number[count], target[count] = n, value
            count += 1
    return count


@unlocked_kernel
@no_type_check
def pinhole_derivatives(points, rotation, translation, focal, least_depth, derivative):
    """Set the derivatives of an undistorted camera's pixels by positions [points, 3]."""
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        depth = max(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2], least_depth)
        for i in range(2):
            r = rotation[i]
            slope = (r[0] * x + r[1] * y + r[2] * z + translation[i]) / depth
            for a in range(3):
                derivative[n, i, a] = focal[i] / depth * (r[a] - slope * rotation[2, a])


@unlocked_kernel
@no_type_check
def add_distances(
    distance, frame, point, pixels, derivative, target, sigma_px, cauchy_scale, edge_px, gradient, normal
):  # fmt: skip
    """Add robust squared differences of signed distances from `target`; returns the cost.

    `distance` is [frames, height, width].
    """
    height, width = distance.shape[1], distance.shape[2]
    cost, slope = 0.0, np.empty(3)
    for n in range(frame.shape[0]):
        f, p = frame[n], point[n]
        row, column, u, v = _cell(pixels[n, 0], pixels[n, 1], height, width, edge_px)
        a, b = np.float64(distance[f, row, column]), np.float64(distance[f, row, column + 1])
        c, d = np.float64(distance[f, row + 1, column]), np.float64(distance[f, row + 1, column + 1])
        residual = ((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d) - target[n]) / sigma_px
        across, down = (1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)
        ratio = residual * residual / cauchy_scale**2
        weight = 1 / (1 + ratio)
        cost += 0.5 * cauchy_scale**2 * np.log1p(ratio)
        for i in range(3):
            slope[i] = (across * derivative[n, 0, i] + down * derivative[n, 1, i]) / sigma_px
        for i in range(3):
            gradient[f, p, i] += weight * residual * slope[i]
            for j in range(3):
                normal[f, p, i, j] += weight * slope[i] * slope[j]
    return cost


@unlocked_kernel
@no_type_check
def look_up_colors(images, frame, pixels, edge_px, color, across, down):
    """Set colours [points, 3] between pixels, and their slopes along rows and columns.

    `images` is [frames, height, width, 3].
    """
    height, width = images.shape[1], images.shape[2]
    for n in range(frame.shape[0]):
        f = frame[n]
        row, column, u, v = _cell(pixels[n, 0], pixels[n, 1], height, width, edge_px)
        for i in range(3):
            a, b = np.float64(images[f, row, column, i]), np.float64(images[f, row, column + 1, i])
            c, d = np.float64(images[f, row + 1, column, i]), np.float64(images[f, row + 1, column + 1, i])
            color[n, i] = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
            across[n, i] = (1 - v) * (b - a) + v * (d - c)
            down[n, i] = (1 - u) * (c - a) + u * (d - b)


@unlocked_kernel
@no_type_check
def add_albedo_sums(point, lit, weight, color, sums):
    """Add weight lit^T color [all, 3]: the right-hand sides of the least-squares fit of albedo."""
    for n in range(point.shape[0]):
        for i in range(3):
            for c in range(3):
                sums[point[n], i] += weight[n] * lit[n, c, i] * color[n, c]


@unlocked_kernel
@no_type_check
def add_color_differences(
    frame, point, derivative, lit, weight, albedo, color, across, down, gradient, normal, cross
):  # fmt: skip
    """Add squared differences of colours from lit @ albedo; returns the cost. `cross`: by position and by albedo."""
    cost = 0.0
    slope = np.empty(3)
    for n in range(frame.shape[0]):
        f, p, w = frame[n], point[n], weight[n]
        for c in range(3):
            expected = lit[n, c, 0] * albedo[p, 0] + lit[n, c, 1] * albedo[p, 1] + lit[n, c, 2] * albedo[p, 2]
            residual = color[n, c] - expected
            cost += 0.5 * w * residual * residual
            for i in range(3):
                slope[i] = across[n, c] * derivative[n, 0, i] + down[n, c] * derivative[n, 1, i]
            for i in range(3):
                weighted = w * slope[i]
                gradient[f, p, i] += weighted * residual
                for j in range(3):
                    normal[f, p, i, j] += weighted * slope[j]
                    cross[f, p, i, j] += weighted * lit[n, c, j]
    return cost
