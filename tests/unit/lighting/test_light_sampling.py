"""Spread draws: uniform for each texel, and evenly filled over neighbours."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from pipeline.lighting.draw_kernels import STEPS, draw_by_chance, drawing_table
from pipeline.lighting.light_sampling import BLOCK, pattern_numbers

TEXEL = np.stack(np.divmod(np.arange(24 * 32), 32), 1)


@pytest.mark.parametrize("spread", ["random", "stratified", "low_discrepancy"])
def test_each_texel_is_uniform(spread: str) -> None:
    """Over 2,000 draws a texel's numbers pass Kolmogorov and Smirnov's test; the least p of 8 texels exceeds 1e-4 in
    all but 1 of 1,000 such tests (the seed is fixed: this one is among them or not, for good)."""
    rng = np.random.default_rng(3)
    draws = np.stack([pattern_numbers(spread, TEXEL, rng) for _ in range(2000)])
    assert draws.min() >= 0
    assert draws.max() < 1
    least = min(scipy.stats.kstest(draws[:, t], "uniform").pvalue for t in range(0, len(TEXEL), 100))
    assert least > 1e-4


def test_blocks_hold_one_draw_per_stratum() -> None:
    draws = pattern_numbers("stratified", TEXEL, np.random.default_rng(0))
    block = TEXEL // BLOCK @ [8, 1]
    for b in np.unique(block):
        np.testing.assert_array_equal(np.sort((draws[block == b] * BLOCK**2).astype(int)), np.arange(BLOCK**2))


@pytest.mark.parametrize("spread", ["stratified", "low_discrepancy"])
def test_neighbours_fill_the_unit_interval_better_than_chance(spread: str) -> None:
    """The mean of a 4 x 4 block of independent draws is off by 1 / sqrt(12 x 16) = 0.072; spread ones by far less."""
    rng = np.random.default_rng(1)
    means = pattern_numbers(spread, TEXEL, rng).reshape(6, 4, 8, 4).mean((1, 3))
    assert np.sqrt(np.mean((means - 0.5) ** 2)) < 0.072 / 2


@pytest.mark.parametrize("spread", ["random", "stratified", "low_discrepancy"])
def test_no_texel_at_all(spread: str) -> None:
    assert len(pattern_numbers(spread, np.zeros((0, 2), np.int64), np.random.default_rng(0))) == 0


@pytest.mark.parametrize(
    "chances",
    [
        np.ones(24), np.ones(7), np.ones(49), 0.5 ** np.arange(40), np.array([0.0, 1, 0, 0, 3, 0]),
        np.array([np.nextafter(0.25, 1), 0.25, 0.25, 0.25]),
    ],
)  # fmt: skip
def test_draws_on_the_bounds_between_lights(chances: np.ndarray) -> None:
    """A light's numbers lie between the bounds of its own and of the one before, wherever its table starts.

    Numbers count in steps of 2^-32: those of texels are rounded down to them, bounds to the nearest. Of 49 lights alike
    the sum of chances is a rounding off 1: the last has the rest.
    """
    beyond, start = drawing_table(chances)
    assert beyond[-1] == STEPS
    np.testing.assert_allclose(beyond.astype(float), np.cumsum(chances) / chances.sum() * STEPS, rtol=1e-14, atol=0.5)
    bounds = np.concatenate([beyond / STEPS, np.arange(len(start)) / len(start)])
    near = [bounds + step / STEPS for step in (-1, -0.5, 0, 0.5, 1)]
    uniform = np.concatenate([*near, np.nextafter(bounds, 0), np.nextafter(bounds, 1), np.linspace(0, 1, 999)])
    uniform = uniform[(uniform >= 0) & (uniform <= 1)]
    chosen = np.empty(len(uniform), np.int32)
    draw_by_chance(chances, uniform, chosen)
    number = np.minimum(np.floor(uniform * STEPS), STEPS - 1).astype(np.uint64)
    np.testing.assert_array_equal(chosen, np.searchsorted(beyond, number, side="right"))


@pytest.mark.parametrize("chances", [np.array([0.5, np.nan, 0.5]), np.zeros(3), np.array([np.inf, 1.0, np.inf])])
def test_draws_end_at_the_last_light_whatever_the_chances_are(chances: np.ndarray) -> None:
    chosen = np.full(999, -1, np.int32)
    draw_by_chance(chances, np.linspace(0, 1, 999), chosen)
    assert ((chosen >= 0) & (chosen < len(chances))).all()
