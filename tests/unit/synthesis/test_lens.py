"""Development of a pinhole rendering into a distorted image, with renderings whose content is known exactly."""

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera
from pipeline.synthesis.lens import view_points, view_window
from pipeline.synthesis.stage_rig import look_at


@pytest.fixture
def camera():
    center = np.array([0.4, 0.3, 2.4])
    R = look_at(center, np.zeros(3), roll=0.05)
    K = np.array([[200.0, 0, 58], [0, 203, 84], [0, 0, 1]])
    return Camera(R, -R @ center, K, np.array([-0.1, 0.03, 0.002, -0.001, 0.01]), 120, 160)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_developed_coordinates_are_the_undistorted_ones(camera, samples):
    view = view_window(camera, np.array([[20.0, 30.0], [90.0, 120.0]]), samples)
    x, y, width, height = view.crop
    columns = (np.arange(width) + 0.5 + x - view.film[0] / 2) / view.focal
    rows = (np.arange(height) + 0.5 + y - view.film[1] / 2) / view.focal
    rendered = np.stack(np.meshgrid(columns, rows), axis=-1).astype(np.float32)
    image = view.develop(rendered)
    at = np.array([[40.5, 60.5], [71.5, 99.5], [25.5, 35.5]])
    found = image[(at[:, 1] - 0.5).astype(int), (at[:, 0] - 0.5).astype(int)]
    # Bilinear look-ups reproduce a linear field; cv2.remap rounds positions to 1/32 pixel, at most 1/64 off.
    np.testing.assert_allclose(found, camera.undistort(at), atol=1 / 64 / view.focal + 1e-5)


def test_nothing_outside_the_window(camera):
    view = view_window(camera, np.array([[20.0, 30.0], [40.0, 50.0]]), 2)
    x, y, width, height = view.window
    image = view.develop(np.ones((view.crop[3], view.crop[2], 1), dtype=np.float32))
    assert image.sum() == pytest.approx(width * height)
    assert (image[y : y + height, x : x + width] == 1).all()


def test_window_is_cut_to_the_image(camera):
    view = view_window(camera, np.array([[-50.0, -50.0], [300.0, 300.0]]), 1)
    assert view.window == (0, 0, camera.width, camera.height)
    away = view_window(camera, np.array([[-50.0, -50.0], [-20.0, -20.0]]), 1)
    assert min(away.window[2:]) >= 1


def test_window_holds_the_points(camera):
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3))
    pixels, _ = camera.project(points)
    x, y, width, height = view_points(camera, points, 2).window
    assert (pixels > [x, y]).all() and (pixels < [x + width, y + height]).all()


def test_look_at_keeps_up_up():
    R = look_at(np.array([0.0, 1.0, 3.0]), np.zeros(3))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    assert (R @ [0, 1.0, 0])[1] < 0  # image y points down
    assert (R @ [1.0, 0, 0])[0] > 0  # +x is on the right, seen from +z
