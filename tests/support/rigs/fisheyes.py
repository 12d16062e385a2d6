"""Rigs of known fisheye cameras around known boards, whose corners are projected by cv2.fisheye."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import FISHEYE
from tests.support.rigs.cameras import BOARD, SIZE, look_at

TERMS = np.array([-0.02, 0.015, -0.008, 0.001])


def planted_fisheyes(count, rng):
    """Cameras on an arc around the origin, 1.2 m away, whose images reach 80 degrees from the axis and more."""
    cameras = []
    for c in range(count):
        angle = np.pi * c / count
        center = np.array([1.2 * np.sin(angle), 0.15 * rng.normal(), 1.2 * np.cos(angle)])
        R = look_at(center, rng.normal(0, 0.05, 3), rng.normal(0, 0.1))
        focal = rng.uniform(200, 240)
        K = np.array([[focal, 0, 320 + 4 * rng.normal()], [0, focal * 1.001, 240 + 4 * rng.normal()], [0, 0, 1]])
        cameras.append(Camera(R, -R @ center, K, TERMS * rng.uniform(0.5, 1.5), *SIZE, FISHEYE))
    return cameras


def boards_around(cameras, count, rng):
    """Poses of the board before one camera after the other, all over its image, 0.5 to 0.9 m away, facing it."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for v in range(count):
        camera = cameras[v % len(cameras)]
        aside, around = np.radians(62) * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        ray = np.array([np.sin(aside) * np.cos(around), np.sin(aside) * np.sin(around), np.cos(aside)])
        middle = camera.center + rng.uniform(0.5, 0.9) * (camera.R.T @ ray)
        facing = look_at(camera.center, middle, rng.uniform(-1, 1)).T
        R = cv2.Rodrigues(0.35 * rng.normal(size=3))[0] @ facing
        poses[v, :3, :3] = R
        poses[v, :3, 3] = middle - R @ [0.42, 0.3, 0]
    return poses


def observe_fisheyes(cameras, boards, noise, rng):
    """Corners by cv2.fisheye.projectPoints, where the board faces the camera, is less than 88 degrees from its axis
    (where OpenCV's fisheye ends at 90) and in its image."""
    points, rows = BOARD.corners_m(), []
    for c, camera in enumerate(cameras):
        for v, pose in enumerate(boards):
            normal, toward = pose[:3, 2], pose[:3, 3] - camera.center
            if toward @ normal / np.linalg.norm(toward) < np.cos(np.radians(65)):
                continue
            in_camera = (points @ pose[:3, :3].T + pose[:3, 3]) @ camera.R.T + camera.t
            front = in_camera[:, 2] > np.linalg.norm(in_camera, axis=1) * np.cos(np.radians(88))
            if not front.any():
                continue
            pixels = np.full((len(points), 2), -1.0)
            pixels[front] = cv2.fisheye.projectPoints(
                in_camera[front][:, None], np.zeros(3), np.zeros(3), camera.opencv_K(), camera.dist
            )[0][:, 0] + 0.5  # fmt: skip
            inside = ((pixels > 0) & (pixels < SIZE)).all(1)
            rows += [(c, v, k, *pixels[k]) for k in np.flatnonzero(inside)]
    table = np.array(rows, float).reshape(-1, 5)
    pixels = table[:, 3:] + rng.normal(0, noise, (len(table), 2))
    return Observations(*table[:, :3].astype(np.int64).T, pixels)
