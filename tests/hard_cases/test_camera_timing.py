"""Cameras and boards that do not keep still, or not to the model: what is estimated, survives, or is named."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.cameras.board_views import BoardViews
from pipeline.calibration.cameras.rig_calibration import calibrate_rig
from pipeline.calibration.cameras.rig_inputs import Observations, RigPriors
from tests.support.rigs.cameras import BOARD, SIZE, boards_in_stage, center_errors, planted_cameras

SHOTS, NOISE_PX = 20, 0.05


def board_at(time_s):
    """A board that swings about the origin, at most 0.6 m/s."""
    angles = [0.3 * np.sin(1.3 * time_s), np.pi + 0.4 * np.sin(0.9 * time_s + 1), 0.3 * np.sin(1.7 * time_s)]
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("YXZ", angles).as_matrix()
    place = np.array([0.3 * np.sin(1.9 * time_s), 0.2 * np.sin(1.1 * time_s), 0.25 * np.sin(1.5 * time_s + 2)])
    pose[:3, 3] = place - pose[:3, :3] @ [0.42, 0.3, 0]
    return pose


def project(camera, points):
    turn = cv2.Rodrigues(camera.R)[0]
    return cv2.projectPoints(points, turn, camera.t, camera.opencv_K(), camera.dist)[0].reshape(-1, 2) + 0.5


def as_views(images):
    """From {(camera, view): pixels of all corners} to what the calibration takes; corners outside are left out."""
    random, rows = np.random.default_rng(1), []
    for (c, v), pixels in images.items():
        inside = ((pixels > 0) & (pixels < SIZE)).all(1)
        rows += [(c, v, k, *pixels[k]) for k in np.flatnonzero(inside)]
    table = np.array(rows, float)
    pixels = table[:, 3:] + random.normal(0, NOISE_PX, (len(table), 2))
    views = max(v for _, v in images) + 1
    observations = Observations(*table[:, :3].astype(np.int64).T, pixels)
    return BoardViews(observations, BOARD.corners_m(), np.arange(views), np.zeros(views, np.int64))


def film(cameras, moments, readout_s=0.0):
    """Images of the moving board; `moments[c, v]`: when each begins. Later rows are read later, up to `readout_s`."""
    images = {}
    for (c, v), start in np.ndenumerate(moments):
        corners, time = BOARD.corners_m(), np.full(len(BOARD.corners_m()), start)
        for _ in range(4 if readout_s else 1):
            poses = np.stack([board_at(t) for t in time])
            world = np.einsum("nij,nj->ni", poses[:, :3, :3], corners) + poses[:, :3, 3]
            pixels = project(cameras[c], world)
            time = start + readout_s * pixels[:, 1].clip(0, SIZE[1]) / SIZE[1]
        images[c, v] = pixels
    return as_views(images)


def calibrate(views, cameras, times=None):
    seen = views if times is None else views.moving(times)
    return calibrate_rig(
        seen.observations, seen.corners_m, [SIZE] * len(cameras), "auto", known=RigPriors(cameras, 0.0)
    ).rig


def largest_error_m(rig, cameras):
    return np.linalg.norm(center_errors(rig.cameras, cameras), axis=1).max()


def rms(rig):
    return np.sqrt((rig.residual**2).sum(1).mean())


@pytest.fixture(scope="module")
def cameras():
    return planted_cameras(3, np.random.default_rng(1), arc=0.6 * np.pi)


def test_one_camera_40_ms_late_at_a_variable_frame_rate(case, cameras):
    """Frames 60 to 160 ms apart, by a table of times that knows of no lag."""
    told = np.cumsum(np.random.default_rng(3).uniform(0.06, 0.16, SHOTS))
    late = np.array([0.0, 0.04, 0.0])
    views = film(cameras, told + late[:, None])
    times = {(c, v): float(told[v]) for c in range(3) for v in range(SHOTS)}
    rig = calibrate(views, cameras, times)
    lags = rig.parameters[rig.model.lag_columns]
    assert lags - lags.mean() == pytest.approx(late - late.mean(), abs=2e-3)
    at_once = calibrate(views, cameras)
    assert largest_error_m(at_once, cameras) > 10 * largest_error_m(rig, cameras)
    case.check(largest_error_m(rig, cameras), 1e-3, unit="m")
    case.naive_fails(largest_error_m(at_once, cameras))


def test_a_rolling_shutter_is_not_modelled_and_shows_in_the_residuals(case, cameras):
    """Rows read out over 20 ms: with times, each image's own lag takes all but the board's shear, 12 mm of 1.2 m."""
    told = np.arange(SHOTS) / 10
    views = film(cameras, np.tile(told, (3, 1)), readout_s=0.02)
    rig = calibrate(views, cameras, {(c, v): float(told[v]) for c in range(3) for v in range(SHOTS)})
    # Twice the noise. Error bars do not know of it: let the board rest.
    assert rms(rig) > 2 * np.sqrt(2) * NOISE_PX * 0.8
    case.check(largest_error_m(rig, cameras), 5e-3, unit="m")


def refracted(camera, pose, thickness_m, index=1.49):
    """Corners of a board under a pane that lies on it, by Snell's law: where the camera sees them."""
    points = BOARD.corners_m() @ pose[:3, :3].T + pose[:3, 3]
    normal = pose[:3, 2] * np.sign((camera.center - pose[:3, 3]) @ pose[:3, 2])
    height = (camera.center - points) @ normal
    foot = camera.center - points - height[:, None] * normal
    across = np.linalg.norm(foot, axis=1)
    low, high = np.zeros(len(points)), across
    for _ in range(60):  # Bisection: where the ray leaves the pane, along the foot's direction.
        out = (low + high) / 2
        inside, outside = (
            out / np.hypot(out, thickness_m),
            (across - out) / np.hypot(across - out, height - thickness_m),
        )
        further = index * inside < outside
        low, high = np.where(further, out, low), np.where(further, high, out)
    leaves = points + thickness_m * normal + (out / np.maximum(across, 1e-12))[:, None] * foot
    return project(camera, leaves)


def test_a_board_behind_glass_moves_each_pose_but_hardly_the_cameras(case, cameras):
    """5 mm of acrylic on the board: it seems 1.6 mm nearer and a little larger from the side."""
    poses = boards_in_stage(40, np.random.default_rng(5), tilt=0.3, arc=0.6 * np.pi)
    images = {}
    for c, camera in enumerate(cameras):
        for v, pose in enumerate(poses):
            toward = pose[:3, 3] - camera.center
            if toward @ pose[:3, 2] / np.linalg.norm(toward) > np.cos(np.radians(60)):
                images[c, v] = refracted(camera, pose, 5e-3)
    rig = calibrate(as_views(images), cameras)
    case.check(largest_error_m(rig, cameras), 5e-3, unit="m")
