"""Meshes of solids whose surface is known in closed form, and the figure's own mesh."""

import numpy as np
import pytest
import trimesh

from pipeline.synthesis.implicit_surface import even_out, neighbor_average, smooth_union, surface_nets
from pipeline.synthesis.skeleton import RoundCone, human_solids

SPACING_M = 0.05


def sphere(points):
    return np.linalg.norm(points - [0.1, 0.2, -0.1], axis=1) - 0.4


@pytest.fixture(scope="module")
def sphere_mesh():
    vertices, faces = surface_nets(sphere, np.full(3, -0.6), np.full(3, 0.8), SPACING_M)
    return even_out(vertices, faces, sphere), faces


def test_sphere_is_closed_and_faces_outward(sphere_mesh):
    mesh = trimesh.Trimesh(*sphere_mesh, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.euler_number == 2
    # A chord mesh of edge h underestimates the volume by about (h / r)^2 / 4.
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=(SPACING_M / 0.4) ** 2)
    assert mesh.volume > 0


def test_vertices_end_on_the_surface(sphere_mesh):
    # Newton's method doubles digits each step; two steps from half an edge away leave below a micrometre.
    assert np.abs(sphere(sphere_mesh[0])).max() < 1e-6


def test_triangles_are_well_shaped(sphere_mesh):
    angles = np.degrees(trimesh.Trimesh(*sphere_mesh, process=False).face_angles.min(axis=1))
    assert np.percentile(angles, 5) > 25


def test_neighbor_average_of_a_tetrahedron():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    values = np.array([0.0, 3.0, 6.0, 9.0])
    np.testing.assert_allclose(neighbor_average(faces, 4) @ values, [6, 5, 4, 3])


def test_union_of_one_solid_is_its_distance():
    capsule = RoundCone("pelvis", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.1, 0.1)
    points = np.array([[0.3, 0.5, 0.0], [0.0, 1.4, 0.0], [0.0, 0.5, 0.05]])
    np.testing.assert_allclose(smooth_union(points, [capsule]), [0.2, 0.3, -0.05], atol=1e-12)


@pytest.mark.parametrize("spacing", [0.032, 0.04])
def test_figure_is_one_closed_surface(spacing):
    solids = human_solids()

    def field(points):
        return smooth_union(points, solids)

    mesh = trimesh.Trimesh(*surface_nets(field, np.array([-0.9, -0.1, -0.3]), np.array([0.9, 1.9, 0.35]), spacing))
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert 1500 < len(mesh.vertices) < 4000
    assert 0.05 < mesh.volume < 0.1  # a person's volume, cubic metres
