"""The blur of drawn irradiance maps against planted noise on a map with holes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.texels import Atlas
from pipeline.lighting.drawn_maps import NOISE_LEFT, smooth_drawn

SIDE = 96


def rings() -> Atlas:
    """A map whose texels lie in rings, with as much outside as inside."""
    row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
    inside = np.hypot(row - SIDE / 2, column - SIDE / 2) % 24 < 12
    texel = np.stack([row, column], 1)[inside].astype(np.int32)
    count, none = len(texel), np.zeros((1, 3), np.float32)
    return Atlas(
        SIDE, np.zeros((1, 3), np.int32), np.zeros((1, 3, 2), np.float32), np.zeros(1, np.int32), none, texel,
        np.zeros(count, np.int32), np.repeat(none, count, 0), np.zeros(count, np.int32), np.repeat(none, count, 0),
    )  # fmt: skip


@pytest.mark.parametrize("noise", [0.1, 0.25, 0.5])
def test_planted_noise_falls_to_what_is_meant_to_be_left(noise: float) -> None:
    """In the rings' middles; at their edges there is only half as much to average. Nothing outside leaks in: the mean
    stays what it is to the noise of some 50 independent patches."""
    atlas, random = rings(), np.random.default_rng(3)
    flat = np.full(atlas.texel_count, 0.6, np.float32)
    drawn = flat + noise * random.standard_normal(len(flat)).astype(np.float32)
    found, falling = smooth_drawn(atlas, drawn, flat, np.full_like(flat, noise))
    left = np.sqrt(np.mean((found - 0.6) ** 2))
    assert 0.8 * NOISE_LEFT < left < 1.6 * NOISE_LEFT
    assert abs(found.mean() - 0.6) < 3 * NOISE_LEFT / np.sqrt(50)
    np.testing.assert_allclose(falling, 0.6, rtol=1e-6)


def test_exact_maps_stay_as_they_are() -> None:
    atlas, random = rings(), np.random.default_rng(4)
    maps = random.random((2, atlas.texel_count)).astype(np.float32)
    for error in (0.0, 0.9 * NOISE_LEFT):
        for found, given in zip(smooth_drawn(atlas, *maps, np.full_like(maps[0], error)), maps, strict=True):
            np.testing.assert_array_equal(found, given)


def test_a_map_without_texels() -> None:
    atlas = rings()
    per_texel = ("texel", "face", "barycentric", "chart", "tangent_weights")
    empty = replace(atlas, **{name: getattr(atlas, name)[:0] for name in per_texel})
    none = np.zeros(0, np.float32)
    assert all(not len(found) for found in smooth_drawn(empty, none, none, none))
