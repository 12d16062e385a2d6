"""Depth of shapes with known depth, and which of their points are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth, seen_well
from pipeline.geometry.surface_points import at_vertices, spread_points

CAMERA = Camera(np.eye(3), np.zeros(3), np.array([[200.0, 0, 80], [0, 200, 60], [0, 0, 1]]), np.zeros(5), 160, 120)


def test_depth_of_a_slanted_plane_is_exact() -> None:
    corners = np.array([[-1.0, -1.0, 1.5], [1.0, -1.0, 2.5], [1.0, 1.0, 2.5], [-1.0, 1.0, 1.5]])
    depth = draw_depth(CAMERA, corners, np.array([[0, 1, 2], [0, 2, 3], [1, 1, 2]]))
    column = np.arange(160) + 0.5
    # z = 2 + x / 2 and x = z (column - 80) / 200
    expected = 2 / (1 - (column - 80) / 400)
    inside = np.isfinite(depth)
    assert inside[20:100, 30:130].all()
    assert np.abs(depth - expected)[inside].max() < 1e-5


def test_the_front_of_a_ball_is_seen_and_what_it_hides_is_not() -> None:
    ball = trimesh.creation.icosphere(3, radius=0.3)
    wall = np.array([[-1, -1, 3.0], [-1, 1, 3.0], [1, 1, 3.0], [1, -1, 3.0]])
    vertices = np.concatenate([np.array(ball.vertices) + np.array([0, 0, 2.0]), wall])
    first = len(ball.vertices)
    faces = np.concatenate([np.array(ball.faces), first + np.array([[0, 1, 2], [0, 2, 3]])])
    depth = draw_depth(CAMERA, vertices, faces)
    normals = np.array(ball.vertices) / 0.3
    seen = seen_well(CAMERA, depth, vertices[:first], normals)
    way = -vertices[:first]
    cosine = (way * normals).sum(1) / np.linalg.norm(way, axis=1)
    assert seen[cosine > 0.5].all()
    assert not seen[cosine < 0.25].any()
    behind = np.array([[0.05, 0.0, 3.0], [0.8, 0.0, 3.0]])
    towards = np.tile([0.0, 0.0, -1.0], (2, 1))
    assert seen_well(CAMERA, depth, behind, towards).tolist() == [False, True]


def test_points_spread_by_area() -> None:
    vertices = np.array([[0.0, 0, 0], [3, 0, 0], [0, 2, 0], [3, 2, 0], [9, 9, 9]])
    faces = np.array([[0, 1, 2], [4, 4, 4], [1, 3, 2]])
    points = spread_points(vertices, faces, 2000)
    where = points.carried(vertices)
    assert ((where >= 0) & (where <= [3, 2, 0])).all()
    # 2000 points, half of them in each triangle; the mean of uniform points is good to 3 / sqrt(12 * 2000).
    assert np.allclose(where.mean(0), [1.5, 1.0, 0.0], atol=0.05)
    assert np.allclose(at_vertices(np.array([3, 0])).carried(vertices), vertices[[3, 0]])


@pytest.mark.parametrize(("cosine", "seen"), [(0.2, False), (0.4, True)])
def test_plane_at_a_grazing_angle_is_not_seen_well(cosine: float, seen: bool) -> None:
    """Through a long lens, so that its depth changes by far less than a step from pixel to pixel."""
    camera = replace(CAMERA, K=np.array([[4000.0, 0, 80], [0, 4000, 60], [0, 0, 1]]))
    normal = np.array([np.sqrt(1 - cosine**2), 0.0, -cosine])
    along = np.array([cosine, 0.0, np.sqrt(1 - cosine**2)])
    corners = np.array([[0, 0, 2.0]]) + [s * along + t * np.array([0, 1, 0]) for s, t in ((-1, -1), (1, -1), (0, 1))]
    depth = draw_depth(camera, corners, np.array([[0, 1, 2]]))
    assert seen_well(camera, depth, np.array([[0, 0, 2.0]]), normal[None]).tolist() == [seen]
