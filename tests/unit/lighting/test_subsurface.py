"""Irradiance spread below a surface, against sums over all pairs of samples and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.integrate import quad
from scipy.special import erf

from pipeline.lighting import subsurface
from pipeline.lighting.subsurface import REACH, SubsurfaceSpread, SurfaceSamples

PATCHES = 0.045
"""How far a sum over patches is off that over samples, of the largest. Their variance is accounted for; third moments
are not: at most 0.096 h^3 for a patch of length h, which is one deviation here, times the largest slope of that order,
1.38 of the peak, over 3!: 0.022 along each of two directions."""
WIDER = 13 / 12
"""Variance of a Gaussian and a patch of one deviation together, over that of the Gaussian: the reach then cuts off
exp(-4.5 / WIDER)."""


def sphere(radius=1.0):
    mesh = trimesh.creation.icosphere(4, radius)
    return SurfaceSamples(mesh.triangles_center, mesh.face_normals, mesh.area_faces)


def plane(side=61, spacing=0.1):
    at = (np.arange(side) - side // 2) * spacing
    points = np.stack(np.meshgrid(at, at), -1).reshape(-1, 2)
    points = np.column_stack([points, np.zeros(len(points))])
    return SurfaceSamples(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), np.full(len(points), spacing**2))


def spread(surface, deviation, irradiance, where=None):
    """By one Gaussian."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subsurface, "SPREADS", (deviation / float(np.sqrt(np.median(surface.areas))),))
        layer = SubsurfaceSpread(surface, where)
    with torch.no_grad():
        layer.weight.fill_(1.0)
        return layer(torch.as_tensor(irradiance, dtype=torch.float32)).numpy().astype(np.float64)


def twin(surface, deviation, irradiance):
    """Sum over all pairs, in float64."""
    distance = np.linalg.norm(surface.points[:, None] - surface.points, axis=2)
    kernel = np.exp(-0.5 * (distance / deviation) ** 2) / (2 * np.pi * deviation**2) * surface.areas
    return (kernel * (distance <= REACH * deviation)) @ irradiance


@pytest.mark.parametrize("deviation", [0.2, 0.4, 0.8])
def test_spread_is_that_of_all_pairs(deviation):
    surface = sphere()
    lit = np.maximum(surface.normals @ [0.6, 0.0, 0.8], 0)[:, None] * [1.0, 0.5, 0.25]
    expected = twin(surface, deviation, lit)
    assert expected.max() > 0.3
    np.testing.assert_allclose(spread(surface, deviation, lit), expected, atol=PATCHES * expected.max())


@pytest.mark.parametrize("deviation", [0.2, 0.4])
def test_evenly_lit_plane_stays_as_bright(deviation):
    surface = plane()
    inside = np.abs(surface.points[:, :2]).max(1) < 3.0 - REACH * deviation - deviation
    assert inside.sum() > 100
    found = spread(surface, deviation, np.ones((len(surface.points), 3)))[inside]
    beyond = np.exp(-(REACH**2) / 2 / WIDER)
    np.testing.assert_allclose(found.mean(), 1 - beyond, atol=beyond / 2)
    np.testing.assert_allclose(found, 1 - beyond, atol=PATCHES)


def test_edge_of_light_becomes_an_error_function():
    """A half-plane lit: its edge, spread by a Gaussian, is an error function."""
    surface, deviation = plane(), 0.4
    x = surface.points[:, 0]
    found = spread(surface, deviation, np.repeat((x > 0.05)[:, None], 3, 1).astype(float))[:, 0]
    inside = np.abs(surface.points[:, :2]).max(1) < 3.0 - (REACH + 1) * deviation
    expected = 0.5 * (1 + erf((x - 0.1) / deviation / np.sqrt(2)))
    np.testing.assert_allclose(found[inside], expected[inside], atol=2 * PATCHES)


def test_evenly_lit_sphere_is_as_bright_as_its_integral_says():
    """The integral of a Gaussian over a sphere is known: dA = 2 pi d dd at the straight distance d."""
    surface, deviation = sphere(), 0.5
    inner = quad(lambda d: d * np.exp(-0.5 * d**2 / deviation**2), 0, REACH * deviation)[0] / deviation**2
    found = spread(surface, deviation, np.ones((len(surface.points), 1)))
    np.testing.assert_allclose(found.mean(), inner, rtol=PATCHES)


def test_spread_is_linear_in_light_and_starts_at_nothing():
    surface = sphere()
    layer = SubsurfaceSpread(surface)
    light = torch.rand(len(surface.points), 3)
    assert not layer(light).any()
    with torch.no_grad():
        layer.weight.copy_(torch.rand(5, 3) - 0.3)
        torch.testing.assert_close(layer(2 * light), 2 * layer(light))


def test_slopes_reach_the_profile_and_not_the_light():
    surface = sphere()
    layer, light = SubsurfaceSpread(surface), torch.rand(len(surface.points), 3)
    light.requires_grad_(True)
    layer(light).sum().backward()
    assert light.grad is None and layer.weight.grad.isfinite().all() and (layer.weight.grad > 0).all()


def test_light_enters_and_leaves_where_it_is_let():
    surface = sphere()
    where = np.flatnonzero(surface.points[:, 2] > 0)
    part = SurfaceSamples(surface.points[where], surface.normals[where], surface.areas[where])
    light = np.random.default_rng(0).random((len(surface.points), 3))
    found = spread(surface, 0.4, light, where)
    assert not np.delete(found, where, 0).any()
    np.testing.assert_array_equal(found[where], spread(part, 0.4, light[where]))


def test_both_sides_of_a_thin_sheet_have_patches_of_their_own():
    front, behind = plane(31), plane(31)
    sheet = SurfaceSamples(
        np.concatenate([front.points, behind.points - [0, 0, 0.02]]),
        np.concatenate([front.normals, -behind.normals]), np.concatenate([front.areas, behind.areas]),
    )  # fmt: skip
    _, means = sheet.patches(0.4)
    lit = np.repeat([1.0, 0.0], len(front.points))
    assert set((means @ lit).round(12)) == {0.0, 1.0}


@pytest.mark.parametrize("scale", [1e-3, 1e2])
def test_size_of_the_subject_does_not_matter(scale):
    surface = sphere()
    other = SurfaceSamples(surface.points * scale, surface.normals, surface.areas * scale**2)
    light = np.random.default_rng(1).random((len(surface.points), 3))
    np.testing.assert_allclose(spread(other, 0.4 * scale, light), spread(surface, 0.4, light), rtol=0.02, atol=0.02)


def test_samples_without_area_are_harmless():
    surface = sphere()
    areas = surface.areas.copy()
    areas[::3] = 0
    empty = SurfaceSamples(surface.points, surface.normals, areas)
    found = spread(empty, 0.1, np.ones((len(areas), 3)))
    assert np.isfinite(found).all() and found.max() > 0.3
    nothing = SubsurfaceSpread(SurfaceSamples(surface.points, surface.normals, 0 * areas))
    with torch.no_grad():
        nothing.weight.fill_(1.0)
        assert not nothing(torch.ones(len(areas), 3)).any()


def test_surface_in_one_point_is_as_bright_as_it_is_lit_once():
    """All samples in one place: finite, and no brighter than their area makes them."""
    one = SurfaceSamples(np.zeros((9, 3)), np.tile([0.0, 0.0, 1.0], (9, 1)), np.full(9, 0.01))
    found = spread(one, 0.2, np.ones((9, 3)))
    np.testing.assert_allclose(found, 9 * 0.01 / (2 * np.pi * 0.2**2), rtol=1e-6)
