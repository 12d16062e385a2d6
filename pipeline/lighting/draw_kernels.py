"""Kernels that draw a light per point, and tell how far the draws of neighbours are apart."""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.kernel_cache import kernel_part
from pipeline.lighting.ray_kernels import ray_kernel

PLASTIC = 1.324717957244746
"""Real root of x^3 = x + 1: its powers give the two-dimensional sequence of lowest known discrepancy (Roberts 2018)."""

DOWN, ACROSS = 1 / PLASTIC, 1 / PLASTIC**2
"""What a row and a column of the map add to a lattice number."""

BELOW_ONE = 1 - 2.0**-51
"""Four roundings below 1: a number that rounding moves into a cell is not below the cell's start times this."""


@kernel_part(inline=True)
@no_type_check
def lattice_number(row, column, shift):
    """Fractional part of DOWN * row + ACROSS * column + shift."""
    number = row * DOWN + column * ACROSS + shift
    return number - np.floor(number)


@ray_kernel
@no_type_check
def lattice_numbers(texel, shift, uniform):
    """Write the lattice number of each texel."""
    for i in range(texel.shape[0]):
        uniform[i] = lattice_number(texel[i, 0], texel[i, 1], shift)


@ray_kernel
@no_type_check
def cumulative_chances(chances):
    """Cumulative distribution of lights, up to 1 but for a rounding, and a table into it.

    The table tells where to start looking (Chen and Asau 1974): never too far, whichever way the numbers are rounded.
    """
    cumulative = np.cumsum(chances)
    cumulative /= cumulative[-1]
    last, cells = len(chances) - 1, 4 * len(chances)
    start, light = np.empty(cells + 1, np.int32), 0
    for c in range(cells + 1):
        while light < last and cumulative[light] <= c / cells * BELOW_ONE:
            light += 1
        start[c] = light
    return cumulative, start


@kernel_part(inline=True)
@no_type_check
def light_at(cumulative, start, uniform):
    """The light that a number in [0, 1) draws: a step or two from where the table says.

    The last light has what rounding leaves below 1.
    """
    last = len(cumulative) - 1
    j = start[np.uint32(uniform * (len(start) - 1))]
    while j < last and cumulative[np.uint32(j)] <= uniform:
        j += 1
    return np.uint32(j)


@ray_kernel
@no_type_check
def draw_by_chance(chances, uniform, chosen):
    """Draw one light per point by inversion of the cumulative distribution.

    Args:
        chances: probability of each light.
    """
    cumulative, start = cumulative_chances(chances)
    for i in range(uniform.shape[0]):
        chosen[i] = light_at(cumulative, start, uniform[i])


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
def spread_over_blocks(per_block, block, values):
    """Give every value that of its block."""
    for i in range(values.shape[0]):
        values[i] = per_block[block[i]]
