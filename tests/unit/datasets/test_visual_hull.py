"""Visual hulls of masks whose hull has a closed form, and of masks that leave nothing."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pipeline.datasets.visual_hull import OutlineView, carve
from pipeline.geometry.cameras import Camera

RADIUS, AWAY, SIDE = 0.2, 20.0, 160
CENTER = np.array([0.3, -0.1, 0.5])
FOCAL = 60 * AWAY / RADIUS
"""The sphere is 120 pixels wide."""

AXES = {
    "x": [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    "y": [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    "z": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
}


def view(axis: str, pixels: float = 60.0, shift: float = 0.0, turned: bool = False) -> OutlineView:
    """A camera far away that looks at the sphere along an axis, or away from it, and its mask."""
    R = np.array(AXES[axis])
    K = np.array([[FOCAL, 0, SIDE / 2], [0, FOCAL, SIDE / 2], [0, 0, 1]])
    place = CENTER - AWAY * R[2]
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    # Coverage of the pixels at the rim, to first order.
    inside = np.clip(pixels - np.hypot(x - shift, y) + 0.5, 0, 1)
    R = np.diag([1.0, -1.0, -1.0]) @ R if turned else R
    return OutlineView(Camera(R, -R @ place, K, np.zeros(5), SIDE, SIDE), np.round(255 * inside).astype(np.uint8))


def test_sphere_seen_along_three_axes_has_the_hull_of_three_cylinders():
    """Steinmetz's solid of three cylinders: volume 8 (2 - sqrt 2) r^3, and the sphere's extent along the axes."""
    hull = carve([view(axis) for axis in AXES], 48)
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    # Cones of 1 in 100 for cylinders, and corners cut by cells of 2 r / 48.
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(8 * (2 - np.sqrt(2)) * RADIUS**3, rel=0.01)
    away = np.linalg.norm(hull.vertices - CENTER, axis=1)
    assert away.min() == pytest.approx(RADIUS, rel=0.02)
    # Three cylinders meet in corners at (r, r, r) / sqrt 2.
    assert away.max() == pytest.approx(np.sqrt(1.5) * RADIUS, rel=0.03)


def test_cameras_that_look_away_leave_nothing():
    assert carve([view(axis, turned=True) for axis in AXES], 24) is None


def test_masks_that_contradict_each_other_leave_nothing():
    """Along y the object is within 20 pixels of the middle, along z beyond 30 of it."""
    assert carve([view("x", 20.0), view("y", 20.0), view("z", 20.0, shift=50.0)], 24) is None
    assert carve([view("x")], 24) is None, "one mask bounds nothing"
