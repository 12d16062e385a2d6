"""Boards found again from residuals, against poses planted with OpenCV's projection."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import scipy.spatial.transform

from pipeline.figures.targets import locate_balls, locate_boards
from pipeline.geometry.cameras import Camera

DISTORTION = np.array([-0.12, 0.05, 0.001, -0.002, 0.0])


def cameras():
    found = {}
    for name, angle in (("east", 0.0), ("north", 0.8), ("west", -0.7)):
        R = scipy.spatial.transform.Rotation.from_euler("XY", [np.pi, angle]).as_matrix()
        K = np.array([[700.0, 0, 320], [0, 705, 240], [0, 0, 1]])
        found[name] = Camera(R, np.array([0.05, -0.02, 2.2]), K, DISTORTION, 640, 480)
    return found


def project(camera, points):
    return (
        cv2.projectPoints(points, cv2.Rodrigues(camera.R)[0], camera.t, camera.opencv_K(), camera.dist)[0][:, 0] + 0.5
    )


def test_boards_that_two_cameras_see_are_where_they_stood():
    rng = np.random.default_rng(0)
    flat = np.stack([*np.meshgrid(np.arange(4) * 0.1, np.arange(3) * 0.1), np.zeros((3, 4))], -1).reshape(-1, 3)
    planted, rows = {}, []
    seen_by = {
        (0, 0): ["east", "north"],
        (0, 1): ["north", "west"],
        (7, 0): ["east"],
        (9, 1): ["east", "north", "west"],
    }
    for (view, board), names in seen_by.items():
        turn = scipy.spatial.transform.Rotation.from_rotvec(rng.normal(0, 0.5, 3)).as_matrix()
        points = planted[view, board] = flat @ turn.T + rng.normal(0, 0.1, 3)
        for name in names:
            pixels = project(cameras()[name], points)
            noise = rng.normal(0, 0.3, pixels.shape)
            columns = (*(pixels + noise).T, *-noise.T)
            rows += [(name, view, board, k, *numbers) for k, numbers in enumerate(zip(*columns, strict=True))]
    names = ["camera", "view", "board", "corner", "x", "y", "residual_x", "residual_y"]
    table = pd.DataFrame(rows, columns=names).sample(frac=1, random_state=1, ignore_index=True)
    boards = locate_boards(table, cameras())
    expected = [planted[key] for key in ((0, 0), (0, 1), (9, 1))]
    assert len(boards) == len(expected)
    for found, true in zip(boards, expected, strict=True):
        assert np.abs(found - true).max() < 1e-6


def test_ball_is_in_the_middle_of_its_cone():
    """Outlines traced round a sphere by the rays that touch it: the circle at angle asin(r / d) about the axis."""
    center, radius = np.array([0.1, -0.2, 0.05]), 0.15
    outlines = {}
    for name, camera in cameras().items():
        toward = center - camera.center
        distance = np.linalg.norm(toward)
        basis = np.linalg.svd(toward[None])[2][1:]
        around = np.linspace(0, 2 * np.pi, 90, endpoint=False)
        rim = np.stack([np.cos(around), np.sin(around)], 1) @ basis * radius * np.sqrt(1 - (radius / distance) ** 2)
        outlines["top", name] = project(camera, center - toward * (radius / distance) ** 2 + rim)
    found = locate_balls(outlines, cameras(), radius)
    assert list(found) == ["top"]
    assert np.abs(found["top"] - center).max() < 1e-6
