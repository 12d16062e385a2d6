"""Rigs of known cameras around known boards, whose corners are projected by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.spatial.transform

from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_start import start_rig, usable_views
from pipeline.geometry.cameras import Camera

SIZE = (640, 480)
BOARD = CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250")


def look_at(center, target, roll=0.0):
    forward = np.asarray(target, float) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [np.sin(roll), np.cos(roll), 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def planted_cameras(count, rng, arc=1.2 * np.pi):
    """Cameras on an arc (radians) around the origin, 2.5 m away."""
    cameras = []
    for c in range(count):
        angle = arc * c / count
        center = np.array([2.5 * np.sin(angle), 0.3 * rng.normal(), 2.5 * np.cos(angle)])
        R = look_at(center, rng.normal(0, 0.05, 3), rng.normal(0, 0.1))
        focal = rng.uniform(600, 800)
        K = np.array([[focal, 0, 320 + 6 * rng.normal()], [0, focal * 1.001, 240 + 6 * rng.normal()], [0, 0, 1]])
        dist = np.array([-0.1, 0.03, 5e-4, -5e-4, 0.0]) * rng.uniform(0.5, 1.5)
        cameras.append(Camera(R, -R @ center, K, dist, *SIZE))
    return cameras


def boards_in_stage(count, rng, tilt=0.5, arc=1.2 * np.pi):
    """Poses of the board near the origin, facing places on the arc, tilted at random."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for v in range(count):
        angle = arc * rng.uniform(-0.1, 0.9)
        facing = scipy.spatial.transform.Rotation.from_euler("YX", [angle, np.pi]).as_matrix()
        tilted = scipy.spatial.transform.Rotation.from_rotvec(tilt * rng.normal(size=3)).as_matrix()
        R = tilted @ facing
        poses[v, :3, :3] = R
        poses[v, :3, 3] = rng.uniform(-0.35, 0.35, 3) - R @ [0.42, 0.3, 0]
    return poses


def observe(cameras, boards, noise, rng):
    """Corners by cv2.projectPoints, of boards that face the camera within 65 degrees."""
    points, rows = BOARD.corners_m(), []
    for c, camera in enumerate(cameras):
        for v, pose in enumerate(boards):
            normal, toward = pose[:3, 2], pose[:3, 3] - camera.center
            if toward @ normal / np.linalg.norm(toward) < np.cos(np.radians(65)):
                continue
            world = points @ pose[:3, :3].T + pose[:3, 3]
            turn = cv2.Rodrigues(camera.R)[0]
            pixels = cv2.projectPoints(world, turn, camera.t, camera.opencv_K(), camera.dist)[0].reshape(-1, 2) + 0.5
            inside = ((pixels > 0) & (pixels < SIZE)).all(1)
            rows += [(c, v, k, *pixels[k]) for k in np.flatnonzero(inside)]
    table = np.array(rows, float).reshape(-1, 5)
    pixels = table[:, 3:] + rng.normal(0, noise, (len(table), 2))
    return Observations(*table[:, :3].astype(np.int64).T, pixels)


def without_small_views(observations):
    """The usable views, numbered anew, and their old numbers."""
    chosen = observations.select(usable_views(observations, BOARD.corners_m()))
    numbers, view = np.unique(chosen.view, return_inverse=True)
    return Observations(chosen.camera, view.astype(np.int64), chosen.corner, chosen.pixel), numbers


def solve(observations, count, distortion=5):
    """The adjusted rig and the numbers of its views."""
    chosen, numbers = without_small_views(observations)
    start = start_rig(chosen, BOARD.corners_m(), [SIZE] * count)
    return adjust_rig(chosen, BOARD.corners_m(), start.cameras, start.rig_from_board, distortion), numbers


def center_errors(found, true):
    """Found minus true centres [cameras, 3] in the axes of the found rig.

    The true ones are first laid over them by the best rigid motion.

    The found frame is that of the first view, whose own error would else count as every camera's.
    """
    a, b = (np.stack([camera.center for camera in cameras]) for cameras in (found, true))
    turn, _ = scipy.spatial.transform.Rotation.align_vectors(a - a.mean(0), b - b.mean(0))
    return a - a.mean(0) - turn.apply(b - b.mean(0))
