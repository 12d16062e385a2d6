"""The numbers of docs/real_data.md: others' lights, head, panoramas and figure, beside sums by definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.gltf_by_definition import Glb, posed_both_ways
from benchmarks.real_data import (
    HEAD_M,
    even_deviation,
    fit_sphere,
    irradiance_both_ways,
    lobe_errors,
    matte_errors,
    nearest_distances,
    unwrapped_head,
)
from pipeline.config.plan_effects import PlanEffects
from pipeline.datasets.openillumination_tables import read_lights
from pipeline.effects.light_evidence import texel_points
from pipeline.effects.scene_evidence import near_field_evidence
from pipeline.lighting.environment import read_environment
from pipeline.stages.plan_effects import decide
from tests.support.shared_data import shared_data

LIGHTS, needs_lights = shared_data("data/lights_openillumination")
HEAD, needs_head = shared_data("data/head_leeperrysmith")
PANORAMAS, needs_panoramas = shared_data("data/hdr_polyhaven")
FIGURE, needs_figure = shared_data("data/rigged_cesiumman")


@pytest.fixture(scope="module")
def lights():
    places = read_lights(LIGHTS)
    return places - fit_sphere(places).center


@pytest.fixture(scope="module")
def head():
    return unwrapped_head(HEAD / "LeePerrySmith.glb")


@needs_lights
def test_lights_lie_on_a_sphere_of_radius_one():
    """Published places keep float64's rounding, a few 2^-53 of coordinates up to 1."""
    places = read_lights(LIGHTS)
    sphere = fit_sphere(places)
    assert len(places) == 142
    assert sphere.radius == pytest.approx(1, abs=1e-12)
    assert np.abs(sphere.off).max() < 1e-12
    # Caps of half the distance between neighbours, packed at pi / sqrt(12) of the sphere at best: 0.32 for 142.
    cap = math.pi / math.sqrt(12) * 4 / len(places)
    assert 0 < nearest_distances(places).min() < 2 * math.sqrt(cap)


@needs_lights
@needs_head
@pytest.mark.parametrize(("times", "on"), [(1, True), (4, True), (8, False)])
def test_near_field_of_a_head_on_the_stage(lights, head, times, on):
    """By the definition, at every tenth texel and every light; off where that is below the threshold."""
    settings = PlanEffects()
    places, random = times * lights, np.random.default_rng(0)
    found = decide(
        "auto", near_field_evidence(head, [(head.rest_vertices, places)], settings.rays, random),
        settings.near_field_percent,
    )  # fmt: skip
    points, _ = texel_points(head, head.rest_vertices, np.arange(0, head.texel_count, 10))
    by_definition = even_deviation(points, places)
    assert found["on"] == on == (by_definition > settings.near_field_percent)
    # 4096 draws know the middle to 0.1 m / 64, 1.4 % of the evidence, and the percentile to some percent.
    assert found["evidence"] == pytest.approx(by_definition, rel=0.06)
    # 1 / (1 - h / d)^2 - 1 at most, of a head within h of its middle, which is d or more from each light.
    reach = np.linalg.norm(points - points.mean(0), axis=1).max()
    assert by_definition < 100 * (1 / (1 - reach / (times - reach)) ** 2 - 1)


@needs_head
def test_scanned_head_is_unwrapped_whole(head):
    """Its own coordinates serve; what texels show has the scan's area but for faces that are smaller than texels."""
    corners = head.rest_vertices[head.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    edges = head.uv[:, 1:].astype(np.float64) - head.uv[:, :1]
    on_map = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]).sum() / 2
    assert np.ptp(head.rest_vertices[:, 1]) == pytest.approx(HEAD_M, rel=1e-6)
    # A texel counts if its centre is inside: off by the charts' outlines alone, and by what overlaps.
    assert head.texel_count / head.size**2 == pytest.approx(on_map, rel=0.02)
    assert area[np.unique(head.face)].sum() > 0.93 * area.sum()


@needs_lights
@needs_head
def test_traced_irradiance_of_the_head_is_that_of_every_triangle(lights, head):
    """To rounding if rays start where the tracer's do; from the surface itself one ray in thousands may differ."""
    some = np.random.default_rng(1).choice(head.texel_count, 50, replace=False)
    traced = irradiance_both_ways(head, some, lights)
    assert 0.3 < traced.ours.mean() < 0.5  # half of them are above the horizon of a face; the head hides some
    assert np.abs(traced.ours - traced.lifted).max() < 1e-12
    assert traced.rays_off <= 0.001 * len(some) * len(lights)


@needs_panoramas
@pytest.mark.parametrize("name", ["royal_esplanade_1k", "venice_sunset_1k"])
def test_light_of_panoramas_is_the_sum_over_their_pixels(name):
    environment = read_environment(PANORAMAS / f"{name}.hdr")
    turns = Rotation.random(4, random_state=1).as_matrix()
    # A clamped cosine has 3.7e-4 of its energy above degree 8: 1.9 % rms of a lamp's light, of smoother light less.
    assert 1e-6 < matte_errors(environment, turns) < 0.0194
    # Half way between rungs t e^(-t x) is off by (range of t)^2 / 8 e^(-t x) (t x^2 - 2 x), x half the angle squared:
    # of a lamp 1.04 % in the rms, of even light nothing. Bicubic interpolation adds 0.4 %.
    axes = turns.transpose(0, 2, 1).reshape(-1, 3)
    assert max(lobe_errors(environment, axes, (0.025, 0.06, 0.25))) < 0.015


@needs_figure
def test_figure_is_posed_as_the_specification_says():
    """To float64's rounding: 19 joints in a chain of products, 2^-53 each, of coordinates up to 2 m."""
    path = FIGURE / "CesiumMan.glb"
    ours, true = posed_both_ways(path)
    assert ours.shape == (49, 3273, 3)
    assert np.abs(ours[0] - ours[24]).max() > 0.1  # it walks
    assert np.abs(ours - true).max() < 1e-13
    # What both have to correct: the exporter kept four weights of some vertices that had more.
    assert (Glb(path).weights().sum(1) < 0.999).sum() == 210
