"""Rays through pixels, and the stretches of them that lie in boxes."""

from __future__ import annotations

import math

from pipeline.base.kernel_cache import kernel_part
from pipeline.rendering.volume_conventions import MOST_STEPS

ENTERS, LEAVES, START, SLOPE = 0, 1, 2, 5
"""Columns of a stretch: the distances at which a ray enters and leaves a box, metres; the place y in the box at
distance 0, and its change per metre, three each."""

STRETCH_COLUMNS = 8


@kernel_part(fastmath=True)
def direction_of(R, K, row, column, direction):
    """Fill in the unit direction of the ray through a pixel's centre, in the world.

    Returns the depth of a metre along it.
    """
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    length = math.sqrt(x * x + y * y + 1.0)
    for k in range(3):
        direction[k] = (x * R[0, k] + y * R[1, k] + R[2, k]) / length
    return 1.0 / length


@kernel_part(fastmath=True)
def stretch_of(inverse, origin, direction, stretch):
    """Fill in the stretch of a ray in a box; False if there is none in front of the camera.

    `origin` is the camera's place in the box.
    """
    enters, leaves = 0.0, math.inf
    for axis in range(3):
        start, slope = origin[axis], 0.0
        for k in range(3):
            slope += inverse[axis, k] * direction[k]
        stretch[START + axis], stretch[SLOPE + axis] = start, slope
        if slope == 0.0:
            if abs(start) > 1.0:
                return False
            continue
        one, other = (-1.0 - start) / slope, (1.0 - start) / slope
        enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
    stretch[ENTERS], stretch[LEAVES] = enters, leaves
    return enters <= leaves


@kernel_part(fastmath=True)
def find_stretches(inverses, origins, spheres, direction, step, entries, stretches, boxes):
    """Find the stretches of a ray in the boxes of `entries`; returns their number.

    In the order in which it enters the boxes.

    Args:
        origins: [b, 3] the camera's place in each box.
        spheres: [b, 4] around each box: from the camera to its centre, and their distance squared less the radius
            squared, metres.
    """
    count = 0
    for entry in range(entries.shape[0]):
        box = entries[entry]
        along = 0.0
        for k in range(3):
            along += direction[k] * spheres[box, k]
        outside = spheres[box, 3]
        if outside > 0.0 and (along < 0.0 or along * along < outside):
            continue  # past the sphere around the box
        if not stretch_of(inverses[box], origins[box], direction, stretches[count]):
            continue
        if stretches[count, ENTERS] > MOST_STEPS * step:
            continue
        stretches[count, LEAVES] = min(stretches[count, LEAVES], MOST_STEPS * step)
        boxes[count] = box
        at = count
        while at > 0 and stretches[at - 1, ENTERS] > stretches[at, ENTERS]:
            for c in range(STRETCH_COLUMNS):
                stretches[at - 1, c], stretches[at, c] = stretches[at, c], stretches[at - 1, c]
            boxes[at - 1], boxes[at] = boxes[at], boxes[at - 1]
            at -= 1
        count += 1
    return count


@kernel_part(fastmath=True)
def next_step(k, step, first, stretches, count):
    """The next step from k on that may be in some box, -1 if there is none.

    Then the first box that is not behind it.
    """
    t = (k + 0.5) * step
    while first < count and stretches[first, LEAVES] < t:
        first += 1
    if first == count:
        return -1, first
    inside = False
    for hit in range(first, count):
        if stretches[hit, ENTERS] > t:
            break
        if stretches[hit, LEAVES] >= t:
            inside = True
            break
    if inside:
        return k, first
    for hit in range(first, count):
        if stretches[hit, ENTERS] > t:
            return max(k + 1, math.ceil(stretches[hit, ENTERS] / step - 0.5)), first
    return -1, first
