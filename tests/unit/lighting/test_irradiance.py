"""Normalised irradiance against ratios on paper; the estimators against the sum over all lights."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.lighting.irradiance import IrradianceMap, Samples, draw_lights, trace_irradiance
from pipeline.lighting.light_sampling import pattern_numbers
from pipeline.lighting.light_scene import LUMINANCE, Lights, light_scene
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from tests.support.meshes.lit_meshes import LIGHTS, floor_under_a_ball

UP = np.array([0, 1.0, 0])


LUMINANCES = np.array([1.0, 0.2, 3.0, 0.5, 1.5])
ALL = Lights(LIGHTS, LUMINANCES)

TEXEL = np.stack(np.divmod(np.arange(300), 20), 1)
"""Where the 300 points lie on a map of 15 x 20 texels: anywhere, for what is tested here."""


def drawn(count: int, sampling: str, random: np.random.Generator, spread: str = "random") -> Samples:
    return Samples(count, sampling, spread, TexelBlocks(TEXEL), random)


def test_no_light_is_one_and_is_told() -> None:
    occluders, points, normals = floor_under_a_ball()
    for positions, luminances in [(np.zeros((0, 3)), np.zeros(0)), (LIGHTS, np.zeros(5))]:
        traced = trace_irradiance(occluders, points, normals, Lights(positions, luminances))
        assert traced.unlit
        assert traced.rays == 0
        np.testing.assert_array_equal(traced.values, 1)
        np.testing.assert_array_equal(traced.cosine_visibility, 1)


def test_one_light_is_zero_or_one() -> None:
    """Directly under the light: a disc of radius 5 tan(asin(0.7 / 3)) = 1.2 lies in shadow, whatever the brightness."""
    occluders, points, normals = floor_under_a_ball()
    traced = trace_irradiance(occluders, points, normals, Lights(LIGHTS[:1], np.array([1e-9])))
    radius = np.linalg.norm(points, axis=1)
    clear = np.abs(radius - 1.2) > 0.03
    np.testing.assert_allclose(traced.values[clear], (radius > 1.2)[clear], atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_two_lights_on_paper(scale: float) -> None:
    """At the origin the upper light (I = 1, d = 5) is hidden, the other (I = 2, d = 2) is not: (2/4) / (1/25 + 2/4)."""
    occluders, _, _ = floor_under_a_ball(scale)
    lights = scale * np.array([[0, 5.0, 0], [2 * np.sqrt(0.75), 1.0, 0]])
    traced = trace_irradiance(occluders, np.zeros((1, 3)), UP[None], Lights(lights, np.array([1.0, 2.0])))
    assert traced.values[0] == pytest.approx(0.5 / 0.54, rel=1e-12)
    # On a matte floor the cosines are 1 and 1/2.
    assert traced.cosine_visibility[0] == pytest.approx(0.25 / (0.04 + 0.25), rel=1e-12)
    assert not traced.unlit


def test_scale_and_brightness_do_not_matter() -> None:
    reference = trace_irradiance(*floor_under_a_ball(), Lights(LIGHTS, LUMINANCES)).values
    assert 0 < reference.min() < 0.9
    for scale in (1e-3, 1e3):
        values = trace_irradiance(*floor_under_a_ball(scale), Lights(LIGHTS * scale, LUMINANCES * 7)).values
        np.testing.assert_allclose(values, reference, rtol=1e-9)


def test_lights_below_the_horizon_count_but_cost_no_ray() -> None:
    occluders, points, normals = floor_under_a_ball()
    under = LIGHTS[:2] * [1, -1, 1]
    traced = trace_irradiance(occluders, points, normals, Lights(under, LUMINANCES[:2]))
    assert traced.rays == 0
    np.testing.assert_array_equal(traced.values, 0)
    np.testing.assert_array_equal(traced.cosine_visibility, 0)
    assert not traced.unlit


def both_maps(traced: IrradianceMap) -> np.ndarray:
    return np.concatenate([traced.values, traced.cosine_visibility])


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize(
    ("sampling", "spread"),
    [("uniform", "random"), ("power", "random"), ("arriving", "random"), ("power", "stratified"),
     ("arriving", "low_discrepancy")],
)  # fmt: skip
def test_estimates_are_unbiased(sampling: str, spread: str, samples: int) -> None:
    """The mean of 400 estimates per point lies within its own standard error of the sum over all lights: over 300
    points the squared deviations in units of that error average 1 +- sqrt(2 / 300), and none exceeds 5 sigma."""
    scene = floor_under_a_ball()
    full = both_maps(trace_irradiance(*scene, ALL))
    rng = np.random.default_rng(11)
    draws = np.stack([
        both_maps(trace_irradiance(*scene, ALL, samples=drawn(samples, sampling, rng, spread)))
        for _ in range(400)
    ])  # fmt: skip
    error = draws.std(0, ddof=1) / 20
    noisy = error > 1e-9
    np.testing.assert_allclose(draws.mean(0)[~noisy], full[~noisy], atol=1e-9)
    deviations = (draws.mean(0) - full)[noisy] / error[noisy]
    # Points that one light in a hundred reaches have skewed means; hence more than the 1.2 of normal ones.
    assert np.mean(deviations**2) < 1.35
    assert np.abs(deviations).max() < 5
    assert noisy.sum() > 50


def test_drawing_by_what_arrives_gives_zero_or_one() -> None:
    scene = floor_under_a_ball()
    traced = trace_irradiance(*scene, ALL, samples=drawn(1, "arriving", np.random.default_rng(0)))
    assert np.isin(np.round(traced.values, 6), [0.0, 1.0]).all()


def test_as_many_uniform_samples_as_lights_are_all_of_them() -> None:
    """Stratification puts one draw on each light."""
    scene = floor_under_a_ball()
    full = trace_irradiance(*scene, ALL)
    few = trace_irradiance(*scene, ALL, samples=drawn(5, "uniform", np.random.default_rng(0)))
    np.testing.assert_allclose(few.values, full.values, rtol=1e-12)
    assert few.rays == full.rays == 5 * 300


@pytest.mark.parametrize("sampling", ["uniform", "power", "arriving"])
def test_draws_follow_the_weights(sampling: str) -> None:
    """Inversion at 1,000 evenly spaced numbers hits each light as often as its share says, to one."""
    occluders, points, normals = floor_under_a_ball()
    here = np.repeat(points[:1], 1000, 0)
    scene = light_scene(occluders, here, normals[:1].repeat(1000, 0), ALL, None)
    squared = ((LIGHTS - points[0]) ** 2).sum(1)
    weights = {"uniform": np.ones(5), "power": LUMINANCES, "arriving": LUMINANCES / squared}[sampling]
    per_arriving, _ = scene.per_arriving()
    chosen, probability = draw_lights(scene, sampling, (np.arange(1000) + 0.5) / 1000, per_arriving)
    np.testing.assert_allclose(np.bincount(chosen, minlength=5), 1000 * weights / weights.sum(), atol=1)
    np.testing.assert_allclose(probability, (weights / weights.sum())[chosen], rtol=1e-12)
    ends, _ = draw_lights(scene, sampling, np.where(np.arange(1000) < 500, 0.0, np.nextafter(1, 0)), per_arriving)
    assert set(ends.tolist()) == {0, 4}


def test_hard_cases_stay_finite() -> None:
    ball = trimesh.creation.icosphere(2)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    points, normals = vertices[faces].mean(1), unit_or(area_vectors(vertices, faces), 0.0)
    cases = {
        "on the surface": points[:1],
        "inside": np.zeros((1, 3)),
        "coincident": np.tile([[0, 3.0, 0]], (4, 1)),
        "all on one side": np.array([[0, 3.0, 0], [0.1, 3, 0], [0, 3, 0.1]]),
        "far away": np.array([[0, 1e6, 0]]),
    }
    for name, lights in cases.items():
        traced = trace_irradiance(
            Occluders(vertices, faces), points, normals, Lights(lights, np.full(len(lights), 1e-30))
        )
        assert np.isfinite(traced.values).all(), name
        assert 0 <= traced.values.min() <= traced.values.max() <= 1 + 1e-12, name


@pytest.mark.parametrize("sampling", ["power", "arriving"])
def test_single_draws_of_many_seeds_cover_the_sum_as_often_as_they_should(sampling: str) -> None:
    """Means of 4,096 single draws: the exact value lies outside the 99 % interval about 1 in 100 of 300 points. More
    than 10 of them (300 x 1 % + 4 standard deviations) would be a bias, none a standard error too large."""
    scene = floor_under_a_ball()
    full = trace_irradiance(*scene, ALL).values
    rng, total, squares = np.random.default_rng(21), np.zeros(300), np.zeros(300)
    for _ in range(4096):
        values = trace_irradiance(*scene, ALL, samples=drawn(1, sampling, rng)).values
        total, squares = total + values, squares + values**2
    mean = total / 4096
    error = np.sqrt(np.maximum(squares / 4096 - mean**2, 0) / 4095)
    constant = error < 1e-9
    np.testing.assert_allclose(mean[constant], full[constant], atol=1e-9)
    outside = np.abs(mean - full)[~constant] > 2.5758 * error[~constant]
    assert 1 <= outside.sum() <= 10


def test_luminance_weighs_each_primary_as_rec_709_does() -> None:
    """ITU-R BT.709, item 3.2: E'Y = 0.2126 R + 0.7152 G + 0.0722 B; red is nearly three times as bright as blue."""
    red, green, blue = np.eye(3) @ LUMINANCE
    assert (red, green, blue) == (0.2126, 0.7152, 0.0722)


@pytest.mark.parametrize("distant", [False, True])
@pytest.mark.parametrize("sampling", ["power", "uniform"])
@pytest.mark.parametrize("pattern", ["random", "stratified", "low_discrepancy"])
def test_single_rays_are_estimates_in_float32(pattern: str, sampling: str, distant: bool) -> None:
    """L V / p over the sum of L, by NumPy in float64 from the same draws.

    The plain share to (m + 16) 2^-23; that of cosines, of which the sum may be small beside its terms, absolutely.
    """
    occluders, points, floor = floor_under_a_ball()
    rng = np.random.default_rng(3)
    normals = unit_or(floor + 0.2 * rng.normal(size=floor.shape), UP)
    places = rng.normal(size=(700, 3)) + np.array([0, 1.0, 0])
    places = places / np.linalg.norm(places, axis=1, keepdims=True) if distant else 3 * places
    lights = Lights(places, rng.uniform(0.1, 1, 700), distant)
    texel = np.stack(np.divmod(np.arange(len(points)), 40), 1)
    samples = Samples(1, sampling, pattern, TexelBlocks(texel), np.random.default_rng(0))
    traced = trace_irradiance(occluders, points, floor, lights, normals=normals, samples=samples)

    scene = light_scene(occluders, points, floor, lights, normals)
    chosen, probability = draw_lights(scene, sampling, pattern_numbers(pattern, texel, np.random.default_rng(0)))
    rays = occluders.aim(scene.receivers, scene.lights, distant, chosen=chosen)
    clear = np.zeros(len(points))
    clear[rays.rows[:, 0]] = occluders.occluded(rays) == -1
    assert traced.rays == len(rays.rows)
    assert 0.2 < clear.mean() < 0.9
    way = np.broadcast_to(places, (len(points), 700, 3)) - (0 if distant else points[:, None])
    length = np.linalg.norm(way, axis=2)
    light = scene.luminances / (np.ones_like(length) if distant else length**2)
    fall = light * np.maximum(np.einsum("tmd,td->tm", way, normals) / length, 0)
    own = np.arange(len(points)), chosen
    rtol = (700 + 16) * 2.0**-23
    np.testing.assert_allclose(traced.values, clear * light[own] / probability / light.sum(1), rtol)
    np.testing.assert_allclose(traced.cosine_visibility, clear * fall[own] / probability / fall.sum(1), 1e-4, 1e-4)
