"""Rasterised layouts against counting and brute force; new layouts against what a layout must be."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from pipeline.base.errors import InputError
from pipeline.geometry.atlas import (
    chart_ids,
    rasterize_faces,
    reasons_against,
    tangent_weights,
    unwrap_faces,
    uv_areas,
)
from pipeline.geometry.mesh import area_vectors, weld_vertices

SQUARE = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)


def box() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    return np.array(mesh.vertices), np.array(mesh.faces)


def centers(texel: np.ndarray, size: int) -> np.ndarray:
    return (texel[:, ::-1] + 0.5) / size


@pytest.mark.parametrize("size", [1, 7, 64])
def test_a_square_of_two_faces_has_each_texel_once(size: int) -> None:
    table = rasterize_faces(SQUARE, size)
    expected = np.stack(np.divmod(np.arange(size**2), size), 1)
    np.testing.assert_array_equal(table.texel, expected)
    assert table.overlap == 0


def test_half_a_square_by_counting() -> None:
    """Centres with i + j + 1 <= n, the diagonal's included: n (n + 1) / 2, mirrored or not."""
    half = np.array([[[0, 0], [1, 0], [0, 1]]], np.float32)
    for uv in (half, half[:, ::-1]):
        assert len(rasterize_faces(uv, 50).face) == 50 * 51 // 2


def test_barycentrics_lead_back_to_the_texel_center() -> None:
    uv = np.random.default_rng(0).random((40, 3, 2)).astype(np.float32)
    table = rasterize_faces(uv, 33)
    found = (uv[table.face].astype(np.float64) * table.barycentric[..., None]).sum(1)
    np.testing.assert_allclose(found, centers(table.texel, 33), atol=1e-6)
    np.testing.assert_allclose(table.barycentric.sum(1), 1, atol=1e-12)
    assert table.barycentric.min() >= 0


def test_a_triangulation_leaves_no_gap_and_agrees_with_brute_force() -> None:
    rng, size = np.random.default_rng(3), 41
    # Points on texel centres too: centres then lie exactly on edges and corners.
    points = np.concatenate(
        [[[0, 0], [1, 0], [0, 1], [1, 1]], rng.random((60, 2)), (rng.integers(41, size=(20, 2)) + 0.5) / 41]
    )
    points = points.astype(np.float32)
    triangulation = Delaunay(points.astype(np.float64))
    uv = points[triangulation.simplices]
    table = rasterize_faces(uv, size)
    assert len(table.face) == size**2
    assert table.overlap == 0
    at = centers(table.texel, size)
    system = np.concatenate([uv[table.face].transpose(0, 2, 1), np.ones((len(at), 1, 3))], 1).astype(np.float64)
    solved = np.linalg.solve(system, np.concatenate([at, np.ones((len(at), 1))], 1)[..., None])[..., 0]
    np.testing.assert_allclose(table.barycentric, solved, atol=1e-5)


def test_overlap_is_the_share_of_texels_in_several_faces() -> None:
    quarter = SQUARE / 2
    np.testing.assert_allclose(rasterize_faces(np.concatenate([SQUARE, quarter]), 64).overlap, 0.25, atol=0.03)
    assert rasterize_faces(np.concatenate([SQUARE, SQUARE]), 65).overlap > 0.98


def test_degenerate_and_outlying_faces_get_no_texel() -> None:
    line = np.array([[[0, 0], [1, 1], [0.5, 0.5]], [[0.5, 0.5]] * 3], np.float32)
    assert not len(rasterize_faces(line, 64).face)
    assert not len(rasterize_faces(SQUARE + 2, 64).face)


def test_template_coordinates_are_judged() -> None:
    vertices = np.array([[0, 0, 0], [1.0, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces, uv = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 0], [1.0, 0], [1, 1], [0, 1]])
    assert reasons_against(vertices, faces, uv, 32) == []
    assert reasons_against(vertices, faces, uv + 5e-5, 32) == []
    assert "no texture" in reasons_against(vertices, faces, None, 32)[0]
    assert "outside" in reasons_against(vertices, faces, uv * 2, 32)[0]
    assert "finite" in reasons_against(vertices, faces, uv * np.nan, 32)[0]
    assert "no area" in reasons_against(vertices, faces, uv * [1, 0], 32)[0]
    assert "several faces" in reasons_against(vertices, np.concatenate([faces, faces]), uv, 32)[0]


def test_new_layout_of_a_box() -> None:
    vertices, faces = box()
    uv = unwrap_faces(vertices, faces, 64, 2)
    table = rasterize_faces(uv, 64)
    assert table.overlap == 0
    assert uv.min() >= 0 and uv.max() <= 1
    assert len(np.unique(chart_ids(faces, uv, weld_vertices(vertices, faces)))) == 6
    # Flat sides: one scale for all, to the half texel that xatlas rounds charts to, and no shear.
    scale = np.abs(uv_areas(uv)) / np.linalg.norm(area_vectors(vertices, faces), axis=1)
    assert scale.max() / scale.min() < 1.2
    assert len(table.face) > 0.4 * 64**2
    np.testing.assert_array_equal(uv, unwrap_faces(vertices, faces, 64, 2))
    reasons = reasons_against(
        uv=uv.reshape(-1, 2), vertices=vertices[faces].reshape(-1, 3), faces=np.arange(36).reshape(-1, 3), size=64
    )
    assert reasons == []


def test_layout_with_broken_faces_and_on_a_tiny_map() -> None:
    vertices, faces = box()
    broken = np.concatenate([faces, [[0, 0, 0], [1, 2, 1]], faces[:1]])
    uv = unwrap_faces(vertices, broken, 32, 1)
    assert uv.shape == (15, 3, 2)
    assert np.isfinite(uv).all()
    with pytest.raises(InputError, match="larger"):
        unwrap_faces(
            *(np.array(a) for a in (trimesh.creation.icosphere(4).vertices, trimesh.creation.icosphere(4).faces)), 2, 0
        )
    with pytest.raises(InputError, match="area"):
        unwrap_faces(vertices * 0, faces, 64, 2)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_tangent_weights_give_the_u_derivative(mirror: float) -> None:
    rng = np.random.default_rng(5)
    dp_du, dp_dv, origin = rng.normal(size=(3, 3))
    uv = rng.random((30, 3, 2)).astype(np.float32) * np.array([1, mirror], np.float32)
    corners = origin + uv[..., :1] * dp_du + uv[..., 1:] * dp_dv
    tangent = (corners * tangent_weights(uv)[..., None]).sum(1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    np.testing.assert_allclose(tangent, np.tile(dp_du / np.linalg.norm(dp_du), (30, 1)), atol=1e-4)


def test_tangent_weights_without_area_are_finite() -> None:
    weights = tangent_weights(np.zeros((1, 3, 2), np.float32))
    np.testing.assert_array_equal(weights, [[-1, 1, 0]])
    assert np.isfinite(tangent_weights(np.array([[[0, 0], [1, 1], [2, 2]]], np.float32))).all()


def test_charts_are_separated_in_the_map_not_in_space() -> None:
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    weld = np.arange(4)
    joined, apart = (
        chart_ids(faces, SQUARE, weld),
        chart_ids(faces, SQUARE + np.array([[[0.0]], [[0.5]]], np.float32), weld),
    )
    assert joined[0] == joined[1]
    assert apart[0] != apart[1]
