"""Shadow rays that start on a surface or graze it, at scene scales from millimetres to kilometres, far from the origin.

The naive version beside them is what one writes first: the mesh as it is, rays a tenth of a millimetre above it.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.lighting.visibility import Occluders
from tests.support.meshes.lit_meshes import ball_in_shell
from tests.support.naive.surfaces import NAIVE_OFFSET_M, naive_visible
from tests.support.results.hard_case import HardCase

SCALES = [1e-3, 1.0, 1e3]

SHIFT = np.array([20.0, -15, 10])
"""Where the scene stands, in its own size."""


@pytest.mark.parametrize("scale", SCALES)
def test_ball_in_a_shell(case: HardCase, scale: float) -> None:
    """Nothing reaches the ball, and the shell, convex, is lit where it faces the light: share of wrong answers."""
    vertices, faces, points, normals = ball_in_shell()
    light = np.array([2.0, 3, 4])
    slope = ((light - points) * normals).sum(1)
    truth, sure = (slope > 0) & (np.arange(len(points)) >= len(points) // 2), np.abs(slope) > 1e-6
    placed = [scale * (array + SHIFT) for array in (vertices, points, light)]
    seen, _ = Occluders(placed[0], faces).visible(placed[1], normals, placed[2])
    case.check(np.mean(seen[sure] != truth[sure]), 0)
    offset = NAIVE_OFFSET_M if scale != 1 else 0.0  # a tenth of a millimetre is right for metres; nothing never is
    naive = naive_visible(placed[0], faces, placed[1], normals, placed[2], offset)
    case.naive_fails(np.mean(naive[sure] != truth[sure]))


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("degrees", [1.0, 0.01])
def test_light_that_grazes_a_tilted_floor(case: HardCase, scale: float, degrees: float) -> None:
    """A plane of many triangles never shadows itself: share of its faces that a light a hair above it misses."""
    steps = np.linspace(-1, 1, 25)
    x, z = (axis.ravel() for axis in np.meshgrid(steps, steps, indexing="ij"))
    k = (25 * np.arange(24)[:, None] + np.arange(24)).ravel()
    faces = np.concatenate([np.stack([k, k + 1, k + 25], 1), np.stack([k + 1, k + 26, k + 25], 1)])
    turn = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    vertices = scale * (np.stack([x, 0 * x, z], 1) @ turn.T + SHIFT)
    normal = turn @ [0, 1.0, 0]
    radians = np.radians(degrees)
    light = scale * (turn @ (50 * np.array([np.cos(radians), np.sin(radians), 0])) + SHIFT)
    points, normals = vertices[faces].mean(1), np.tile(normal, (len(faces), 1))
    seen, rays = Occluders(vertices, faces).visible(points, normals, light)
    assert rays == len(points)
    case.check(np.mean(~seen), 0)
    offset = NAIVE_OFFSET_M if scale > 1 else 0.0
    case.naive_fails(np.mean(~naive_visible(vertices, faces, points, normals, light, offset)))


def test_rays_that_start_on_doubled_faces(case: HardCase) -> None:
    """A face that lies in another one does not shadow it."""
    mesh = trimesh.creation.icosphere(2)
    vertices, faces = np.array(mesh.vertices) + SHIFT, np.repeat(np.array(mesh.faces), 2, 0)
    points, normals = vertices[faces].mean(1), unit_or(area_vectors(vertices, faces), 0.0)
    light = SHIFT + np.array([2.0, 3, 4])
    slope = ((light - points) * normals).sum(1)
    sure = np.abs(slope) > 1e-6
    seen, _ = Occluders(vertices, faces).visible(points, normals, light)
    case.check(np.mean(seen[sure] != (slope > 0)[sure]), 0)
    naive = naive_visible(vertices, faces, points, normals, light, offset=0.0)
    case.naive_fails(np.mean(naive[sure] != (slope > 0)[sure]))


@pytest.mark.parametrize("scale", SCALES)
def test_distance_to_the_first_surface(case: HardCase, scale: float) -> None:
    """Straight across the gap between the ball and its shell, over the gap's width."""
    vertices, faces, points, normals = ball_in_shell()
    half = len(points) // 2
    placed, starts = scale * (vertices + SHIFT), scale * (points[:half] + SHIFT)
    # Along a face's own normal the shell's copy of the face is 0.02 times its plane's distance from the centre away.
    gap = 0.02 * scale * (points[:half] * normals[:half]).sum(1)
    found = Occluders(placed, faces).first_hits(starts, normals[:half], starts + 10 * scale * normals[:half])
    # The ray starts 64 float32 steps of the half extent above the ball, and what it measures is as coarse as a few.
    bound = 80 * 2.0**-23 * 1.02 / 0.02
    case.check(np.max(np.abs(found - gap) / gap), bound)
