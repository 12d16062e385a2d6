"""Rays that neighbours share: exact where no shadow is cast, near to the sum over all lights where one is."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.texels import Atlas
from pipeline.lighting.interleaved_sampling import Neighbours, share_rays
from pipeline.lighting.irradiance import IrradianceMap, Samples, trace_irradiance
from pipeline.lighting.light_scene import Lights, light_scene
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from tests.support.meshes.lit_meshes import TEXEL, floor_map, plate, ring_of_lights, sphere, together

SIDE = 32
UP = np.tile([0, 1.0, 0], (SIDE**2, 1))
ROUNDING = 1e-12


def neighbours(chart: np.ndarray | None = None) -> Neighbours:
    """A map of 32 x 32 texels, by default one chart."""
    none, count = np.zeros((1, 3), np.float32), len(TEXEL)
    chart = np.zeros(count, np.int32) if chart is None else chart
    return Neighbours(
        Atlas(
            SIDE, np.zeros((1, 3), np.int32), np.zeros((1, 3, 2), np.float32), np.zeros(1, np.int32), none,
            TEXEL.astype(np.int32), np.zeros(count, np.int32), np.repeat(none, count, 0), chart,
            np.repeat(none, count, 0),
        )
    )  # fmt: skip


def shared(
    occluders: Occluders, points: np.ndarray, normals: np.ndarray, lights: Lights, count: int = 1,
    sampling: str = "power", spread: str = "low_discrepancy", seed: int = 0, chart: np.ndarray | None = None,
) -> IrradianceMap:  # fmt: skip
    scene = light_scene(occluders, points, normals, lights, None)
    samples = Samples(count, sampling, spread, TexelBlocks(TEXEL), np.random.default_rng(seed))
    return share_rays(scene, samples, neighbours(chart))


def rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(difference**2)))


@pytest.mark.parametrize("sampling", ["uniform", "power", "arriving"])
def test_where_nothing_casts_a_shadow_one_draw_is_exact(sampling: str) -> None:
    """Texels all around a ball alone: strength, cosine and horizon are each texel's own, so no chance is left."""
    turn, up = (TEXEL.T + 0.5) / SIDE * [[2 * np.pi], [np.pi]]
    normals = np.stack([np.sin(up) * np.cos(turn), np.cos(up), np.sin(up) * np.sin(turn)], 1)
    scene = (Occluders(*sphere(0.7, (0, 2, 0), 4)), 0.7001 * normals + [0, 2, 0], normals)
    exact, found = trace_irradiance(*scene, ring_of_lights()), shared(*scene, ring_of_lights(), sampling=sampling)
    np.testing.assert_allclose(found.values, exact.values, atol=ROUNDING)
    np.testing.assert_allclose(found.cosine_visibility, exact.cosine_visibility, atol=ROUNDING)
    assert exact.values.min() < 0.2 < 0.8 < exact.values.max()


def test_one_ray_comes_near_to_all_rays() -> None:
    """Shadows of twelve lights under a ball: a texel alone is off by more than 1 (RMS, of a map between 0 and 1)."""
    exact = trace_irradiance(*floor_map(), ring_of_lights())
    blocks = TexelBlocks(TEXEL)
    samples = Samples(1, "power", "low_discrepancy", blocks, np.random.default_rng(0))
    alone = trace_irradiance(*floor_map(), ring_of_lights(), samples=samples)
    found = shared(*floor_map(), ring_of_lights())
    assert found.rays == alone.rays == SIDE**2
    for name in ("values", "cosine_visibility"):
        assert rms(getattr(found, name) - getattr(exact, name)) < 0.15 * rms(
            getattr(alone, name) - getattr(exact, name)
        )


def test_more_draws_come_nearer() -> None:
    exact = trace_irradiance(*floor_map(), ring_of_lights()).values
    errors = [rms(shared(*floor_map(), ring_of_lights(), count).values - exact) for count in (1, 2, 4, 8)]
    assert errors == sorted(errors, reverse=True)


def test_lamps_that_hardly_glow_change_nothing() -> None:
    """A thousand more, each a billionth as bright: neither what is drawn nor how far neighbours lend their rays."""
    ring = ring_of_lights()
    faint = np.random.default_rng(0).normal(size=(1000, 3)) + np.array([0, 9, 0])
    more = Lights(np.concatenate([ring.places, faint]), np.concatenate([ring.luminances, np.full(1000, 1e-9)]))
    alone, among = shared(*floor_map(), ring), shared(*floor_map(), more)
    assert np.mean(np.abs(among.values - alone.values) > 1e-5) < 0.01  # a uniform number may fall between two lamps


def test_charts_lend_each_other_nothing() -> None:
    """The left half of the map lies in the shadow of every light, the right half in none."""
    left = TEXEL[:, 1] < SIDE // 2
    lights = Lights(np.array([[0, 9.0, 0], [1, 9.0, 0], [0, 9.0, 2]]), np.ones(3))
    points = np.where(left[:, None], [0.0, 0.0, 0.0], [50.0, 0.0, 0.0])
    scene = Occluders(*together(plate(200, -1.0), plate(20, 1.0))), points, UP
    apart = shared(*scene, lights, chart=left.astype(np.int32))
    np.testing.assert_allclose(apart.values, ~left, atol=ROUNDING)
    mixed = shared(*scene, lights)
    assert rms(mixed.values - ~left) > 0.05


@pytest.mark.parametrize("sampling", ["uniform", "power", "arriving"])
def test_far_more_lights_than_draws(sampling: str) -> None:
    """A sky of 3,000 lights of very unequal strength, of which a wall hides those on one side, the same for all texels
    of a patch. A ratio of means of n draws is biased by less than its variance, 1 / n; n is 21 at least, at a corner.
    """
    rng = np.random.default_rng(3)
    sky = rng.normal(size=(3000, 3)) * [1, 1, 1]
    sky[:, 1] = np.abs(sky[:, 1])
    sky /= np.linalg.norm(sky, axis=1, keepdims=True)
    lights = Lights(sky, rng.exponential(size=3000) * np.exp(2 * sky[:, 0]), distant=True)
    wall = np.array([[0.01, -9, -900], [0.01, 900, -900], [0.01, 900, 900], [0.01, -9, 900]])
    points = 1e-6 * np.stack([TEXEL[:, 0], 0 * TEXEL[:, 0], TEXEL[:, 1]], 1)
    scene = Occluders(wall, np.array([[0, 1, 2], [0, 2, 3]])), points, UP
    exact = trace_irradiance(*scene, lights).values
    drawn = [shared(*scene, lights, sampling=sampling, spread="random", seed=seed) for seed in range(60)]
    mean = np.mean([one.values for one in drawn], 0)
    assert 0.05 < exact.mean() < 0.6
    assert abs(mean.mean() - exact.mean()) < 1 / 21
    shown = np.sqrt(np.stack([one.values for one in drawn]).var(0, ddof=1).mean())
    assert shown > 0.02
    assert 0.9 < np.sqrt(np.mean([one.error**2 for one in drawn])) / shown < 1.1


@pytest.mark.parametrize(("spread", "most"), [("random", 1.1), ("low_discrepancy", 2.5)])
def test_error_is_what_seeds_show(spread: str, most: float) -> None:
    """For independent draws to 10 %: over the map 60 seeds tell it to about 2 %. Draws that are spread evenly over the
    map err less than independent ones, for which the error is stated."""
    drawn = [shared(*floor_map(), ring_of_lights(), spread=spread, seed=seed) for seed in range(60)]
    shown = np.sqrt(np.stack([one.values for one in drawn]).var(0, ddof=1).mean())
    stated = np.sqrt(np.mean([one.error**2 for one in drawn]))
    assert 0.9 < stated / shown < most
    assert shown > 0.01
