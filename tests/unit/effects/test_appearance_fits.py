"""Colours made by formulas of their own: what explains them is found, and nothing else."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest

from pipeline.effects.appearance_evidence import gloss_width
from pipeline.effects.appearance_fits import explain_colors
from pipeline.effects.seen_texels import SeenTexels
from pipeline.effects.texel_light import TexelLight
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.subsurface import SurfaceSamples

TEXELS, FRAMES, CAMERAS, LAMPS = 300, 4, 5, 6
NOISE = 0.004


def observe(shade, strays: float = 0.0, regions=MappingProxyType({})):
    """A unit ball under distant lamps; `shade(cosine to lamps, half cosine, texels)` is what an albedo of 1 shows."""
    random = np.random.default_rng(1)

    def directions(*shape):
        vectors = random.normal(size=(*shape, 3))
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

    normals, albedo = directions(TEXELS), random.uniform(0.2, 0.7, (TEXELS, 3))
    lights, lit, parts = [], [], []
    for frame in range(FRAMES):
        ways = directions(LAMPS)
        power = random.uniform(0.5, 1, (LAMPS, 1)) * np.ones(3)
        cosine = ways @ normals.T
        seen = cosine > 0
        arriving = np.repeat(power[:, None], TEXELS, 1)
        lit.append(TexelLight(arriving, cosine, seen, np.packbits(seen, 1), np.zeros((TEXELS, 0), np.int64)))
        lights.append(FrameLights(1e3 * ways + 0.0, 1e6 * power))
        for to_camera in directions(CAMERAS):
            point = np.flatnonzero(normals @ to_camera > 0.3)
            half = ways + to_camera
            half = (half / np.linalg.norm(half, axis=1, keepdims=True)) @ normals[point].T
            matte, gloss = shade(cosine[:, point], half, point)
            color = (matte.T @ power) * albedo[point] + gloss.T @ power
            color = color + NOISE * random.normal(size=color.shape)
            wrong = random.random(len(point)) < strays
            color[wrong] = random.uniform(2, 4, (wrong.sum(), 3))
            parts.append((np.full(len(point), frame), point, color, np.tile(to_camera, (len(point), 1))))
    frame, point, color, to_camera = (np.concatenate(part) for part in zip(*parts, strict=True))
    points = np.repeat(normals[None], FRAMES, 0)
    texels, frames = np.arange(TEXELS), np.arange(FRAMES)
    one = np.ones(len(point))
    return explain_colors(
        SeenTexels(texels, frames, points, points, frame, point, color, to_camera, one),
        lights,
        lit,
        SurfaceSamples(normals, normals, np.full(TEXELS, 4 * np.pi / TEXELS)),
        regions,
    )


def matte(cosine, half, _):
    return cosine.clip(0) / np.pi, 0 * half


def glossy(cosine, half, _):
    """Blinn's lobe, as wide as GGX of width sqrt(2 / (80 + 2)) = 0.16."""
    return cosine.clip(0) / np.pi, 0.5 * (cosine > 0) * half.clip(0) ** 80


def wrapped(cosine, half, _):
    """Light that leaks across the terminator."""
    return ((cosine + 0.6) / 1.6).clip(0) / np.pi, 0 * half


def mixed(cosine, half, point):
    """One third of the texels is glossy, and light leaks on another."""
    kinds = (glossy, wrapped, matte)
    chosen = np.array([kind(cosine, half, point) for kind in kinds])
    return [np.choose(3 * point // TEXELS, chosen[:, which]) for which in (0, 1)]


def test_matte_colours_need_nothing():
    found = observe(matte)
    assert abs(found.gloss_db) < 0.02
    assert found.transport_db < 0.1
    # The residual is the noise, a few percent of which each texel's albedo takes; its slope in sRGB is above 0.44.
    assert 0.4 * NOISE < found.floor < 6 * NOISE


def test_gloss_is_found_and_is_no_transport():
    found = observe(glossy)
    assert found.gloss_db > 3
    assert found.transport_db < found.gloss_db / 3
    assert found.gloss.argmax() in (1, 2, 3)
    # Within a third of Blinn's: its foot is shorter than that of GGX, and widths are a factor 1.6 apart.
    assert gloss_width(found) == pytest.approx(0.16, rel=1 / 3)


def test_leaking_light_is_transport_and_no_gloss():
    found = observe(wrapped)
    assert found.transport_db > 3
    assert found.gloss_db < 0.3


def test_regions_of_different_materials_are_told_apart():
    thirds = np.array_split(np.arange(TEXELS), 3)
    found = observe(mixed, regions=dict(zip(("plastic", "wax", "paper"), thirds, strict=True))).regions
    assert found["plastic"].gloss_db > 3 > 0.3 > max(found[name].gloss_db for name in ("wax", "paper"))
    assert found["wax"].transport_db > 3 > 0.3 > found["paper"].transport_db
    assert found["plastic"].transport_db < found["plastic"].gloss_db / 3
    assert sum(gains.observations for gains in found.values()) == observe(mixed).observations


@pytest.mark.parametrize("shade", [matte, glossy])
def test_strays_are_left_out(shade):
    """Two in a hundred observations show something else, brighter than white: they neither hide gloss nor make it."""
    clean, stray = observe(shade), observe(shade, strays=0.02)
    assert stray.strays > clean.strays + 0.01
    assert (stray.gloss_db > 3) == (shade is glossy)
    assert stray.gloss_db < max(0.1, clean.gloss_db + 0.1)
    assert stray.floor < 1.5 * clean.floor
