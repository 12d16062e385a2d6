"""Shadow rays against closed forms and a float64 Moeller-Trumbore tracer."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.mesh import unit_or
from pipeline.lighting.visibility import ORIGIN_OFFSET, Occluders
from tests.support.meshes.lit_meshes import crumpled_sphere, plate, random_points, sphere, together

UP = np.array([0, 1.0, 0])


def first_hit_by_hand(origins: np.ndarray, ends: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Fraction of the way to the first face between two points, infinite if none (Moeller and Trumbore 1997)."""
    way, first = ends - origins, np.full(len(origins), np.inf)
    for a, b, c in triangles:
        e1, e2 = b - a, c - a
        p = np.cross(way, e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (p @ e1)
            s = origins - a
            u = (s * p).sum(1) * inverse
            q = np.cross(s, e1)
            v, t = (way * q).sum(1) * inverse, (q @ e2) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)
        first = np.where(hit, np.minimum(first, t), first)
    return first


def test_shadow_of_a_sphere_on_a_plane_is_a_disc() -> None:
    """A light at height H over a sphere of radius r at height h: the cone of half angle asin(r / (H - h)) meets the
    plane in a disc of radius H tan(that angle)."""
    height, center, radius = 5.0, 2.0, 0.7
    occluders = Occluders(*together(plate(10, 0.0), sphere(radius, (0, center, 0))))
    disc = height * np.tan(np.arcsin(radius / (height - center)))
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (20_000, 3)) * [1, 0, 1]
    distance = np.linalg.norm(points, axis=1)
    seen, rays = occluders.visible(points, np.tile(UP, (len(points), 1)), np.array([0, height, 0]))
    assert rays == len(points)
    # The faceted sphere lies inside the true one by less than 1e-3 of its radius.
    clear = np.abs(distance - disc) > 2e-3 * disc
    np.testing.assert_array_equal(seen[clear], (distance > disc)[clear])
    assert clear.mean() > 0.99


def test_between_parallel_plates() -> None:
    """Under a plate of half side 1 at height 1, a light at height 2 leaves a square shadow of half side 2; the first
    hit from its inside lies half way."""
    occluders = Occluders(*together(plate(8, 0.0), plate(1, 1.0)))
    points = np.random.default_rng(1).uniform(-5, 5, (5000, 3)) * [1, 0, 1]
    normals, light = np.tile(UP, (len(points), 1)), np.array([0, 2.0, 0])
    inside = np.abs(points).max(1) < 2
    np.testing.assert_array_equal(occluders.visible(points, normals, light)[0], ~inside)
    hits, way = occluders.first_hits(points, normals, light), np.linalg.norm(points - light, axis=1)
    np.testing.assert_allclose(hits[inside], way[inside] / 2, rtol=1e-4)
    assert np.isinf(hits[~inside]).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_against_a_double_precision_tracer(scale: float) -> None:
    vertices, faces = crumpled_sphere()
    points, normals = random_points(vertices, faces, 4000)
    lights = unit_or(np.random.default_rng(2).normal(size=points.shape), 0.0) * 4
    offset = ORIGIN_OFFSET * np.ptp(vertices, axis=0).max() / 2
    first = first_hit_by_hand(points + offset * normals, lights, vertices[faces])
    expected = np.isinf(first) & (((lights - points) * normals).sum(1) > 0)
    occluders = Occluders(vertices * scale + 7 * scale, faces)
    seen, _ = occluders.visible(points * scale + 7 * scale, normals, lights * scale + 7 * scale)
    assert (seen == expected).mean() >= 0.9995
    assert 0.2 < expected.mean() < 0.8
    hits = occluders.first_hits(points * scale + 7 * scale, normals, lights * scale + 7 * scale)
    exact = first * np.linalg.norm(lights - points, axis=1) * scale
    both = np.isfinite(first) & np.isfinite(hits) & (((lights - points) * normals).sum(1) > 0)
    assert np.isclose(hits[both], exact[both], rtol=1e-4, atol=1e-4 * scale).mean() >= 0.999


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_convex_body_sees_exactly_what_is_above_its_horizon(scale: float) -> None:
    """No ray that starts on the surface hits the face it starts on, or its neighbours, also at grazing angles."""
    vertices, faces = sphere(scale, (3 * scale, 0, 0), 4)
    points, normals = random_points(vertices, faces, 5000)
    occluders = Occluders(vertices, faces)
    for direction in unit_or(np.random.default_rng(3).normal(size=(6, 3)), 0.0):
        light = np.array([3 * scale, 0, 0]) + 2.5 * scale * direction
        height = ((light - points) * normals).sum(1)
        seen, rays = occluders.visible(points, normals, light)
        np.testing.assert_array_equal(seen, height > 0)
        assert rays == (height > 0).sum()


def test_lights_in_awkward_places() -> None:
    vertices, faces = sphere(1.0, (0, 0, 0), 3)
    points, normals = random_points(vertices, faces, 500)
    occluders = Occluders(vertices, faces)
    # Inside the body: hidden from outside, seen by a body turned inside out.
    assert not occluders.visible(points, normals, np.zeros(3))[0].any()
    assert Occluders(vertices, faces[:, ::-1]).visible(points, -normals, np.zeros(3))[0].all()
    # On the surface, at the very point: on the horizon, so hidden; and no warning, no NaN.
    assert not occluders.visible(points, normals, points.copy())[0].any()
    # A thousand extents away.
    assert occluders.visible(points, normals, points + 1e3 * normals)[0].all()


def test_what_lies_behind_a_light_does_not_occlude_it() -> None:
    occluders = Occluders(*together(plate(1, 0.0), plate(1, 2.0)))
    point, up = np.zeros((1, 3)), UP[None]
    assert occluders.visible(point, up, np.array([0, 1.999, 0]))[0].all()
    # A light exactly on its housing: seen from the side it shines to.
    assert occluders.visible(point, up, np.array([0, 2.0, 0]))[0].all()
    assert not occluders.visible(point, up, np.array([0, 2.001, 0]))[0].any()


def test_broken_faces_change_nothing() -> None:
    vertices, faces = crumpled_sphere()
    points, normals = random_points(vertices, faces, 2000)
    light = np.array([0, 3.0, 1])
    expected, _ = Occluders(vertices, faces).visible(points, normals, light)
    broken = np.concatenate([faces, faces[:50], [[0, 0, 0], [1, 2, 1]]])
    np.testing.assert_array_equal(Occluders(vertices, broken).visible(points, normals, light)[0], expected)


def test_what_cannot_be_traced_is_refused() -> None:
    vertices, faces = crumpled_sphere()
    with pytest.raises(ValueError, match="finite"):
        Occluders(np.where(np.arange(len(vertices))[:, None] == 3, np.nan, vertices), faces)
    with pytest.raises(ValueError, match="faces"):
        Occluders(vertices, faces[:0])
