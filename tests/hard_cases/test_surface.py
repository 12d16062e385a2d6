"""Meshes and maps with broken triangles: degenerate, mirrored, doubled, folded onto each other, and seams."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch

from pipeline.geometry.atlas import rasterize_faces, tangent_weights
from pipeline.geometry.mesh import area_vectors, unit_or, vertex_normals, weld_vertices
from pipeline.geometry.texels import Atlas, any_tangent, texel_frames
from tests.support.naive.surfaces import naive_normal
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 1e-6
EXACT = 1e-14

SQUARE = np.array([[-1.0, 1, 3], [-1, -1, 3], [1, -1, 3], [1, 1, 3]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
SQUARE_UV = np.array([[0.0, 0], [0, 1], [1, 1], [1, 0]])
"""u runs along +x, and v, pointing down, along -y."""


def atlas_of(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, size: int = 8) -> Atlas:
    """An atlas of coordinates per face corner."""
    table, index, real = rasterize_faces(uv.astype(np.float32), size), np.int32, np.float32
    return Atlas(
        size, faces.astype(index), uv.astype(real), np.arange(len(vertices), dtype=index), vertices.astype(real),
        table.texel.astype(index), table.face.astype(index), table.barycentric.astype(real),
        np.zeros(len(table.face), index), tangent_weights(uv.astype(real))[table.face].astype(real),
    )  # fmt: skip


def frames_and_slope(atlas: Atlas, vertices: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points, frames, and the derivative of a weighted sum of the frames by the vertices, float32."""
    at = torch.tensor(vertices, dtype=torch.float32, requires_grad=True)
    points, frames = texel_frames(atlas.to_torch(), at)
    weight = torch.linspace(-1, 1, 9).reshape(3, 3)
    (slope,) = torch.autograd.grad((frames * weight).sum() / len(frames), at)
    return points.detach(), frames.detach(), slope


def differences(atlas: Atlas, vertices: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """The same derivative by central differences of the float64 frames."""
    weight, slope = np.linspace(-1, 1, 9).reshape(3, 3), np.zeros_like(vertices)
    for k in np.ndindex(*vertices.shape):
        ends = []
        for sign in (1, -1):
            moved = vertices.astype(np.float64).copy()
            moved[k] += sign * step
            ends.append((texel_frames(atlas, moved)[1] * weight).sum() / atlas.texel_count)
        slope[k] = (ends[0] - ends[1]) / (2 * step)
    return slope


def textbook_frame(vertices: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """dP/du and dP/dv from the inverse of the map's edges, and their cross product."""
    edges, steps = vertices[1:] - vertices[:1], uv[1:] - uv[:1]
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = steps[0, 0] * steps[1, 1] - steps[0, 1] * steps[1, 0]
        tangent = (steps[1, 1] * edges[0] - steps[0, 1] * edges[1]) / determinant
        bitangent = (steps[0, 0] * edges[1] - steps[1, 0] * edges[0]) / determinant
        normal = np.cross(edges[0], edges[1])
        return np.stack([v / np.linalg.norm(v) for v in (tangent, bitangent, normal)], 1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_plane_whose_texture_is_mirrored(case: HardCase, mirrored: bool) -> None:
    """Frames stay rotations: t along u and n off the surface, b wherever that leaves it."""
    uv = SQUARE_UV * [-1, 1] + [1, 0] if mirrored else SQUARE_UV
    atlas = atlas_of(SQUARE, FACES, uv[FACES])
    _, frames, slope = frames_and_slope(atlas, SQUARE)
    expected = np.diag([-1.0, -1, 1] if mirrored else [1.0, 1, 1])
    # Differences of float64 with steps of 1e-6 are good to 1e-9.
    case.check(worst(frames, np.broadcast_to(expected, frames.shape)), FLOAT32,
               worst(slope, differences(atlas, SQUARE)), 1e-5)  # fmt: skip
    turned = textbook_frame(SQUARE[FACES[0]], uv[FACES[0]] * [1, -1])  # v up, as textbooks have it
    if mirrored:
        case.naive_fails(abs(np.linalg.det(turned) - 1))


def test_triangle_without_area_in_the_map(case: HardCase) -> None:
    """It has no direction of u: the first edge stands in, and no number is divided by its area."""
    uv = np.array([[0.2, 0.2], [0.5, 0.5], [0.8, 0.8]])
    weights = tangent_weights(uv[None].astype(np.float32))
    # du and dv agree along the line: the second corner's share follows from them alone.
    assert len(rasterize_faces(uv[None].astype(np.float32), 8).face) == 0
    edge1, edge2 = uv[1] - uv[0], uv[2] - uv[0]
    case.check(worst(abs(weights.sum()) + abs(np.abs(weights).max() - 1), 0.0), EXACT)
    area = np.float32(edge1[0] * edge2[1] - edge1[1] * edge2[0]) + np.float32(1e-8)  # as guards are usually written
    naive = np.array([edge1[1] - edge2[1], edge2[1], -edge1[1]]) / area
    case.naive_fails(abs(naive.sum()) + abs(np.abs(naive).max() - 1))


@pytest.mark.parametrize("thin", [1e-3, 1e-6, 0.0])
def test_triangle_nearly_without_area_on_the_surface(case: HardCase, thin: float) -> None:
    """A sliver, a thinner one, a line: frames stay rotations, and their slopes finite."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, thin, 0]])
    uv = np.array([[[0.0, 0], [1, 0], [0.5, 1]]])
    atlas = atlas_of(vertices, np.array([[0, 1, 2]]), uv)
    _, frames, slope = frames_and_slope(atlas, vertices)
    rotations = frames.double().numpy()
    identity = np.broadcast_to(np.eye(3), rotations.shape)
    assert torch.isfinite(slope).all()
    case.check(worst(np.swapaxes(rotations, 1, 2) @ rotations, identity) + worst(np.linalg.det(rotations), 1.0), 3e-6)
    if not thin:
        at = torch.tensor(vertices, dtype=torch.float32)
        case.naive_fails(abs(float(naive_normal(at).norm()) - 1))


@pytest.mark.parametrize("length", [0.0, 1e-42, 1e-30, 1e30])
def test_unit_vectors_beyond_the_squares_of_float32(case: HardCase, length: float) -> None:
    vector = (length * torch.tensor([2.0, -1, 0.5])).requires_grad_()
    found = unit_or(vector, 0.0)
    (slope,) = torch.autograd.grad(found[0], vector)
    exact = [mpmath.mpf(x) for x in vector.tolist()]
    norm = mpmath.sqrt(sum(x * x for x in exact))
    expected = [x / norm if length else mpmath.mpf(0) for x in exact]
    case.check(worst(found, expected, 1.0), FLOAT32)
    if length >= 1e-30:
        slopes = [((i == 0) - expected[0] * expected[i]) / norm for i in range(3)]
        case.check(gradient_error=worst(slope, slopes), gradient_bound=FLOAT32)
    assert torch.isfinite(slope).all() or 0 < length < 1e-38  # 1 / v is beyond float32 there, whatever is done
    case.naive_fails(worst((vector / vector.norm()), expected, 1.0))


def test_a_face_without_area_beside_others(case: HardCase) -> None:
    """It has no say in the normals around it: a cube's corner stays along its diagonal."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 0]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [0, 1, 4], [0, 0, 1]])
    at = torch.tensor(vertices, dtype=torch.float32, requires_grad=True)
    normals = vertex_normals(at, torch.tensor(faces), torch.arange(5))
    (slope,) = torch.autograd.grad(normals[0, 0], at)
    # Corner 0 sees 1/2 (-1, -1, -1); moving vertex 2 along x by e turns the sum by e/2 (0, ...): derivative of n_x.
    ends = []
    for sign in (1, -1):
        moved = vertices.copy()
        moved[2, 1] += sign * 1e-6
        ends.append(vertex_normals(moved, faces, np.arange(5))[0, 0])
    case.check(
        worst(normals[0], np.full(3, -1 / np.sqrt(3))), FLOAT32,
        worst(slope[2, 1], (ends[0] - ends[1]) / 2e-6), 1e-5,
    )  # fmt: skip
    areas = area_vectors(vertices, faces)
    with np.errstate(invalid="ignore"):  # the mean of the faces' unit normals
        naive = (areas / np.linalg.norm(areas, axis=1, keepdims=True)).sum(0)
    case.naive_fails(worst(naive / np.linalg.norm(naive), np.full(3, -1 / np.sqrt(3))))


def test_a_vertex_whose_faces_cancel(case: HardCase) -> None:
    """A sheet modelled from both sides with shared vertices: no vertex normal, but each side has its own."""
    both = np.concatenate([FACES, FACES[:, ::-1]])
    uv = np.concatenate([SQUARE_UV[FACES] * [0.5, 1], SQUARE_UV[FACES[:, ::-1]] * [0.5, 1] + [0.5, 0]])
    atlas = atlas_of(SQUARE, both, uv)
    _, frames, slope = frames_and_slope(atlas, SQUARE)
    side = np.where(atlas.face < 2, 1.0, -1.0)
    assert torch.isfinite(slope).all()
    case.check(worst(frames[:, :, 2], side[:, None] * [0, 0, 1]), FLOAT32)
    smooth = torch.nn.functional.normalize(torch.tensor(area_vectors(SQUARE, both)).sum(0), dim=0)
    case.naive_fails(worst(np.broadcast_to(smooth, (len(side), 3)), side[:, None] * [0, 0, 1]))


def test_doubled_faces(case: HardCase) -> None:
    """Every face twice: the same normals, and one Gaussian per texel, on the first of the two."""
    twice = np.concatenate([FACES, FACES])
    table = rasterize_faces(SQUARE_UV[twice].astype(np.float32), 8)
    normals = vertex_normals(SQUARE, twice, np.arange(4))
    assert table.face.max() == 1
    assert table.overlap > 0.8  # all but the texels on the diagonal, and it is said
    case.check(max(worst(normals, np.tile([0, 0, 1.0], (4, 1))), worst(len(table.face), 64)), EXACT)
    alone = sum(len(rasterize_faces(SQUARE_UV[face][None].astype(np.float32), 8).face) for face in twice)
    case.naive_fails(worst(alone, 64))


@pytest.mark.parametrize("size", [8, 9, 512])
def test_texels_exactly_on_a_seam(case: HardCase, size: int) -> None:
    """Centres on the diagonal that two triangles share: each has one face, and the point that the map says."""
    table = rasterize_faces(SQUARE_UV[FACES].astype(np.float32), size)
    row, column = table.texel.T
    points = (SQUARE[FACES[table.face]] * table.barycentric[..., None]).sum(1)
    exact = np.stack([-1 + 2 * (column + 0.5) / size, 1 - 2 * (row + 0.5) / size, np.full(len(row), 3.0)], 1)
    case.check(max(worst(points, exact), worst(len(row), size * size)), 1e-12)
    # Strictly inside loses the diagonal; the border counted to both sides has it twice.
    corners, centers = SQUARE_UV[FACES] * size, np.stack([column + 0.5, row + 0.5], 1)
    inside = 0
    for a, b, c in corners:
        edges = [
            (q - p)[0] * (centers - p)[:, 1] - (q - p)[1] * (centers - p)[:, 0] for p, q in ((a, b), (b, c), (c, a))
        ]
        inside += np.count_nonzero(np.abs(np.sign(edges).sum(0)) == 3)
    case.naive_fails(worst(inside, size * size))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_normals_across_a_seam_at_any_scale(case: HardCase, scale: float) -> None:
    """A roof whose ridge is a texture seam, its vertices written twice: on the ridge the normal points up."""
    roof = scale * (
        np.array([[-1.0, 0, 0], [0, 1, 0], [0, 1, 1], [-1, 0, 1], [0, 1, 0], [1, 0, 0], [1, 0, 1], [0, 1, 1]])
    )
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 7, 5], [7, 6, 5]])
    weld = weld_vertices(roof.astype(np.float32), faces)
    normals = vertex_normals(roof, faces, weld)
    ridge = normals[[1, 2, 4, 7]]
    up = ridge[:, 1]  # not exactly 1: one or two triangles of a side meet at an end of the ridge
    assert (weld[[4, 7]] == [1, 2]).all()
    case.check(worst(ridge[0], ridge[2]) + worst(ridge[1], ridge[3]) + worst(np.linalg.norm(ridge, axis=1), 1.0), EXACT)
    assert (up > 0.9).all()
    alone = vertex_normals(roof, faces, np.arange(8))
    case.naive_fails(np.linalg.norm(alone[1] - alone[4]))


@pytest.mark.parametrize("z", [1.0, -1.0, -1 + 1e-6])
def test_a_tangent_at_the_poles(case: HardCase, z: float) -> None:
    """Bases have their bad spot: this one's is neither at a pole nor a hair beside it."""
    n = torch.tensor([np.sqrt(max(0.0, 1 - z * z)), 0.0, z], dtype=torch.float32)
    t = any_tangent(n)
    case.check(max(abs(float(t.norm()) - 1), abs(float(t @ n))), FLOAT32)
    if z < 0:  # Frisvad's, which has no sign to change
        a = 1 / (1 + n[2])
        naive = torch.stack([1 - n[0] * n[0] * a, -n[0] * n[1] * a, -n[0]])
        case.naive_fails(
            max(abs(float(naive.norm()) - 1), abs(float(naive @ n)), key=lambda e: e if e == e else np.inf)
        )
