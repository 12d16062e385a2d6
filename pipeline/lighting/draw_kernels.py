"""Kernels that draw a light per point, and tell how far the draws of neighbours are apart."""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.kernel_cache import kernel_part
from pipeline.lighting.ray_kernels import ray_kernel

PLASTIC = 1.324717957244746
"""Real root of x^3 = x + 1: its powers give the two-dimensional sequence of lowest known discrepancy (Roberts 2018)."""

STEPS = 2**32
"""Numbers that decide a draw are whole: k stands for k / STEPS. A light's chance is met to one in four billion."""

LAST = np.uint64(STEPS - 1)

DOWN, ACROSS = np.uint32(round(STEPS / PLASTIC)), np.uint32(round(STEPS / PLASTIC**2))
"""What a row and a column of the map add to a lattice number."""


@kernel_part(inline=True)
@no_type_check
def lattice_number(row, column, shift):
    """DOWN * row + ACROSS * column + shift; whole rounds drop out by themselves."""
    return np.uint32(np.uint32(row) * DOWN + np.uint32(column) * ACROSS + shift)


@kernel_part(inline=True)
@no_type_check
def whole_number(uniform):
    """A number in [0, 1), counted in steps; one that rounding made 1 is the last."""
    return np.uint32(min(np.uint64(uniform * STEPS), LAST))


@ray_kernel
@no_type_check
def lattice_numbers(texel, shift, uniform):
    """Write the lattice number of each texel, as one in [0, 1)."""
    for i in range(texel.shape[0]):
        uniform[i] = lattice_number(texel[i, 0], texel[i, 1], shift) / STEPS


@ray_kernel
@no_type_check
def drawing_table(chances):
    """Least number that lies beyond each light, and a table of where to start looking.

    The table has the light of the least number in each cell, an equal part of all (Chen and Asau 1974). No number lies
    beyond the last light, whatever the chances are: searches end there.
    """
    cumulative, beyond = np.cumsum(chances), np.empty(len(chances), np.uint64)
    for j in range(len(chances)):
        beyond[j] = np.uint64(np.rint(cumulative[j] / cumulative[-1] * STEPS))
    beyond[-1] = STEPS
    cells = 4 * len(chances)
    start, light = np.empty(cells, np.uint32), 0
    for c in range(cells):
        least = (c * STEPS + cells - 1) // cells
        while beyond[light] <= np.uint64(least):
            light += 1
        start[c] = light
    return beyond, start


@kernel_part(inline=True)
@no_type_check
def light_at(beyond, start, number):
    """The light that a number draws.

    Most often it is where the table says, or one on: that is told without a branch.
    """
    number = np.uint64(number)
    j = np.uint64(start[(number * np.uint64(len(start))) >> np.uint64(32)])
    j += np.uint64(beyond[j] <= number)
    while beyond[j] <= number:
        j += np.uint64(1)
    return j


@ray_kernel
@no_type_check
def draw_by_chance(chances, uniform, chosen):
    """Draw one light per point by inversion of the cumulative distribution.

    Args:
        chances: probability of each light.
    """
    beyond, start = drawing_table(chances)
    for i in range(uniform.shape[0]):
        chosen[i] = light_at(beyond, start, whole_number(uniform[i]))


@ray_kernel
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


@ray_kernel
@no_type_check
def add_block_variances(values, block, count, variance):
    """Add to every block the unbiased variance of its values; 0 to one that has a single one.

    Args:
        block: number of each value's block, unsigned (numba checks signed indices for being negative).
        count: values in each block.
    """
    mean, squares = np.zeros(count.shape[0]), np.zeros(count.shape[0])
    for i in range(values.shape[0]):
        mean[block[i]] += values[i]
    for b in range(count.shape[0]):
        mean[b] /= max(count[b], 1.0)
    for i in range(values.shape[0]):
        squares[block[i]] += (values[i] - mean[block[i]]) ** 2
    for b in range(count.shape[0]):
        variance[b] += squares[b] / max(count[b] - 1.0, 1.0)


@ray_kernel
@no_type_check
def add_variances_of_sums(sums, squares, count, variance):
    """Add to every block the unbiased variance of values, from their sum and sum of squares."""
    for b in range(count.shape[0]):
        left = squares[b] - sums[b] * sums[b] / max(count[b], 1.0)
        variance[b] += max(left, 0.0) / max(count[b] - 1.0, 1.0)


@ray_kernel
@no_type_check
def spread_over_blocks(per_block, block, values):
    """Give every value that of its block."""
    for i in range(values.shape[0]):
        values[i] = per_block[block[i]]
