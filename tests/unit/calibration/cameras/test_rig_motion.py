"""Boards that move while the cameras of a rig take their images one after the other: planted lags come out again."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.spatial.transform

from pipeline.calibration.cameras.board_motion import restful_shots, with_motion
from pipeline.calibration.cameras.board_views import BoardViews
from pipeline.calibration.cameras.rig_calibration import calibrate_rig
from pipeline.calibration.cameras.rig_inputs import Observations, RigPriors
from pipeline.calibration.cameras.rig_model import RigModel
from pipeline.calibration.cameras.rig_spread import with_spread
from tests.support.rigs.cameras import BOARD, SIZE, center_errors, planted_cameras

RATE_HZ, SHOTS = 10.0, 40
LAGS_S = np.array([0.02, -0.03, 0.01])
JITTER_S = 0.01


def board_at(time_s):
    """Pose of a board that swings about the origin at walking pace, at most 0.6 m/s."""
    angles = [0.3 * np.sin(1.3 * time_s), np.pi + 0.4 * np.sin(0.9 * time_s + 1), 0.3 * np.sin(1.7 * time_s)]
    R = scipy.spatial.transform.Rotation.from_euler("YXZ", angles).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = R
    place = np.array([0.3 * np.sin(1.9 * time_s), 0.2 * np.sin(1.1 * time_s), 0.25 * np.sin(1.5 * time_s + 2)])
    pose[:3, 3] = place - R @ [0.42, 0.3, 0]
    return pose


def film(phase=lambda time_s: time_s):
    """Three cameras that see the board late by their lag and a jitter; the table says that all were punctual.

    Args:
        phase: of the board's swing at a time.
    """
    rng = np.random.default_rng(1)
    cameras = planted_cameras(3, rng, arc=0.6 * np.pi)
    rows, jitter = [], rng.normal(0, JITTER_S, (3, SHOTS))
    for c, camera in enumerate(cameras):
        for v in range(SHOTS):
            pose = board_at(phase(v / RATE_HZ + LAGS_S[c] + jitter[c, v]))
            world = BOARD.corners_m() @ pose[:3, :3].T + pose[:3, 3]
            turn = cv2.Rodrigues(camera.R)[0]
            pixels = cv2.projectPoints(world, turn, camera.t, camera.opencv_K(), camera.dist)[0].reshape(-1, 2) + 0.5
            inside = ((pixels > 0) & (pixels < SIZE)).all(1)
            rows += [(c, v, k, *pixels[k]) for k in np.flatnonzero(inside)]
    table = np.array(rows, float)
    pixels = table[:, 3:] + rng.normal(0, 0.05, (len(table), 2))
    observations = Observations(*table[:, :3].astype(np.int64).T, pixels)
    views = BoardViews(observations, BOARD.corners_m(), np.arange(SHOTS), np.zeros(SHOTS, np.int64))
    return cameras, views, {(c, v): v / RATE_HZ for c in range(3) for v in range(SHOTS)}, jitter


@pytest.fixture(scope="module")
def filmed():
    return film()


@pytest.fixture(scope="module")
def calibrated(filmed):
    cameras, views, times, _ = filmed
    moving = views.moving(times)
    known = RigPriors(cameras, 0.0)
    return with_spread(
        calibrate_rig(moving.observations, moving.corners_m, [SIZE] * 3, "auto", known=known), moving.shot
    )


def test_lags_and_jitter_are_those_planted(filmed, calibrated):
    rig = calibrated.rig
    lags = rig.parameters[rig.model.lag_columns]
    # Their mean is open. Forty images of 10 ms jitter each.
    assert lags - lags.mean() == pytest.approx(LAGS_S - LAGS_S.mean(), abs=3 * JITTER_S / np.sqrt(SHOTS))
    jitter = filmed[3] - filmed[3].mean(0)  # of all images of a shot, the board's own time takes the mean
    assert rig.clock_sigma_s == pytest.approx(np.sqrt((jitter**2).sum() / (2 * SHOTS)), rel=0.25)


def test_poses_are_those_planted_within_their_error_bars(filmed, calibrated):
    cameras, views, _, _ = filmed
    at_once = calibrate_rig(views.observations, views.corners_m, [SIZE] * 3, "auto", known=RigPriors(cameras, 0.0)).rig
    error = np.linalg.norm(center_errors(calibrated.rig.cameras, cameras), axis=1)
    assert error.max() < 1e-3
    assert (error / np.sqrt(3) < 3 * calibrated.rig.center_sigma_m).all()
    # Ten times as far off if the images are taken for simultaneous.
    assert np.linalg.norm(center_errors(at_once.cameras, cameras), axis=1).max() > 5 * error.max()
    assert np.sqrt((calibrated.rig.residual**2).sum(1).mean()) < 0.15


def test_lenses_can_be_estimated_along(filmed):
    cameras, views, times, _ = filmed
    moving = views.moving(times)
    rig = calibrate_rig(moving.observations, moving.corners_m, [SIZE] * 3, 5).rig
    for camera, found, sigma in zip(cameras, rig.cameras, rig.focal_sigma, strict=True):
        assert found.K[0, 0] == pytest.approx(camera.K[0, 0], rel=max(4 * sigma, 2e-3))


def test_given_lenses_stay(filmed):
    cameras, views, times, _ = filmed
    moving = views.moving(times)
    wrong = [replace(c, K=c.K * np.array([[1.01], [1.01], [1.0]])) for c in cameras]
    known = calibrate_rig(moving.observations, moving.corners_m, [SIZE] * 3, "auto", known=RigPriors(wrong, 0.0)).rig
    for given, kept in zip(wrong, known.cameras, strict=True):
        assert pytest.approx(given.K) == kept.K
        assert kept.dist == pytest.approx(given.dist)


def test_velocities_are_those_of_a_parabola():
    """Corners on parabolas in time, at uneven times, have their exact derivatives; the ends have lines."""
    times = np.array([0.0, 0.1, 0.25, 0.3])
    corner, view = np.tile(np.arange(3), 4), np.repeat(np.arange(4), 3)
    t = times[view]
    pixel = np.stack([100 + 30 * t - 200 * t**2 + corner, 50 - 10 * t + 90 * t**2], 1)
    seen = Observations(np.zeros(12, np.int64), view, corner, pixel)
    moving = with_motion(seen, np.arange(4), np.zeros(4, np.int64), {(0, v): times[v] for v in range(4)})
    middle = (view > 0) & (view < 3)
    slope = np.stack([30 - 400 * t, -10 + 180 * t], 1)
    assert moving.motion.velocity[middle] == pytest.approx(slope[middle])
    assert moving.motion.acceleration[middle] == pytest.approx(np.tile([-400, 180], (6, 1)))
    assert moving.motion.velocity[view == 0][0] == pytest.approx((pixel[3] - pixel[0]) / 0.1)
    assert (moving.motion.acceleration[~middle] == 0).all()


def test_shots_are_chosen_where_the_board_rests():
    """A hand that holds the board still for the latter half of each second, and moves it in between."""
    cameras, views, times, _ = film(lambda time_s: np.floor(time_s) + np.minimum(2 * (time_s % 1), 1.0))
    moving = views.moving(times)
    assert moving.resting(None) is moving
    chosen = moving.resting(4)
    assert all((shot / RATE_HZ) % 1 >= 0.5 for shot in chosen.shot)
    every = moving.observations.select(np.isin(moving.shot, np.arange(2, SHOTS, SHOTS // 4))[moving.observations.view])
    evenly = replace(moving, observations=every).for_cameras(range(3))
    errors = []
    for part in (chosen, evenly):
        assert len(np.unique(part.shot)) == 4
        known = RigPriors(cameras, 0.0)
        rig = calibrate_rig(part.observations, part.corners_m, [SIZE] * 3, "auto", known=known).rig
        errors.append(np.linalg.norm(center_errors(rig.cameras, cameras), axis=1).max())
    assert errors[0] < 0.5 * errors[1]


def test_shots_of_one_camera_alone_are_chosen_only_where_there_are_no_others():
    """Shots 0 to 3: the first and the last are shared, and move; the second camera lacks the others."""
    camera, view, corner = (a.ravel() for a in np.meshgrid([0, 1], np.arange(4), np.arange(3), indexing="ij"))
    pixel = np.stack([100.0 + 50 * view + corner, 20.0 * corner], 1)
    seen = Observations(camera, view, corner, pixel).select((camera == 0) | np.isin(view, [0, 3]))
    moving = with_motion(seen, np.arange(4), np.zeros(4, np.int64), {(c, v): 0.1 * v for c in (0, 1) for v in range(4)})
    assert restful_shots(moving, np.arange(4), 2).tolist() == [0, 3]
    assert restful_shots(moving, np.arange(4), 9).tolist() == [0, 1, 2, 3]
    assert restful_shots(moving.select((moving.view > 0) & (moving.view < 3)), np.arange(4), 1).tolist() == [1]


def test_lag_that_no_image_tells_is_known_to_three_images_of_an_ordinary_camera(filmed):
    """30 images a second; a mean of zero, as none is late by more than another before anything is seen."""
    cameras, views, times, _ = filmed
    seen = views.moving(times).observations
    boards = np.tile(np.eye(4), (SHOTS, 1, 1))
    model = RigModel(seen, BOARD.corners_m()[seen.corner], cameras, boards, [5] * 3, np.arange(3))
    mean, sigma = model.priors()
    assert mean[model.lag_columns].tolist() == [0, 0, 0]
    assert sigma[model.lag_columns] == pytest.approx(np.full(3, 3 / 30))


def test_the_derivative_by_times_is_that_of_differences(filmed):
    cameras, views, times, _ = filmed
    seen = views.moving(times).observations
    boards = np.stack([board_at(v / RATE_HZ) for v in range(SHOTS)])
    model = RigModel(seen, BOARD.corners_m()[seen.corner], cameras, boards, [5] * 3, np.arange(3))
    x = model.start()
    x[model.times_columns.start :] += np.random.default_rng(0).normal(0, 0.02, len(x) - model.times_columns.start)
    _, jacobian = model.residuals(x)
    for column in (model.times_columns.start + 5, model.times_columns.stop - 1, model.lag_columns.start + 1):
        step = np.zeros_like(x)
        step[column] = 1e-5
        difference = (model.residuals(x + step)[0] - model.residuals(x - step)[0]).ravel() / 2e-5
        position = int(np.searchsorted(model.free, column))
        assert jacobian[:, [position]].toarray().ravel() == pytest.approx(difference, abs=1e-5)
