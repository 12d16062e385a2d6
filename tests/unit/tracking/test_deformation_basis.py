"""Waves of a sphere against its spherical harmonics; rigid pieces, seams and degenerate triangles."""

import numpy as np
import pytest
import trimesh

from pipeline.geometry.mesh import weld_vertices
from pipeline.tracking.deformation_basis import deformation_basis, laplacian, rigid_parts

RADIUS_M = 0.1
OFFSET_M = 0.004


@pytest.fixture(scope="module")
def sphere():
    mesh = trimesh.creation.icosphere(4, RADIUS_M)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


@pytest.fixture(scope="module")
def head_with_eyes(sphere):
    """A sphere and two small ones, one of which is cut open along a seam: its vertices are there twice."""
    vertices, faces = sphere
    small = trimesh.creation.icosphere(2, 0.012)
    eye, eye_faces = np.asarray(small.vertices, np.float64), np.asarray(small.faces, np.int64)
    left, right = (eye + np.array([x, 0, 0.1]) for x in (0.03, -0.03))
    cut_faces = eye_faces.copy()
    upper = eye[eye_faces].mean(1)[:, 1] > 0
    cut_faces[~upper] += len(eye)
    parts = [faces, len(vertices) + eye_faces, len(vertices) + len(eye) + cut_faces]
    return np.concatenate([vertices, left, right, right]), np.concatenate(parts)


def test_modes_of_a_sphere_are_its_spherical_harmonics(sphere):
    """Eigenvalues l (l + 1) / r^2, each 2 l + 1 times; the prior's variance falls with them as the docstring says."""
    length = 0.03
    basis = deformation_basis(*sphere, 16, OFFSET_M, length)
    degree = np.repeat(np.arange(4), 2 * np.arange(4) + 1)
    expected = (1 + length**2 * degree * (degree + 1) / RADIUS_M**2) ** -2.0
    # Edges of 7 mm on waves of 100 mm and more: a percent.
    np.testing.assert_allclose(basis.sigma_m**2 / basis.sigma_m[0] ** 2, expected, rtol=0.02)
    assert np.abs(basis.modes[:, 0] / basis.modes[0, 0] - 1).max() < 1e-6
    # The next three span the coordinates.
    linear = basis.modes[:, 1:4]
    fitted = linear @ np.linalg.lstsq(linear, sphere[0], rcond=None)[0]
    np.testing.assert_allclose(fitted, sphere[0], atol=1e-3 * RADIUS_M)


def test_expected_offset_is_the_typical_one(sphere):
    basis = deformation_basis(*sphere, 40, OFFSET_M, 0.03)
    _, area = laplacian(*sphere)
    weight = area / area.sum()
    np.testing.assert_allclose(basis.modes.T @ (weight[:, None] * basis.modes), np.eye(40), atol=1e-8)
    assert np.sqrt((basis.sigma_m**2).sum()) == pytest.approx(OFFSET_M)


def test_small_pieces_are_rigid_and_seams_are_closed(head_with_eyes):
    vertices, faces = head_with_eyes
    part = rigid_parts(vertices, faces, weld_vertices(vertices, faces))
    count = len(vertices) - 3 * 162
    assert (part[:count] == -1).all()
    assert (part[count : count + 162] == 0).all() and (part[count + 162 :] == 1).all()
    basis = deformation_basis(vertices, faces, 10, OFFSET_M, 0.03)
    assert np.abs(basis.modes[count:]).max() == 0
    # The middle counts every place once, however often a seam repeats it.
    np.testing.assert_allclose(basis.centers, [[0.03, 0, 0.1], [-0.03, 0, 0.1]], atol=1e-9)


def test_vertices_in_one_place_move_alike(sphere):
    vertices, faces = sphere
    cut = np.concatenate([vertices, vertices])
    upper = vertices[faces].mean(1)[:, 1] > 0
    cut_faces = np.where(upper[:, None], faces, faces + len(vertices))
    modes = deformation_basis(cut, cut_faces, 12, OFFSET_M, 0.03).modes
    used = np.intersect1d(faces[upper], faces[~upper])
    assert len(used) > 50
    np.testing.assert_array_equal(modes[used], modes[used + len(vertices)])


def test_degenerate_triangles_and_lonely_vertices_stay_finite(sphere):
    vertices, faces = sphere
    vertices = np.concatenate([vertices, [[0.3, 0.0, 0.0]]])
    faces = np.concatenate([faces, [[0, 1, 1], [5, 5, 5], [7, 8, 7]]])
    basis = deformation_basis(vertices, faces, 12, OFFSET_M, 0.03)
    assert np.isfinite(basis.modes).all() and (basis.sigma_m > 0).all()
    plain = deformation_basis(*sphere, 4, OFFSET_M, 0.03).modes
    # The constant wave of the sphere is still among the slowest.
    sphere_part = basis.modes[:-1, :4]
    fitted = sphere_part @ np.linalg.lstsq(sphere_part, plain[:, 0], rcond=None)[0]
    np.testing.assert_allclose(fitted, plain[:, 0], atol=1e-3)


def test_no_modes_is_a_rigid_template(sphere):
    basis = deformation_basis(*sphere, 0, OFFSET_M, 0.03)
    assert basis.modes.shape == (len(sphere[0]), 0) and len(basis.sigma_m) == 0
