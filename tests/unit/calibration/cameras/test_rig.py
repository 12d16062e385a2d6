"""Calibration of a rig against planted cameras, whose corners are projected by OpenCV."""

import cv2
import numpy as np
import pytest
import scipy.spatial.transform

from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_join import BoardImage
from pipeline.calibration.cameras.rig_model import RigModel
from pipeline.calibration.cameras.rig_start import connected_groups, start_camera, usable_views, view_rows
from pipeline.geometry.cameras import Camera, project_with_jacobian
from pipeline.geometry.lenses import BROWN_CONRADY
from pipeline.geometry.rotations import left_jacobian
from tests.support.rigs.cameras import (
    BOARD,
    SIZE,
    boards_in_stage,
    center_errors,
    observe,
    planted_cameras,
    solve,
    without_small_views,
)


def distances(rig, cameras):
    return np.linalg.norm(center_errors(rig.cameras, cameras), axis=1)


@pytest.fixture(scope="module")
def rig_of_six():
    rng = np.random.default_rng(7)
    return planted_cameras(6, rng), boards_in_stage(25, rng)


def test_planted_rig_is_recovered_within_its_own_error_bars(rig_of_six):
    cameras, boards = rig_of_six
    rig, _ = solve(observe(cameras, boards, 0.1, np.random.default_rng(8)), 6)
    assert rig.sigma_px == pytest.approx(0.1, rel=0.15)
    for error, sigma in zip(distances(rig, cameras), rig.center_sigma_m, strict=True):
        assert sigma < 4e-3
        assert error < 4 * np.sqrt(3) * sigma
    for found, true, sigma in zip(rig.cameras, cameras, rig.focal_sigma, strict=True):
        assert abs(found.K[0, 0] / true.K[0, 0] - 1) < 4 * sigma
        assert sigma < 2e-3


def test_noiseless_corners_give_the_planted_rig(rig_of_six):
    cameras, boards = rig_of_six
    rig, _ = solve(observe(cameras, boards, 0.0, np.random.default_rng(8)), 6)
    # The priors pull with the weight of LEAST_SIGMA_PX = 1e-3 px: micrometres.
    assert np.abs(rig.residual).max() < 2e-3
    assert max(distances(rig, cameras)) < 5e-5


def test_five_percent_of_wrong_corners_change_little(rig_of_six):
    cameras, boards = rig_of_six
    observations = observe(cameras, boards, 0.1, np.random.default_rng(8))
    rng = np.random.default_rng(9)
    wrong = rng.random(len(observations.camera)) < 0.05
    observations.pixel[wrong] += rng.uniform(-40, 40, (wrong.sum(), 2))
    rig, _ = solve(observations, 6)
    errors = distances(rig, cameras)
    # 5 % of outliers cost as much as 5 % fewer corners, and a little of Cauchy's efficiency.
    assert np.all(errors < 1.2 * 4 * np.sqrt(3) * rig.center_sigma_m)
    assert rig.center_sigma_m.max() < 4e-3


def test_no_distortion_means_exactly_none(rig_of_six):
    cameras, boards = rig_of_six
    observations = observe(cameras, boards, 0.1, np.random.default_rng(8))
    assert all(np.all(camera.dist == 0) for camera in solve(observations, 6, 0)[0].cameras)
    assert all(np.all(camera.dist[1:] == 0) for camera in solve(observations, 6, 1)[0].cameras)


def test_parallel_boards_at_one_distance_leave_the_focal_length_open():
    """Frontal views only: focal length and distance cannot be told apart. It must be seen in the error bar."""
    rng = np.random.default_rng(3)
    camera = Camera(np.eye(3), np.zeros(3), np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]]), np.zeros(5), *SIZE)
    boards = np.tile(np.eye(4), (8, 1, 1))
    boards[:, :3, 3] = [-0.42, -0.3, 2.5] + rng.uniform(-0.1, 0.1, (8, 3)) * [1, 1, 0]
    rig, _ = solve(observe([camera], boards, 0.1, rng), 1)
    assert rig.focal_sigma[0] > 0.01
    assert np.isfinite(rig.residual).all()


def test_cameras_that_share_no_view_are_groups():
    camera = np.repeat([0, 1, 2, 3], 6)
    view = np.repeat([0, 0, 1, 1], 6)
    observations = Observations(camera, view, np.tile(np.arange(6), 4), np.zeros((24, 2)))
    assert connected_groups(observations, 4) == [[0, 1], [2, 3]]
    assert len(view_rows(observations)) == 4


def test_corners_in_a_line_do_not_count():
    points = BOARD.corners_m()
    row = Observations(np.zeros(6, np.int64), np.zeros(6, np.int64), np.arange(6), np.zeros((6, 2)))
    block = Observations(np.zeros(6, np.int64), np.ones(6, np.int64), np.array([0, 1, 2, 6, 7, 8]), np.zeros((6, 2)))
    assert not usable_views(row, points).any()
    assert usable_views(block, points).all()


def test_projection_and_its_derivatives():
    rng = np.random.default_rng(0)
    intrinsics = np.tile([700.0, 1.01, 310, 250, -0.2, 0.1, 1e-2, -1e-2, 0.05], (20, 1))
    points = rng.uniform([-0.5, -0.5, 1.5], [0.5, 0.5, 3], (20, 3))
    pixel, by_intrinsics, by_point = project_with_jacobian(BROWN_CONRADY, intrinsics, points)
    K = np.array([[700.0, 0, 309.5], [0, 707, 249.5], [0, 0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, intrinsics[0, 4:])[0].reshape(-1, 2) + 0.5
    assert pixel == pytest.approx(expected, abs=1e-9)
    for arguments, jacobian, which in ((intrinsics, by_intrinsics, 0), (points, by_point, 1)):
        for k in range(arguments.shape[1]):
            step = 1e-6 * max(1.0, abs(arguments[0, k]))
            high, low = arguments.copy(), arguments.copy()
            high[:, k] += step
            low[:, k] -= step
            pair = [(a, points) if which == 0 else (intrinsics, a) for a in (high, low)]
            pixels = [project_with_jacobian(BROWN_CONRADY, *each)[0] for each in pair]
            numeric = (pixels[0] - pixels[1]) / (2 * step)
            assert jacobian[..., k] == pytest.approx(numeric, rel=1e-5, abs=1e-4)


def test_derivatives_of_corners_are_those_of_differences(rig_of_six):
    """By lenses, poses of cameras and poses of boards, away from where their rotations start."""
    cameras, boards = rig_of_six[0][:2], rig_of_six[1][:6]
    seen, views = without_small_views(observe(cameras, boards, 0.0, np.random.default_rng(0)))
    model = RigModel(seen, BOARD.corners_m()[seen.corner], cameras, boards[views], [5, 5], np.arange(2))
    x = model.start()
    x[model.free] += np.random.default_rng(1).normal(0, 0.03, len(model.free))
    jacobian = model.residuals(x)[1].toarray()
    assert jacobian.any(0).all() and len(views) > 2
    for position, column in enumerate(model.free):
        step = np.zeros_like(x)
        step[column] = 1e-6 * max(1.0, abs(x[column]))
        difference = (model.residuals(x + step)[0] - model.residuals(x - step)[0]).ravel() / (2 * step[column])
        assert jacobian[:, position] == pytest.approx(difference, rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.0099, 0.0101, 1.0, 3.1, 6.0])
def test_left_jacobian_by_differences(angle):
    vector = angle * np.array([2.0, -1.0, 2.0]) / 3
    jacobian, step = left_jacobian(vector), 1e-6
    rotation = scipy.spatial.transform.Rotation
    for k in range(3):
        moved = rotation.from_rotvec(vector + step * np.eye(3)[k]) * rotation.from_rotvec(vector).inv()
        back = rotation.from_rotvec(vector - step * np.eye(3)[k]) * rotation.from_rotvec(vector).inv()
        numeric = (moved.as_rotvec() - back.as_rotvec()) / (2 * step)
        assert jacobian[:, k] == pytest.approx(numeric, abs=1e-8)


def test_start_of_a_camera_has_the_same_bits_at_any_number_of_threads(rig_of_six):
    """cv2.calibrateCamera on two threads sums in the order in which views are done: 1e-12 apart from run to run."""
    cameras, boards = rig_of_six
    seen = observe(cameras, boards, 0.1, np.random.default_rng(8))
    mine = [np.flatnonzero((seen.camera == 0) & (seen.view == v)) for v in range(25)]
    views = [BoardImage(BOARD.corners_m()[seen.corner[rows]], seen.pixel[rows]) for rows in mine if len(rows) >= 6]
    threads = cv2.getNumThreads()
    try:
        found = []
        for count in (1, 2, 4) * 10:
            cv2.setNumThreads(count)
            found.append(start_camera(views, SIZE))
            assert cv2.getNumThreads() == count
    finally:
        cv2.setNumThreads(threads)
    for camera in found[1:]:
        np.testing.assert_array_equal(camera.K, found[0].K)
        np.testing.assert_array_equal(camera.dist, found[0].dist)
