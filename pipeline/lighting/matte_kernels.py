"""Kernels of the matte reflection of point lights.

`pipeline.lighting.matte` says what they gather.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numba
import numpy as np

from pipeline.base.kernel_cache import EXACT_FUNCTIONS, kernel
from pipeline.lighting.zonal_kernels import SMALLEST_DISTANCE2_M2

SAME_SUMS = EXACT_FUNCTIONS - {"reassoc"}
"""fastmath that does not reorder sums: numba optimises what it stores once more than what it has just compiled, and
sums in another order then give other bits. A training that is stopped before its kernels are stored could not go on to
the same result."""

GRAZING_POWER = 2.5
"""Power of what a coat keeps back. Of what passes straight down, a dielectric of index 1.5 and GGX of width 0.3 lets
0.71, 0.81, 0.93 and 0.99 pass at cosines of 0.05, 0.2, 0.5 and 0.9; with s = 0.33 this has 0.71, 0.81, 0.94 and 1.00.
Schlick's fifth power, that of a smooth coat, falls too late."""

ONE = np.float32(1.0)
POWER = np.float32(GRAZING_POWER)


@kernel(parallel=True, fastmath=SAME_SUMS)
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def add_arriving_vectors(points, normals, lights, intensities, seen, out):
    """Vector irradiance of points and channels."""
    channels = intensities.shape[1]
    for p in numba.prange(points.shape[0]):
        out[p] = 0
        for j in range(lights.shape[0]):
            if not seen[j, p >> 3] & (128 >> (p & 7)):
                continue
            x, y, z = lights[j, 0] - points[p, 0], lights[j, 1] - points[p, 1], lights[j, 2] - points[p, 2]
            if x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2] <= 0:
                continue
            distance2 = max(x * x + y * y + z * z, SMALLEST_DISTANCE2_M2)
            weight = ONE / (distance2 * math.sqrt(distance2))
            for c in range(channels):
                out[p, c, 0] += intensities[j, c] * weight * x
                out[p, c, 1] += intensities[j, c] * weight * y
                out[p, c, 2] += intensities[j, c] * weight * z


@kernel(parallel=True, fastmath=SAME_SUMS)
@no_type_check
def add_grazing_irradiance(points, normals, lights, intensities, seen, value, slope):
    """Irradiance that a coat keeps back of points and channels, and its slope in the normals."""
    channels = intensities.shape[1]
    for p in numba.prange(points.shape[0]):
        value[p] = 0
        slope[p] = 0
        for j in range(lights.shape[0]):
            if not seen[j, p >> 3] & (128 >> (p & 7)):
                continue
            x, y, z = lights[j, 0] - points[p, 0], lights[j, 1] - points[p, 1], lights[j, 2] - points[p, 2]
            along = x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2]
            if along <= 0:
                continue
            inverse2 = ONE / max(x * x + y * y + z * z, SMALLEST_DISTANCE2_M2)
            inverse = math.sqrt(inverse2)
            cosine = min(along * inverse, ONE)
            rest = ONE - cosine
            power = rest * math.sqrt(rest)  # (1 - cosine)^(p - 1), p = GRAZING_POWER
            kept, turned = cosine * power * rest, power * (rest - POWER * cosine) * inverse
            for c in range(channels):
                light = intensities[j, c] * inverse2
                value[p, c] += light * kept
                slope[p, c, 0] += light * turned * x
                slope[p, c, 1] += light * turned * y
                slope[p, c, 2] += light * turned * z
