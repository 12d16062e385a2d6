"""Operations on sixteen float32 at once against NumPy in float64."""

import numpy as np
from numba import njit

from pipeline.base.float_lanes import LANES, inverse_root, load, store


@njit
def inverse_roots(values, roots):
    for at in range(0, values.size, LANES):
        store(roots, at, inverse_root(load(values, at)))


def test_inverse_root_is_good_to_2_to_the_minus_21():
    values = np.logspace(-30, 30, 1024 * LANES).astype(np.float32)
    roots = np.empty_like(values)
    inverse_roots(values, roots)
    np.testing.assert_allclose(roots, values.astype(np.float64) ** -0.5, rtol=2.0**-21)
