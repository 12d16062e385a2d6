"""Definition of a picture of volumetric primitives, for the kernels and what checks them.

A mixture of volumetric primitives (Lombardi et al. 2021) is a set of boxes. A point x has the coordinates
y = diag(1 / s) R^T (x - c) in the box of centre c, rotation R and half sizes s; it is inside if no |y_i| exceeds 1.
There

    alpha(x) = density(y) exp(-FADE_SCALE (|y_0|^FADE_POWER + |y_1|^FADE_POWER + |y_2|^FADE_POWER))

with `density` between voxels, whose outermost centres lie on the faces, interpolated linearly. So boxes fade out
towards their faces, neighbours blend into each other, and pictures move with the boxes: gradients reach their poses.

A ray from the camera is sampled at distances t_k = (k + 1/2) step, k = 0 .. MOST_STEPS - 1. With a_k the sum of the
alphas of all boxes at t_k, and c_k the mean of their features weighted by alpha, it accumulates from front to back

    A_k = min(A_{k-1} + step a_k, 1),  features = sum_k (A_k - A_{k-1}) c_k

so that opacity is added, not multiplied, and the step that would go beyond 1 is cut there; nothing lies behind it.
"""

from __future__ import annotations

FADE_SCALE = 8.0
FADE_POWER = 8
"""alpha falls to half at 0.74 of a box's half size, and to 3e-4 of its value at the faces, where it ends."""

SMALLEST_HALF_SIZE_M = 1e-9
"""Boxes that are thinner along any axis are not drawn, and have no gradient; others have finite 1 / s."""

MOST_STEPS = 1 << 16
"""Steps after which a ray ends: 65 m at a millimetre each, beyond any subject."""
