"""Texel points and frames against planes written down by hand, rotations, and broken triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_arrays
from pipeline.geometry.atlas import rasterize_faces, tangent_weights
from pipeline.geometry.texel_surface import surface_frames, texel_surface
from pipeline.geometry.texels import Atlas, any_tangent, read_atlas, texel_frames, write_atlas

SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
SQUARE_UV = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32)


def atlas_of(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, size: int = 16) -> Atlas:
    """An atlas of face-corner coordinates, nothing welded."""
    table = rasterize_faces(uv, size)
    index, real = np.int32, np.float32
    return Atlas(
        size, faces.astype(index), uv.astype(real), np.arange(len(vertices), dtype=index), vertices.astype(real),
        table.texel.astype(index), table.face.astype(index), table.barycentric.astype(real),
        np.zeros(len(table.face), index), tangent_weights(uv)[table.face].astype(real),
    )  # fmt: skip


def bent_sphere(mirrored: bool = False) -> tuple[Atlas, np.ndarray]:
    """A sphere under random, partly overlapping coordinates: half of its faces mirrored, or the other half."""
    mesh = trimesh.creation.icosphere(2)
    rng = np.random.default_rng(1)
    uv = rng.random((len(mesh.faces), 3, 2)).astype(np.float32)
    if mirrored:
        uv[..., 0] = 1 - uv[..., 0]
    vertices = np.array(mesh.vertices) * [1, 2, 0.5] + rng.normal(scale=0.05, size=mesh.vertices.shape)
    return atlas_of(vertices, np.array(mesh.faces), uv), vertices


def assert_rotations(frames: np.ndarray, tolerance: float = 1e-6) -> None:
    assert np.isfinite(frames).all()
    np.testing.assert_allclose(
        np.swapaxes(frames, -1, -2) @ frames, np.broadcast_to(np.eye(3), frames.shape), atol=tolerance
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=3 * tolerance)


def test_frame_of_a_plane() -> None:
    """u runs along +x and v (down) along -y: t = x, n = z, b = y; texel (0, 0) lies at the top left."""
    vertices = np.array([[-1, 1, 3], [-1, -1, 3], [1, -1, 3], [1, 1, 3]], np.float64)
    atlas = atlas_of(vertices, SQUARE_FACES, SQUARE_UV[SQUARE_FACES], 4)
    points, frames = texel_frames(atlas, vertices)
    np.testing.assert_allclose(frames, np.broadcast_to(np.eye(3), (16, 3, 3)), atol=1e-7)
    row, column = atlas.texel.T
    expected = np.stack([-1 + (column + 0.5) / 2, 1 - (row + 0.5) / 2, np.full(16, 3.0)], 1)
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_frame_of_a_mirrored_plane_is_a_rotation() -> None:
    vertices = np.array([[-1, 1, 3], [-1, -1, 3], [1, -1, 3], [1, 1, 3]], np.float64)
    uv = (SQUARE_UV * np.array([-1, 1]) + [1, 0]).astype(np.float32)
    _, frames = texel_frames(atlas_of(vertices, SQUARE_FACES, uv[SQUARE_FACES]), vertices)
    np.testing.assert_allclose(frames, np.broadcast_to(np.diag([-1.0, -1, 1]), frames.shape), atol=1e-7)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_frames_are_rotations(mirrored: bool, scale: float) -> None:
    atlas, vertices = bent_sphere(mirrored)
    points, frames = texel_frames(atlas, scale * vertices)
    assert_rotations(frames)
    corners = vertices[atlas.faces[atlas.face]]
    np.testing.assert_allclose(points, scale * np.einsum("tc,tcx->tx", atlas.barycentric, corners), rtol=1e-6)


def test_normals_are_interpolated_smoothly() -> None:
    """On a sphere of 1,280 faces, 8 degrees apart, the smooth normal stays within a degree of the radius."""
    mesh = trimesh.creation.icosphere(3)
    uv = np.random.default_rng(1).random((len(mesh.faces), 3, 2)).astype(np.float32)
    atlas = atlas_of(np.array(mesh.vertices), np.array(mesh.faces), uv, 64)
    points, frames = texel_frames(atlas, np.array(mesh.vertices))
    radial = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert (radial * frames[..., 2]).sum(1).min() > np.cos(np.radians(1.0))


def test_frames_turn_with_the_mesh() -> None:
    atlas, vertices = bent_sphere()
    rotation = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.7, 0.4]))[:3, :3]
    points, frames = texel_frames(atlas, vertices)
    moved_points, moved_frames = texel_frames(atlas, vertices @ rotation.T + [1, 2, 3])
    np.testing.assert_allclose(moved_points, points @ rotation.T + [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(moved_frames, rotation @ frames, atol=1e-9)


def test_torch_and_batches_agree_with_numpy() -> None:
    atlas, vertices = bent_sphere()
    batch = np.stack([vertices, vertices[:, ::-1] + 1])
    points, frames = texel_frames(atlas, batch)
    for one, p, f in zip(batch, points, frames, strict=True):
        again = texel_frames(atlas, one)
        np.testing.assert_allclose(again[0], p, atol=1e-12)
        np.testing.assert_allclose(again[1], f, atol=1e-12)
    tensor_points, tensor_frames = texel_frames(atlas.to_torch(), torch.tensor(batch, dtype=torch.float32))
    assert tensor_frames.dtype == torch.float32
    np.testing.assert_allclose(tensor_points.numpy(), points, atol=1e-6)
    np.testing.assert_allclose(tensor_frames.numpy(), frames, atol=2e-4)
    assert_rotations(tensor_frames.numpy(), 1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_collapsed_meshes_keep_finite_frames(dtype: type) -> None:
    atlas, vertices = bent_sphere()
    needle = vertices * [1, 0, 0]
    for broken in (np.zeros_like(vertices), needle, vertices * 1e-30, vertices.round(0)):
        points, frames = texel_frames(atlas, broken.astype(dtype))
        assert np.isfinite(points).all()
        assert_rotations(frames)
        _, tensors = texel_frames(atlas.to_torch(), torch.tensor(broken, dtype=torch.float32))
        assert_rotations(tensors.numpy())


def test_tangent_along_the_normal_falls_back() -> None:
    """A tent whose normals are made smooth until a face's u direction is the normal itself."""
    vertices = np.array([[0, 0, 0], [0, 0, 1.0], [0, 1, 0], [0, 0, 0], [100.0, 0, 0], [0, 100, 0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    uv = np.array([[[0, 0], [0.4, 0], [0, 0.4]], [[0.5, 0.5], [1, 0.5], [0.5, 1]]], np.float32)
    atlas = atlas_of(vertices, faces, uv)
    welded = Atlas(**{**vars(atlas), "weld": np.array([0, 0, 0, 0, 0, 0], np.int32)})
    assert_rotations(texel_frames(welded, vertices)[1])
    assert_rotations(texel_frames(welded.to_torch(), torch.tensor(vertices, dtype=torch.float32))[1].numpy())


def test_any_tangent_at_the_poles() -> None:
    n = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [0.6, 0, -0.8], [1e-20, 0, -1]])
    t = any_tangent(n)
    np.testing.assert_allclose(np.linalg.norm(t, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose((t * n).sum(1), 0, atol=1e-12)


def test_maps() -> None:
    atlas, _ = bent_sphere()
    values = np.random.default_rng(0).random((2, atlas.texel_count))
    image = atlas.to_map(values, -1.0)
    np.testing.assert_array_equal(atlas.from_map(image), values)
    assert (image == -1).sum() == 2 * (atlas.size**2 - atlas.texel_count)
    tensor = torch.tensor(values)
    torch.testing.assert_close(atlas.to_torch().from_map(atlas.to_torch().to_map(tensor)), tensor)


def test_file_round_trip_and_complaints(tmp_path: Path) -> None:
    atlas, _ = bent_sphere()
    path = tmp_path / "atlas.safetensors"
    write_atlas(path, atlas)
    again = read_atlas(path)
    assert again.size == atlas.size
    for name in ("faces", "uv", "weld", "rest_vertices", "texel", "face", "barycentric", "chart", "tangent_weights"):
        np.testing.assert_array_equal(getattr(again, name), getattr(atlas, name))
        assert getattr(again, name).dtype == getattr(atlas, name).dtype
    arrays = read_arrays(path)
    for broken, message in [
        ({k: v for k, v in arrays.items() if k != "weld"}, "weld"),
        ({**arrays, "uv": arrays["uv"][:-1]}, "uv: expected shape"),
        ({**arrays, "face": arrays["face"] + 10_000}, "face: expected indices below"),
    ]:
        write_arrays(path, broken)
        with pytest.raises(InputError, match=message):
            read_atlas(path)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_surface_is_that_of_the_frames(scale: float) -> None:
    """Its kernel against NumPy's broadcasting, on one mesh with a face without area and one whose normals cancel."""
    atlas, vertices = bent_sphere()
    flat = atlas.faces.copy()
    flat[7] = flat[7, [0, 0, 1]]
    atlas = Atlas(**{**vars(atlas), "faces": flat})
    vertices = vertices * scale
    points, normals, face_normals = texel_surface(atlas, vertices)
    expected, frames = texel_frames(atlas, vertices)
    np.testing.assert_allclose(points, expected, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(normals, frames[..., 2], atol=1e-12)
    edges = vertices[flat[:, 1:]] - vertices[flat[:, :1]]
    across = np.cross(edges[:, 0], edges[:, 1]) / scale**2
    length = np.linalg.norm(across, axis=1, keepdims=True)
    wanted = np.divide(across, length, out=np.zeros_like(across), where=length > 0)[atlas.face]
    np.testing.assert_allclose(face_normals, wanted, atol=1e-9)
    assert (face_normals[atlas.face == 7] == 0).all()
    assert (atlas.face == 7).any()


@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_compiled_frames_are_those_of_the_twin(scale):
    """Faces without area and tangents along the normal included; the twin runs in float64 too."""
    atlas, vertices = bent_sphere()
    flat, weights = atlas.faces.copy(), atlas.tangent_weights.copy()
    flat[7] = flat[7, [0, 0, 1]]
    weights[::5] = 0
    atlas = Atlas(**{**vars(atlas), "faces": flat, "tangent_weights": weights})
    points, frames = surface_frames(atlas, scale * vertices)
    expected_points, expected = texel_frames(atlas, scale * vertices)
    np.testing.assert_allclose(points, expected_points, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(frames, expected, atol=1e-11)
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-12)
