"""Lights and meshes that break shadow rays: maps finite, within their range, and right where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas
from pipeline.lighting.frame_irradiance import FrameTracer, StageLights
from pipeline.lighting.interleaved_sampling import Neighbours, share_rays
from pipeline.lighting.irradiance import IrradianceMap, Samples, trace_irradiance
from pipeline.lighting.light_scene import Lights, light_scene
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from tests.support.naive.surfaces import naive_visible
from tests.support.results.hard_case import HardCase, worst

UP = np.array([0, 1.0, 0])
ROUNDING = 1e-12
"""Of sums over a few lights in float64, whose order differs above and below the fraction."""


def ball(subdivisions: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, and the middle and normal of every face of a ball of radius 1."""
    mesh = trimesh.creation.icosphere(subdivisions)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    return vertices, faces, vertices[faces].mean(1), unit_or(area_vectors(vertices, faces), 0.0)


def plane(half: float = 9.0, height: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    corners = half * np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1.0]]) + [0, height, 0]
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def traced(places: np.ndarray, luminances: np.ndarray | None = None, **options: object) -> IrradianceMap:
    """Every face of the ball under the lights."""
    vertices, faces, points, normals = ball()
    luminances = np.ones(len(places)) if luminances is None else luminances
    return trace_irradiance(Occluders(vertices, faces), points, normals, Lights(places, luminances), **options)


def check_range(case: HardCase, result: IrradianceMap) -> None:
    """How far beyond [0, 1] the maps reach."""
    for values in (result.values, result.cosine_visibility):
        assert values.min() >= 0
        case.check(max(values.max() - 1, 0.0), ROUNDING)


def naive_share(places: np.ndarray, luminances: np.ndarray) -> np.ndarray:
    """What arrives over the horizon of each point of the ball, over all that is sent there, as it is written down."""
    _, _, points, normals = ball()
    way = places - points[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        sent = luminances / (way**2).sum(-1)
        return (sent * ((way * normals[:, None]).sum(-1) > 0)).sum(1) / sent.sum(1)


def test_no_light_on_is_one_by_definition_and_counted(case: HardCase) -> None:
    for places, luminances in [(np.zeros((0, 3)), np.zeros(0)), (3 * np.eye(3), np.zeros(3))]:
        result = traced(places, luminances)
        assert result.unlit
        assert result.rays == 0
        case.check(worst(result.values, np.ones_like(result.values)), 0)
        case.naive_fails(worst(naive_share(places, luminances), np.ones(len(result.values))))


def test_one_light_lights_the_side_that_faces_it(case: HardCase) -> None:
    result = traced(np.array([[0, 4.0, 0]]))
    _, _, points, normals = ball()
    faces_it = ((np.array([0, 4.0, 0]) - points) * normals).sum(1) > 0
    case.check(worst(result.values, faces_it), ROUNDING)
    check_range(case, result)


def test_coincident_lights_are_one_light(case: HardCase) -> None:
    one = traced(np.array([[1, 4.0, 2]]))
    seven = traced(np.tile([[1, 4.0, 2]], (7, 1)), np.arange(1.0, 8))
    case.check(worst(seven.values, one.values), ROUNDING)


def test_light_on_the_surface_outshines_all_others_where_it_lies(case: HardCase) -> None:
    """At its own texel it is as strong as 1 / MIN_DISTANCE^2, but on the horizon: hidden; elsewhere it is below it."""
    vertices, faces, points, normals = ball()
    places = np.stack([points[0], np.array([0, 5.0, 0])])
    result = trace_irradiance(Occluders(vertices, faces), points, normals, Lights(places, np.ones(2)))
    check_range(case, result)
    case.check(result.values[0], 1e-9)
    case.naive_fails(worst(naive_share(places, np.ones(2))[0], 0.0))


def test_light_inside_a_closed_mesh_reaches_nothing(case: HardCase) -> None:
    result = traced(np.zeros((1, 3)))
    assert result.rays == 0
    case.check(result.values.max(), 0)


def test_light_behind_the_subject_reaches_nothing_in_front(case: HardCase) -> None:
    result = traced(np.array([[0, 0, -50.0]]))
    _, _, points, _ = ball()
    case.check(result.values[points[:, 2] > 0.2].max(), 0)


@pytest.mark.parametrize("degrees", [1.0, 0.1, 0.01, 1e-3])
def test_grazing_rays_over_a_flat_floor_are_clear(case: HardCase, degrees: float) -> None:
    """A plane of many faces does not shadow itself, however low the light."""
    grid = trimesh.creation.box((2, 2e-9, 2)).subdivide_loop(0).subdivide().subdivide().subdivide()
    flat = np.array(grid.vertices) * [1, 0, 1]
    faces = np.array(grid.faces)[area_vectors(np.array(grid.vertices), np.array(grid.faces))[:, 1] > 0]
    points = flat[faces].mean(1)
    light = 1000 * np.array([[np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0]])
    seen, rays = Occluders(flat, faces).visible(points, np.tile(UP, (len(points), 1)), light[0])
    assert rays == len(points)
    case.check(np.mean(~seen), 0)
    case.naive_fails(np.mean(~naive_visible(flat, faces, points, np.tile(UP, (len(points), 1)), light[0], offset=0.0)))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("shift", [0.0, 20.0])
def test_scene_scales_and_places_do_not_matter(case: HardCase, scale: float, shift: float) -> None:
    """A convex body has no cast shadows: what faces the light is lit, at every scale and away from the origin."""
    vertices, faces, points, normals = ball(4)
    light = np.array([2, 3, 4.0])
    occluders = Occluders((vertices + shift) * scale, faces)
    seen, _ = occluders.visible((points + shift) * scale, normals, (light + shift) * scale)
    slope = ((light - points) * normals).sum(1)
    sure = np.abs(slope) > 1e-9
    case.check(np.mean(seen[sure] != (slope[sure] > 0)), 0)
    moved = ((array + shift) * scale for array in (vertices, points, light))
    naive = naive_visible(next(moved), faces, next(moved), normals, next(moved), offset=0.0)
    case.naive_fails(np.mean(naive[sure] != (slope[sure] > 0)))


def test_faces_without_area_stay_dark_and_cast_nothing(case: HardCase) -> None:
    vertices, faces = plane()
    needle = np.array([[0, 1, 0], [0.5, 1, 0], [1, 1, 0.0]])  # three points on a line, above the origin
    occluders = Occluders(np.concatenate([vertices, needle]), np.concatenate([faces, [[4, 5, 6], [4, 4, 5]]]))
    lights = Lights(np.array([[0.5, 3, 0.0]]), np.ones(1))
    points, normals = np.array([[0.5, 0, 0], [0.5, 1, 0]]), np.array([UP, np.zeros(3)])
    result = trace_irradiance(occluders, points, normals, lights)
    case.check(worst(result.values, [1, 0]), ROUNDING)
    check_range(case, result)


def test_open_and_non_manifold_meshes(case: HardCase) -> None:
    """Three half planes that share one edge: each side of the fan is lit by the lights on its side alone."""
    edge = np.array([[0, 0, -5], [0, 0, 5.0]])
    tips = [np.array([[x, y, -5], [x, y, 5.0]]) for x, y in ((5, 0), (0, 5), (-5, 0))]
    vertices = np.concatenate([edge, *tips])
    faces = np.concatenate([[[0, i, 1], [1, i, i + 1]] for i in (2, 4, 6)])
    points = np.array([[2, 0, 0], [-2, 0, 0], [2, 0, 0.0]])
    normals = np.array([UP, UP, -UP])
    lights = Lights(np.array([[3, 4, 0.0]]), np.ones(1))
    result = trace_irradiance(Occluders(vertices, faces), points, normals, lights)
    case.check(worst(result.values, [1, 0, 0]), ROUNDING)


def test_an_atlas_without_texels_has_an_empty_map() -> None:
    vertices, faces, _, _ = ball()
    none = np.zeros(0, np.int32)
    atlas = Atlas(
        8, faces.astype(np.int32), np.zeros((len(faces), 3, 2), np.float32),
        np.arange(len(vertices), dtype=np.int32), vertices.astype(np.float32), np.zeros((0, 2), np.int32), none,
        np.zeros((0, 3), np.float32), none, np.zeros((0, 3), np.float32),
    )  # fmt: skip
    stage = StageLights(np.array([[0, 4.0, 0]]), {0: np.ones(1)})
    for samples in ("full", "1", "4"):
        for visibility in ("traced", "cached"):
            settings = TraceIrradiance(samples=samples, visibility=visibility)
            result = FrameTracer(atlas, stage, settings).trace(0, vertices, np.random.default_rng(0))
            assert len(result.values) == len(result.error) == result.rays == 0


def test_all_lights_on_one_side_and_very_unequal(case: HardCase) -> None:
    """Twelve decades between two lights: the weak one alone lights what the strong one cannot reach."""
    result = traced(np.array([[0, 5.0, 0], [0, -5.0, 0]]), np.array([1e12, 1.0]))
    check_range(case, result)
    _, _, points, _ = ball()
    case.check(worst(result.values[points[:, 1] > 0.5], 1.0), ROUNDING)
    below = result.values[points[:, 1] < -0.5]
    assert ((below > 0) & (below < 1e-9)).all()


def test_drawn_lights_stay_finite_under_extreme_weights() -> None:
    vertices, faces, points, normals = ball()
    texel = np.stack(np.divmod(np.arange(len(points)), 20), 1)
    lights = Lights(np.array([[0, 5.0, 0], [0, -5.0, 0], [1.0, 0, 0]]), np.array([1e-300, 1e300, 1e-30]))
    for sampling in ("uniform", "power", "arriving"):
        samples = Samples(3, sampling, "random", TexelBlocks(texel), np.random.default_rng(0))
        result = trace_irradiance(Occluders(vertices, faces), points, normals, lights, samples=samples)
        assert np.isfinite(result.values).all(), sampling
        assert np.isfinite(result.error).all(), sampling
        assert result.values.min() >= 0


def test_shared_rays_stay_finite_under_extreme_weights() -> None:
    """Weights 600 decades apart, a light on the surface, a texel alone in its chart, faces of no area."""
    vertices, faces, points, normals = ball()
    texel = np.stack(np.divmod(np.arange(len(points)), 20), 1).astype(np.int32)
    none = np.zeros((len(points), 3), np.float32)
    chart = (np.arange(len(points)) == 7).astype(np.int32)
    atlas = Atlas(
        20, faces.astype(np.int32), np.zeros((len(faces), 3, 2), np.float32), np.arange(len(vertices), dtype=np.int32),
        vertices.astype(np.float32), texel, np.zeros(len(points), np.int32), none, chart, none,
    )  # fmt: skip
    normals = np.where(np.arange(len(points))[:, None] == 3, 0.0, normals)
    places = np.array([[0, 5.0, 0], [0, -5.0, 0], points[11], [1.0, 0, 0]])
    for sampling in ("uniform", "power", "arriving"):
        for weights in ([1e-300, 1e300, 1e-30, 1e-5], [1.0, 1.0, 1e-9, 0.0]):
            samples = Samples(1, sampling, "low_discrepancy", TexelBlocks(texel), np.random.default_rng(0))
            lights = Lights(places, np.array(weights))
            scene = light_scene(Occluders(vertices, faces), points, normals, lights, None)
            result = share_rays(scene, samples, Neighbours(atlas))
            for values in (result.values, result.cosine_visibility, result.error):
                assert np.isfinite(values).all(), sampling
                assert values.min() >= 0
            assert max(result.values.max(), result.cosine_visibility.max()) <= 1 + ROUNDING
            assert result.values[3] == result.cosine_visibility[3] == 0
