"""The standard error written beside a map against the deviation that many seeds really show."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.lighting.irradiance import Lights, Samples, trace_irradiance
from pipeline.lighting.standard_error import BLOCK, BlockVariance, TexelBlocks
from pipeline.lighting.visibility import Occluders
from tests.unit.lighting.test_visibility import plate, sphere, together

SIDE = 32
TEXEL = np.stack(np.divmod(np.arange(SIDE**2), SIDE), 1)


def floor_map() -> tuple[Occluders, np.ndarray, np.ndarray]:
    """A ball over a floor whose points are the texels of a map."""
    across = (TEXEL + 0.5) / SIDE * 6 - 3
    points = np.stack([across[:, 1], np.zeros(len(across)), across[:, 0]], 1)
    return Occluders(*together(plate(9, 0.0), sphere(0.7, (0, 2, 0), 3))), points, np.tile([0, 1.0, 0], (SIDE**2, 1))


def ring_of_lights() -> Lights:
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    places = np.stack([3 * np.cos(around), np.full(12, 4.0), 3 * np.sin(around)], 1)
    return Lights(places, np.linspace(0.5, 2, 12))


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
    alone = BlockVariance(TexelBlocks(np.array([[5, 9]])))
    alone.add(np.array([0.7]))
    assert alone.total[0] == 0
