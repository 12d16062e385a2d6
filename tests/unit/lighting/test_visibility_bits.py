"""Visibility bits against rays, the cost model against arithmetic on paper, and the cache."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.code_digest import imported_modules
from pipeline.lighting import visibility_bits
from pipeline.lighting.irradiance import trace_irradiance
from pipeline.lighting.light_scene import Lights
from pipeline.lighting.visibility_bits import (
    bits_are_cheaper,
    irradiance_from_bits,
    keep_bits,
    load_bits,
    trace_bits,
    trace_some_bits,
    visibility_key,
)
from tests.support.meshes.lit_meshes import LIGHTS, floor_under_a_ball


@pytest.mark.parametrize("distant", [False, True])
def test_any_pattern_costs_no_ray_and_is_exact(distant: bool) -> None:
    occluders, points, normals = floor_under_a_ball()
    places = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True) if distant else LIGHTS
    bits = trace_bits(occluders, points, normals, places, distant)
    assert bits.rays == 5 * 300
    rng = np.random.default_rng(0)
    for _ in range(4):
        lights = Lights(places, rng.random(5) * (rng.random(5) < 0.6), distant)
        smooth = normals + rng.normal(size=normals.shape) * 0.2
        traced = trace_irradiance(occluders, points, normals, lights, normals=smooth)
        known = irradiance_from_bits(bits, occluders, points, normals, lights, smooth)
        assert known.rays == 0
        assert known.unlit == traced.unlit
        np.testing.assert_allclose(known.values, traced.values, rtol=1e-12)
        np.testing.assert_allclose(known.cosine_visibility, traced.cosine_visibility, rtol=1e-12)


def test_bits_say_what_rays_say() -> None:
    occluders, points, normals = floor_under_a_ball()
    bits = trace_bits(occluders, points, normals, LIGHTS)
    for light, position in enumerate(LIGHTS):
        np.testing.assert_array_equal(bits.seen(light), occluders.visible(points, normals, position)[0])
    assert bits.bits.nbytes == 5 * 38  # 300 points in 38 bytes


def test_points_that_are_not_asked_for_see_all_lights() -> None:
    occluders, points, normals = floor_under_a_ball()
    some = np.arange(len(points)) % 3 == 1
    bits, whole = (
        trace_some_bits(occluders, points, normals, LIGHTS, some),
        trace_bits(occluders, points, normals, LIGHTS),
    )
    for light in range(len(LIGHTS)):
        seen = np.unpackbits(bits[light], count=len(points)).astype(bool)
        np.testing.assert_array_equal(seen[some], whole.seen(light)[some])
        assert seen[~some].all() and not whole.seen(light)[~some].all()


def test_cost_model() -> None:
    """One pattern of part of the lights never pays; all lights twice always does; a single sample only for a crowd."""
    assert not bits_are_cheaper(100, [10], None)
    assert not bits_are_cheaper(100, [100], None)
    assert bits_are_cheaper(100, [100, 100], None)
    assert not bits_are_cheaper(100, [10] * 9, None)
    assert bits_are_cheaper(100, [10] * 12, None)
    assert not bits_are_cheaper(100, [10] * 50, 1)
    # Dear sums: with all lights on, adding up the bits costs more than the single ray they save.
    assert not bits_are_cheaper(100, [100] * 1000, 1)


def test_cache_finds_only_what_was_traced_from_the_same(tmp_path: Path) -> None:
    occluders, points, normals = floor_under_a_ball()
    bits = trace_bits(occluders, points, normals, LIGHTS)
    vertices, faces = np.eye(3), np.array([[0, 1, 2]])
    key = visibility_key(points, vertices, faces, LIGHTS)
    assert load_bits(tmp_path, key) is None
    keep_bits(tmp_path, key, bits)
    loaded = load_bits(tmp_path, key)
    np.testing.assert_array_equal(loaded.bits, bits.bits)
    assert (loaded.points, loaded.rays) == (300, 1500)
    others = [
        visibility_key(points + 1e-9, vertices, faces, LIGHTS),
        visibility_key(points, vertices * 1.001, faces, LIGHTS),
        visibility_key(points, vertices, faces[:, ::-1], LIGHTS),
        visibility_key(points, vertices, faces, LIGHTS[::-1]),
    ]
    assert len({key, *others}) == 5


def test_bits_of_another_tracer_are_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor those of other offsets of its rays."""
    arrays = np.zeros((2, 3)), np.eye(3), np.array([[0, 1, 2]]), LIGHTS
    keys = [visibility_key(*arrays)]
    monkeypatch.setattr(visibility_bits, "LIGHT_CLEARANCE", 2 * visibility_bits.LIGHT_CLEARANCE)
    keys.append(visibility_key(*arrays))
    monkeypatch.setattr(visibility_bits, "code_digest", lambda module: f"{module}, edited")
    keys.append(visibility_key(*arrays))
    assert len(set(keys)) == 3
    assert {"pipeline.lighting.visibility", "pipeline.lighting.ray_kernels"} <= set(
        imported_modules("pipeline.lighting.visibility_bits")
    )
