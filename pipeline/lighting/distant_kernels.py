"""Sums over harmonics of distant light, forward and backward.

The loops of `pipeline.lighting.distant`.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import prange

from pipeline.base.kernel_cache import EXACT_FUNCTIONS, kernel


@kernel(parallel=True, fastmath=EXACT_FUNCTIONS)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def distant_forward(axes, light, step, back, diagonal, out):
    """Write the incident light of each point, axis and degree, as `gather_distant` has it.

    Args:
        step, back, diagonal: factors of the recursion of harmonics in the degree.
    """
    channels, degrees = light.shape[1], out.shape[2]
    for p in prange(axes.shape[0]):
        out[p] = 0
        for a in range(3):
            x, y, z = axes[p, 0, a], axes[p, 1, a], axes[p, 2, a]
            cosine, sine = np.float32(1.0), np.float32(0.0)  # of m times the azimuth, times sin(polar angle)^m
            for m in range(degrees):
                before, here = np.float32(0.0), diagonal[m]
                for degree in range(m, degrees):
                    center = degree * degree + degree
                    for c in range(channels):
                        along = cosine * light[center + m, c]
                        if m > 0:
                            along += sine * light[center - m, c]
                        out[p, a, degree, c] += here * along
                    before, here = here, step[m, degree] * (z * here - back[m, degree] * before)
                cosine, sine = x * cosine - y * sine, x * sine + y * cosine


@kernel(parallel=True, fastmath=EXACT_FUNCTIONS)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def distant_backward(axes, light, grad_out, step, back, diagonal, grad):
    """Write the gradient with respect to the axes, given that of what `distant_forward` writes."""
    channels, degrees = light.shape[1], grad_out.shape[2]
    for p in prange(axes.shape[0]):
        for a in range(3):
            x, y, z = axes[p, 0, a], axes[p, 1, a], axes[p, 2, a]
            gx = gy = gz = np.float32(0.0)
            cosine, sine = np.float32(1.0), np.float32(0.0)
            cosine_less, sine_less = np.float32(0.0), np.float32(0.0)  # those of m - 1, times m
            for m in range(degrees):
                before, here = np.float32(0.0), diagonal[m]
                slope_before, slope_here = np.float32(0.0), np.float32(0.0)  # with respect to z
                to_cosine = to_sine = np.float32(0.0)
                for degree in range(m, degrees):
                    center = degree * degree + degree
                    by_cosine = by_sine = np.float32(0.0)
                    for c in range(channels):
                        by_cosine += grad_out[p, a, degree, c] * light[center + m, c]
                        if m > 0:
                            by_sine += grad_out[p, a, degree, c] * light[center - m, c]
                    to_cosine += here * by_cosine
                    to_sine += here * by_sine
                    gz += slope_here * (cosine * by_cosine + sine * by_sine)
                    forth, rear = step[m, degree], back[m, degree]
                    after, slope_after = forth * (z * here - rear * before), here + z * slope_here
                    slope_after = forth * (slope_after - rear * slope_before)
                    before, here = here, after
                    slope_before, slope_here = slope_here, slope_after
                gx += cosine_less * to_cosine + sine_less * to_sine
                gy += cosine_less * to_sine - sine_less * to_cosine
                cosine_less, sine_less = np.float32(m + 1) * cosine, np.float32(m + 1) * sine
                cosine, sine = x * cosine - y * sine, x * sine + y * cosine
            grad[p, 0, a], grad[p, 1, a], grad[p, 2, a] = gx, gy, gz
