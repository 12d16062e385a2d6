"""The standard error written beside a map against the deviation that many seeds really show."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.lighting.irradiance import Samples, trace_irradiance
from pipeline.lighting.standard_error import BLOCK, BlockVariance, TexelBlocks
from tests.support.meshes.lit_meshes import SIDE, TEXEL, floor_map, ring_of_lights


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("sampling", ["uniform", "arriving"])
def test_error_is_what_seeds_show(sampling: str, count: int) -> None:
    """Root mean squares over the map: the stated error is that of 200 seeds to 10 %, or larger by half at most (it is
    allowed to err on the safe side, where the true value changes between texels)."""
    occluders, points, normals = floor_map()
    rng = np.random.default_rng(5)
    drawn = [
        trace_irradiance(
            occluders,
            points,
            normals,
            ring_of_lights(),
            samples=Samples(count, sampling, "random", TexelBlocks(TEXEL), rng),
        )
        for _ in range(200)
    ]
    shown = np.sqrt(np.stack([one.values for one in drawn]).var(0, ddof=1).mean())
    stated = np.sqrt(np.mean([one.error**2 for one in drawn]))
    assert 0.9 < stated / shown < 1.5
    assert shown > 0.01


def test_all_lights_leave_no_error() -> None:
    assert not trace_irradiance(*floor_map(), ring_of_lights()).error.any()


def test_known_variances() -> None:
    """A checkerboard of 0 and 1: 8 of each in a block, variance 8 x 8 / 16 / 15."""
    checkers = BlockVariance(TexelBlocks(TEXEL))
    checkers.add(TEXEL.sum(1) % 2.0)
    np.testing.assert_allclose(checkers.total, 8 * 8 / BLOCK**2 / (BLOCK**2 - 1), rtol=1e-12)
    checkers.add(np.full(SIDE**2, 1 / 3))  # a second draw that varies nowhere
    np.testing.assert_allclose(checkers.total, 8 * 8 / BLOCK**2 / (BLOCK**2 - 1), rtol=1e-12)
    np.testing.assert_allclose(checkers.error_of_mean(2), np.sqrt(4 / 15) / 2, rtol=2**-23)
    alone = BlockVariance(TexelBlocks(np.array([[5, 9]])))
    alone.add(np.array([0.7]))
    assert alone.total[0] == 0


def test_sums_and_squares_tell_the_same() -> None:
    blocks, draws = TexelBlocks(TEXEL), np.random.default_rng(0).random(SIDE**2)
    by_draws, by_sums = BlockVariance(blocks), BlockVariance(blocks)
    by_draws.add(draws)
    by_sums.add_sums(np.bincount(blocks.block, draws), np.bincount(blocks.block, draws**2))
    np.testing.assert_allclose(by_sums.total, by_draws.total, rtol=1e-12)
    same = BlockVariance(blocks)
    same.add_sums(blocks.count / 3, blocks.count / 9)
    assert same.error_of_mean(1).max() < 1e-7
