"""Factors that precondition: inverses to float32's digits in any units, to float64's where float32 fails."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.tracking.block_factor import BlockFactor

COUNT = 40


def block(condition: float, seed: int = 0) -> np.ndarray:
    """Symmetric, with eigenvalues from 1 down to 1 / condition."""
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(COUNT, COUNT)))
    return (axes * np.geomspace(1, 1 / condition, COUNT)) @ axes.T


@pytest.mark.parametrize("condition", [1e1, 1e4])
def test_units_of_the_unknowns_do_not_matter(condition):
    """Radians beside metres beside micrometres: the scaled block is what is rounded."""
    units = np.geomspace(1e-6, 1e6, COUNT)
    matrix = block(condition) * units * units[:, None]
    wanted = np.linspace(-1, 1, COUNT) / units
    found = BlockFactor.of(matrix).solve(matrix @ wanted)
    assert np.abs((found - wanted) * units).max() < 100 * condition * 2**-24


def test_where_float32_is_singular_float64_is_not():
    matrix, wanted = block(1e11), np.linspace(-1, 1, COUNT)
    factor = BlockFactor.of(matrix)
    assert factor.lower.dtype == np.float64
    assert np.abs(factor.solve(matrix @ wanted) - wanted).max() < 1e-3
