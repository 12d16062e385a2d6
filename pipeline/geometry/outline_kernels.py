"""Outlines of masks, and the distance to them within a pixel.

See `pipeline.geometry.signed_distance`.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.kernel_cache import unlocked_kernel


@unlocked_kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def mark_edge(mask, off_edge):
    """Set pixels that the outline passes to 0 and others to 1; returns how many it passes.

    It passes those that are partly covered, and full ones beside empty ones.
    """
    height, width, count = mask.shape[0], mask.shape[1], 0
    for row in range(height):
        above, here, below = mask[max(row - 1, 0)], mask[row], mask[min(row + 1, height - 1)]
        for column in range(width):
            least = min(above[column], below[column], here[max(column - 1, 0)], here[min(column + 1, width - 1)])
            edge = (here[column] > 0) & ((here[column] < 255) | (least == 0))
            off_edge[row, column] = not edge
            count += edge
    return count


@unlocked_kernel
@no_type_check
def give_sign(mask, off_edge, nearest, half_covered, farthest_px, distance):
    """Make distances from the edge positive inside, exact by coverage, and clip them.

    Args:
        nearest: number of each pixel's nearest one of the edge, from 1.
    """
    offset = np.zeros(distance.size + 1, np.float32)
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            if off_edge[row, column] == 0:
                offset[nearest[row, column]] = np.float32(mask[row, column]) / np.float32(255) - np.float32(0.5)
    most = np.float32(farthest_px)
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            away = distance[row, column] if mask[row, column] >= half_covered else -distance[row, column]
            distance[row, column] = min(max(away + offset[nearest[row, column]], -most), most)
