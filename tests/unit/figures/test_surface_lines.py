"""Level lines on a box: on planes of the rest pose, on the surface, and only where a camera sees them."""

from __future__ import annotations

import numpy as np
import trimesh

from pipeline.figures.surface_lines import LINES_ACROSS, level_lines, seen_lines
from pipeline.geometry.cameras import Camera


def a_box() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box((1.0, 2.0, 0.5)).subdivide().subdivide()
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def test_lines_lie_on_planes_and_on_the_surface() -> None:
    vertices, faces = a_box()
    ends = level_lines(vertices, faces).carried(vertices).reshape(-1, 2, 3)
    assert (np.abs(ends[:, 0] - ends[:, 1]) < 1e-9).any(1).all()
    on_surface = np.abs(np.abs(ends) - [0.5, 1.0, 0.25]) < 1e-9
    assert on_surface.any(2).all()
    # The planes cut the box in a rectangle each: their lengths add up to the box's own circumferences.
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum()
    step = 2.0 / LINES_ACROSS
    expected = sum(2 * (a + b) * extent / step for a, b, extent in ((1, 2, 0.5), (1, 0.5, 2), (2, 0.5, 1)))
    assert abs(length / expected - 1) < 0.05


def test_lines_move_with_the_surface_and_hidden_ones_are_left_out() -> None:
    vertices, faces = a_box()
    K = np.array([[100.0, 0, 60], [0, 100, 60], [0, 0, 1]])
    camera = Camera(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 3.0]), K, np.zeros(5), 120, 120)
    moved = vertices + np.array([0.1, 0.0, 0.0])
    pieces = seen_lines(level_lines(vertices, faces), camera, moved, faces)
    front = [60 + 100 * np.array([-0.4, 0.6]) / 2.75, 60 + 100 * np.array([-1.0, 1.0]) / 2.75]
    for axis, (low, high) in enumerate(front):
        assert abs(pieces[..., axis].min() - low) < 2 and abs(pieces[..., axis].max() - high) < 2
    wall = np.concatenate([vertices, [[-3, -3, 1], [3, -3, 1], [3, 3, 1], [-3, 3, 1]]])
    screen = np.array([[0, 1, 2], [0, 2, 3]]) + len(vertices)
    assert len(seen_lines(level_lines(vertices, faces), camera, wall, np.concatenate([faces, screen]))) == 0
