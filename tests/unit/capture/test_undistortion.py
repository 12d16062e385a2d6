"""Undistorted images against an analytic scene, photographed through an independent lens model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.undistortion import (
    Box,
    LensMaps,
    distorted_positions,
    seen_pixels,
    undistort_image,
    undistort_mask,
)
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import FISHEYE

WIDTH, HEIGHT = 120, 90
LENSES = {
    "barrel": (-0.15, 0.06, 0.0, 0.0, 0.0),
    "pincushion": (0.08, 0.02, 0.0, 0.0, 0.01),
    "decentred": (-0.1, 0.0, 0.004, -0.003, 0.0),
}
WAVE_PX = 16.0
TOLERANCE = 1e-3
"""A cubic spline errs by (35 / 1152) h^4 |f''''| per axis (natural bound); h = 1, f'''' = 0.4 (2 pi / 16)^4 = 0.0095:
3e-4 per axis, two axes."""


def camera_with(lens: tuple[float, ...]) -> Camera:
    K = np.array([[130.0, 0.0, 57.3], [0.0, 128.0, 46.1], [0.0, 0.0, 1.0]])
    return Camera(np.eye(3), np.zeros(3), K, np.array(lens), WIDTH, HEIGHT)


def scene(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Three smooth patterns on the plane z = 1, in pixels of the ideal image (focal length 130)."""
    w = 2 * np.pi * 130 / WAVE_PX
    return np.stack([0.5 + 0.4 * np.sin(w * x), 0.5 + 0.4 * np.cos(w * y), 0.3 + 0.5 * x + 0.2 * y], -1)


def photograph(camera: Camera) -> np.ndarray:
    """What the distorted camera records: for each pixel the ray is found by fixed-point iteration on Brown's model."""
    k1, k2, p1, p2, k3 = camera.dist
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    xd, yd = (u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1]
    x, y = xd.copy(), yd.copy()
    for _ in range(200):
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        dx, dy = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        x, y = (xd - dx) / radial, (yd - dy) / radial
    return scene(x, y).astype(np.float32)


def ideal(camera: Camera, box: Box) -> np.ndarray:
    v, u = np.mgrid[box.y0 : box.y0 + box.height, box.x0 : box.x0 + box.width] + 0.5
    return scene((u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1])


def well_inside(camera: Camera, box: Box) -> np.ndarray:
    x, y = np.moveaxis(distorted_positions(camera, box), -1, 0)
    edge = 6  # the spline knows nothing beyond the border; its influence decays by 0.268 per pixel
    return (x > edge) & (x < WIDTH - edge) & (y > edge) & (y < HEIGHT - edge)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("box", [Box(0, 0, WIDTH, HEIGHT), Box(12, 8, 40, 25)])
def test_an_analytic_scene(lens, box):
    camera = camera_with(LENSES[lens])
    found = undistort_image(photograph(camera), camera, box)
    assert found.shape == (box.height, box.width, 3)
    assert found.dtype == np.float32
    inside = well_inside(camera, box)
    assert inside.mean() > 0.6
    error = np.abs(found - ideal(camera, box))[inside]
    assert error.max() < TOLERANCE
    # The tolerance is no net with holes: half a pixel of shift would be 0.4 * 2 pi / 16 / 2 = 0.08.
    left = np.abs(photograph(camera)[box.slices] - ideal(camera, box))[inside]
    assert left.max() > 20 * TOLERANCE


FISHEYE_TERMS = np.array([-0.03, 0.012, -0.005, 0.0007])


def fisheye_camera(focal: float) -> Camera:
    K = np.array([[focal, 0.0, 57.3], [0.0, focal, 46.1], [0.0, 0.0, 1.0]])
    return Camera(np.eye(3), np.zeros(3), K, FISHEYE_TERMS, WIDTH, HEIGHT, FISHEYE)


def test_an_analytic_scene_through_a_fisheye():
    """Waves as long in the image as those of the perspective lenses; theta is looked up in a table of theta_d."""
    camera = fisheye_camera(130.0)
    table = np.linspace(0, 1.2, 100_001)
    theta_d = table * (1 + sum(k * table ** (2 * n) for n, k in enumerate(FISHEYE_TERMS, 1)))
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    xd, yd = (u - 57.3) / 130, (v - 46.1) / 130
    tangent = np.tan(np.interp(np.hypot(xd, yd), theta_d, table)) / np.hypot(xd, yd)
    image = scene(tangent * xd, tangent * yd).astype(np.float32)
    box = Box(0, 0, WIDTH, HEIGHT)
    inside = well_inside(camera, box)
    assert inside.mean() > 0.6
    error = np.abs(undistort_image(image, camera, box) - ideal(camera, box))
    assert error[inside].max() < TOLERANCE


def test_keypoints_of_a_fisheye_lie_where_its_undistorted_image_shows_them():
    camera = fisheye_camera(60.0)
    rows, columns = np.mgrid[5:85:10, 5:115:10]
    straight = np.stack([columns.ravel(), rows.ravel()], 1) + 0.5
    pixels = distorted_positions(camera, Box(0, 0, WIDTH, HEIGHT))[rows.ravel(), columns.ravel()]
    found = camera.undistort(pixels) @ camera.K[:2, :2].T + camera.K[:2, 2]
    np.testing.assert_allclose(found, straight, atol=1e-9)


def test_a_crop_is_a_part_of_the_whole():
    camera = camera_with(LENSES["barrel"])
    image = np.random.default_rng(0).uniform(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    whole = undistort_image(image, camera, Box(0, 0, WIDTH, HEIGHT))
    for box in (Box(50, 40, 10, 8), Box(0, 0, 5, 5), Box(WIDTH - 3, HEIGHT - 9, 3, 9)):
        np.testing.assert_allclose(undistort_image(image, camera, box), whole[box.slices], atol=1e-6)


def test_without_distortion_nothing_changes():
    camera = camera_with((0.0,) * 5)
    image = np.random.default_rng(0).uniform(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    box = Box(3, 4, 50, 60)
    np.testing.assert_allclose(undistort_image(image, camera, box), image[box.slices], atol=1e-6)
    np.testing.assert_allclose(undistort_mask(image[..., 0], camera), image[..., 0], atol=1e-6)


def test_a_mask_moves_with_its_image_and_ends_where_the_image_ends():
    camera = camera_with(LENSES["pincushion"])  # its corners look beyond the recorded image
    mask = undistort_mask(np.ones((HEIGHT, WIDTH), np.float32), camera)
    seen = seen_pixels(camera, Box(0, 0, WIDTH, HEIGHT))
    assert mask[seen].min() == 1
    assert not mask[~seen].any()
    assert 0.5 < seen.mean() < 0.999
    disc = np.linalg.norm(np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5 - np.array([30.0, 80.0])[:, None, None], axis=0) < 12
    moved = undistort_mask(disc.astype(np.float32), camera)
    rows, columns = np.nonzero(moved > 0.5)
    center = np.array([columns.mean() + 0.5, rows.mean() + 0.5])
    expected = camera.undistort(np.array([[80.0, 30.0]]))[0] * [130, 128] + [57.3, 46.1]
    assert np.linalg.norm(center - expected) < 0.5  # a tenth of a pixel of curvature, and the disc's own staircase
    assert moved.min() >= 0
    assert moved.max() <= 1


def test_positions_follow_the_camera_not_its_pose():
    camera = camera_with(LENSES["decentred"])
    moved = replace(camera, R=np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), t=np.array([1.0, 2, 3]))
    box = Box(2, 3, 4, 5)
    np.testing.assert_array_equal(distorted_positions(camera, box), distorted_positions(moved, box))


def test_kept_map_gives_what_a_fresh_one_gives(monkeypatch):
    """And no more maps are kept than fit."""
    camera, image = (
        camera_with(LENSES["barrel"]),
        np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32),
    )
    maps, box = LensMaps(), Box(7, 9, 31, 22)
    kept = maps.of("a", camera)
    assert maps.of("a", camera) is kept
    np.testing.assert_allclose(
        undistort_image(image, camera, box, kept), undistort_image(image, camera, box), atol=1e-6
    )
    np.testing.assert_array_equal(undistort_mask(image[..., 0], camera, kept), undistort_mask(image[..., 0], camera))
    monkeypatch.setattr("pipeline.capture.undistortion.KEPT_BYTES", maps.bytes)
    assert maps.of("b", camera) is not maps.of("b", camera)
