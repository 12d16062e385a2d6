"""Kernels of a separable filter that keeps one of every `factor` samples.

Used by `pipeline.rendering.supersample`.

Images lie as [row, column, channel]. A row of output is a sum of rows of input, then a sum of its columns: both run
over memory in order. One thread owns a row, so the result does not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import kernel, kernel_part


@kernel_part()
def add_row(total, row, weight):
    """total += weight row, of flat float32 arrays."""
    for i in range(total.shape[0]):
        total[i] += weight * row[i]


@kernel(parallel=True)
def filter_forward(images, weights, factor, out):
    """Filter: out[y, x, c] = sum_ij w_i w_j images[factor y + i, factor x + j, c].

    `images` are [rows, width * channels].
    """
    taps, channels = weights.shape[0], out.shape[2]
    for y in prange(out.shape[0]):
        row = np.zeros(images.shape[1], np.float32)
        for i in range(taps):
            add_row(row, images[factor * y + i], weights[i])
        for x in range(out.shape[1]):
            for c in range(channels):
                out[y, x, c] = np.float32(0.0)
            for j in range(taps):
                at = (factor * x + j) * channels
                for c in range(channels):
                    out[y, x, c] += weights[j] * row[at + c]


@kernel(parallel=True)
def filter_backward(grad_out, weights, factor, grad_rows, grad_images):
    """Gradient of `filter_forward`; `grad_rows` [out rows, width * c] is scratch."""
    taps, height, channels = weights.shape[0], grad_out.shape[0], grad_out.shape[2]
    for y in prange(height):
        for k in range(grad_rows.shape[1]):
            grad_rows[y, k] = np.float32(0.0)
        for x in range(grad_out.shape[1]):
            for j in range(taps):
                at = (factor * x + j) * channels
                for c in range(channels):
                    grad_rows[y, at + c] += weights[j] * grad_out[y, x, c]
    for large in prange(grad_images.shape[0]):
        for k in range(grad_images.shape[1]):
            grad_images[large, k] = np.float32(0.0)
        for i in range(large % factor, taps, factor):
            y = (large - i) // factor
            if 0 <= y < height:
                add_row(grad_images[large], grad_rows[y], weights[i])
