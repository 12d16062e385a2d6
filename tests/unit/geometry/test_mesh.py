"""Normals against spheres, welding against planted seams, volumes against boxes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from pipeline.geometry.mesh import area_vectors, is_closed, signed_volume, vertex_normals, weld_vertices


def sphere(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)


def split_all_corners(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every face with three vertices of its own: a seam along every edge."""
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def test_normals_of_a_sphere_are_radial() -> None:
    vertices, faces = sphere(4)
    normals = vertex_normals(vertices * 2 + 5, faces, np.arange(len(vertices)))
    # One ring of an icosphere is nearly, not exactly, symmetric: its mean normal is off by well under a degree.
    assert (normals * vertices).sum(1).min() > np.cos(np.radians(0.5))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)


def test_area_weights() -> None:
    """At the corner where a 3 m2 and a 1 m2 face meet, the normal is (3 z + 1 x) / sqrt(10)."""
    vertices = np.array([[0, 0, 0], [2.0, 0, 0], [0, 3.0, 0], [0, 0, -2 / 3]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    areas = area_vectors(vertices, faces)
    np.testing.assert_allclose(areas, [[0, 0, 3], [-1, 0, 0]], atol=1e-15)
    normals = vertex_normals(vertices, faces, np.arange(4))
    np.testing.assert_allclose(normals[0], np.array([-1, 0, 3]) / np.sqrt(10), atol=1e-15)


def test_normals_do_not_see_seams() -> None:
    vertices, faces = sphere()
    whole = vertex_normals(vertices, faces, np.arange(len(vertices)))
    apart, corners = split_all_corners(vertices, faces)
    weld = weld_vertices(apart, corners)
    assert len(np.unique(weld)) == len(vertices)
    np.testing.assert_allclose(vertex_normals(apart, corners, weld), whole[faces].reshape(-1, 3), atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_welding_at_any_scale(scale: float, dtype: type) -> None:
    vertices, faces = split_all_corners(*sphere(2))
    # Noise of 1e-8 of the extent, as from a float32 file; the closest true neighbours are 0.1 of it apart.
    noise = np.random.default_rng(1).normal(size=vertices.shape) * 1e-8
    weld = weld_vertices(((vertices + noise) * scale).astype(dtype), faces)
    assert len(np.unique(weld)) == 162
    assert (weld <= np.arange(len(weld))).all()
    np.testing.assert_array_equal(weld[weld], weld)


def test_two_sides_of_a_sheet_stay_apart() -> None:
    square = np.array([[0, 0, 0], [1.0, 0, 0], [1, 1, 0], [0, 1, 0]])
    front = np.array([[0, 1, 2], [0, 2, 3]])
    vertices, faces = np.concatenate([square, square]), np.concatenate([front, front[:, ::-1] + 4])
    normals = vertex_normals(vertices, faces, weld_vertices(vertices, faces))
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 4 + [[0, 0, -1]] * 4, atol=1e-15)


def test_degenerate_faces_contribute_nothing() -> None:
    vertices, faces = sphere(2)
    weld = np.arange(len(vertices))
    degenerate = np.array([[0, 0, 0], [1, 2, 1], [5, 5, 7]])
    expected = vertex_normals(vertices, faces, weld)
    np.testing.assert_array_equal(vertex_normals(vertices, np.concatenate([faces, degenerate]), weld), expected)
    lonely = np.concatenate([vertices, [[9.0, 9, 9]]])
    np.testing.assert_array_equal(vertex_normals(lonely, faces, np.arange(len(lonely)))[-1], 0)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_torch_agrees_with_numpy_batched_and_scaled(scale: float) -> None:
    vertices, faces = sphere(2)
    rng, weld = np.random.default_rng(2), np.arange(len(vertices))
    posed = scale * (vertices + rng.normal(scale=0.05, size=(2, 3, *vertices.shape)))
    exact = np.stack([[vertex_normals(one, faces, weld) for one in row] for row in posed])
    np.testing.assert_allclose(vertex_normals(posed, faces, weld), exact, atol=1e-14)
    tensors = torch.tensor(posed, dtype=torch.float32), torch.tensor(faces), torch.tensor(weld)
    np.testing.assert_allclose(vertex_normals(*tensors).numpy(), exact, atol=2e-5)


def test_volume_and_closedness() -> None:
    box = trimesh.creation.box((2.0, 3.0, 4.0))
    vertices, faces = split_all_corners(np.array(box.vertices) + 100, np.array(box.faces))
    weld = weld_vertices(vertices, faces)
    assert is_closed(faces, weld)
    assert signed_volume(vertices, faces) == pytest.approx(24)
    assert signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-24)
    assert not is_closed(faces[1:], weld)
    assert not is_closed(np.concatenate([faces[1:], faces[:1, ::-1]]), weld)
