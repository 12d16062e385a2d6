"""Calibration of rigs of fisheyes against planted cameras, whose corners are projected by cv2.fisheye."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.calibration.cameras.rig_calibration import calibrate_rig
from pipeline.calibration.cameras.rig_join import BoardImage
from pipeline.calibration.cameras.rig_start import start_camera, view_rows
from pipeline.geometry.lenses import FISHEYE
from tests.support.rigs.cameras import BOARD, SIZE, center_errors, without_small_views
from tests.support.rigs.fisheyes import boards_around, observe_fisheyes, planted_fisheyes

COUNT = 4


@pytest.fixture(scope="module")
def planted():
    rng = np.random.default_rng(3)
    cameras = planted_fisheyes(COUNT, rng)
    return cameras, boards_around(cameras, 40, rng)


def calibrate(planted, noise, distortion="auto"):
    cameras, boards = planted
    seen, _ = without_small_views(observe_fisheyes(cameras, boards, noise, np.random.default_rng(4)))
    return calibrate_rig(seen, BOARD.corners_m(), [SIZE] * COUNT, distortion, FISHEYE)


@pytest.fixture(scope="module")
def calibrated(planted):
    return calibrate(planted, 0.1)


def test_planted_fisheyes_are_recovered_within_their_own_error_bars(planted, calibrated):
    rig, cameras = calibrated.rig, planted[0]
    assert rig.sigma_px == pytest.approx(0.1, rel=0.15)
    errors = np.linalg.norm(center_errors(rig.cameras, cameras), axis=1)
    assert np.all(errors < 4 * np.sqrt(3) * rig.center_sigma_m)
    assert rig.center_sigma_m.max() < 2e-3
    for c, (found, true) in enumerate(zip(rig.cameras, cameras, strict=True)):
        assert found.lens is FISHEYE
        covariance = rig.intrinsics_covariance[c]
        free = np.flatnonzero(np.diag(covariance) > 0)
        error = (found.intrinsics() - true.intrinsics())[free]
        # Chi-square of at most 8 numbers: above 40 once in 300,000 rigs. Terms left at zero bias the others by less.
        if len(free) == len(found.intrinsics()):
            assert error @ np.linalg.solve(covariance[np.ix_(free, free)], error) < 40
        assert abs(error[0]) < 4 * np.sqrt(covariance[0, 0])
        assert rig.focal_sigma[c] < 2e-3


def test_noiseless_corners_give_the_planted_fisheyes(planted):
    rig = calibrate(planted, 0.0, 4).rig
    # The priors pull with the weight of LEAST_SIGMA_PX = 1e-3 px: micrometres.
    assert np.abs(rig.residual).max() < 2e-3
    assert np.linalg.norm(center_errors(rig.cameras, planted[0]), axis=1).max() < 5e-5
    for found, true in zip(rig.cameras, planted[0], strict=True):
        np.testing.assert_allclose(found.dist, true.dist, atol=1e-3)


def test_number_of_coefficients_follows_the_views(planted, calibrated):
    """0.02 theta^3 alone moves a corner at 70 degrees by 8 px: no fisheye of these is equidistant."""
    assert set(calibrated.distortion) <= set(FISHEYE.term_counts)
    assert min(calibrated.distortion) >= 1
    for found, number in zip(calibrated.rig.cameras, calibrated.distortion, strict=True):
        assert np.all(found.dist[number:] == 0)


def test_equidistant_fisheyes_get_no_coefficients(planted):
    cameras, boards = planted
    straight = [type(c)(c.R, c.t, c.K, np.zeros(4), c.width, c.height, FISHEYE) for c in cameras]
    assert calibrate((straight, boards), 0.1).distortion == [0] * COUNT


def test_one_camera_alone_starts_within_a_percent(planted):
    cameras, boards = planted
    seen = observe_fisheyes(cameras, boards, 0.1, np.random.default_rng(4))
    for c, camera in enumerate(cameras):
        images = [
            BoardImage(BOARD.corners_m()[seen.corner[rows]], seen.pixel[rows])
            for (k, _), rows in view_rows(seen).items()
            if k == c and len(rows) >= 12
        ]
        found = start_camera(images, SIZE, FISHEYE)
        assert found.K[0, 0] == pytest.approx(camera.K[0, 0], rel=0.01)
        np.testing.assert_array_equal(found.R, np.eye(3))


def test_boards_beyond_90_degrees_count(planted):
    """Points projected by the definition, up to 110 degrees from the axis, where OpenCV's own formula ends at 90."""
    camera, rng = planted[0][0], np.random.default_rng(5)
    wide = type(camera)(np.eye(3), np.zeros(3), camera.K * [[0.7], [0.7], [1]], camera.dist, *SIZE, FISHEYE)
    images = []
    for aside in np.radians(np.linspace(5, 100, 24)):
        around = rng.uniform(0, 2 * np.pi)
        forward = np.array([np.sin(aside) * np.cos(around), np.sin(aside) * np.sin(around), np.cos(aside)])
        right = np.cross([0.3, 1.0, 0.2], forward)
        right /= np.linalg.norm(right)
        turned = np.stack([right, np.cross(forward, right), forward], 1)
        points = BOARD.corners_m() - [0.42, 0.3, 0]
        tilted = points @ cv2.Rodrigues(0.4 * rng.normal(size=3))[0].T + [0, 0, 0.8]
        x, y, z = (tilted @ turned.T).T
        theta = np.arccos(z / np.sqrt(x * x + y * y + z * z))
        theta_d = theta * (1 + sum(k * theta ** (2 * n) for n, k in enumerate(wide.dist, 1)))
        scale = theta_d / np.hypot(x, y)
        pixels = np.stack([wide.K[0, 0] * scale * x + wide.K[0, 2], wide.K[1, 1] * scale * y + wide.K[1, 2]], 1)
        images.append(BoardImage(BOARD.corners_m(), pixels + 0.05 * rng.normal(size=pixels.shape)))
    assert max(np.degrees(np.arccos(wide.ray_directions(image.pixels)[:, 2])).max() for image in images) > 100
    found = start_camera(images, SIZE, FISHEYE)
    assert found.K[0, 0] == pytest.approx(wide.K[0, 0], rel=2e-3)
    np.testing.assert_allclose(found.dist, wide.dist, atol=5e-3)
