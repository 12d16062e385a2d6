"""Errors planted in a ring of cameras and in lights."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera
from pipeline.metrics.output_errors import (
    GRID,
    align_rigs,
    camera_center_error_m,
    focal_error_percent,
    focus,
    light_error_in_rig_m,
    pixel_size_m,
    projection_error_px,
)

SUBJECT, DISTANCE_M, FOCAL_PX = np.array([0.3, 1.1, -0.2]), 2.5, 500.0


@pytest.fixture
def rig() -> dict[str, Camera]:
    """Eight cameras that look at SUBJECT from DISTANCE_M, at two heights."""
    cameras = {}
    for number, angle in enumerate(np.linspace(0, 2 * np.pi, 8, endpoint=False)):
        rise = 0.2 + 0.3 * (number % 2)
        back = np.array([np.cos(angle) * np.cos(rise), np.sin(rise), np.sin(angle) * np.cos(rise)])
        right = np.cross(back, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(-back, right), -back])
        K = np.array([[FOCAL_PX, 0, 240.0], [0, FOCAL_PX, 320.0], [0, 0, 1]])
        cameras[f"c{number}"] = Camera(R, -R @ (SUBJECT + DISTANCE_M * back), K, np.zeros(5), 480, 640)
    return cameras


def moved(rig: dict[str, Camera]) -> tuple[dict[str, Camera], np.ndarray, np.ndarray]:
    """The same rig in another frame, and rotation and translation into that frame."""
    R = cv2.Rodrigues(np.array([0.3, -1.2, 0.5]))[0]
    t = np.array([5.0, -2.0, 0.7])
    return {name: replace(c, R=c.R @ R.T, t=c.t - c.R @ R.T @ t) for name, c in rig.items()}, R, t


def test_frame_of_the_rig_is_no_error(rig) -> None:
    elsewhere, R, t = moved(rig)
    lights = np.random.default_rng(0).normal(size=(5, 3))
    assert camera_center_error_m(elsewhere, rig) < 1e-9
    assert projection_error_px(elsewhere, rig) < 1e-6
    assert focal_error_percent(elsewhere, rig) == 0
    assert light_error_in_rig_m(lights @ R.T + t, elsewhere, lights, rig) < 1e-9


def test_one_camera_out_of_place(rig) -> None:
    wrong, _, _ = moved(rig)
    camera = wrong["c3"]
    # The centre is -R^T t: 10 mm along the camera's x axis.
    wrong["c3"] = replace(camera, t=camera.t - np.array([0.01, 0, 0]))
    assert camera_center_error_m(wrong, rig) == pytest.approx(0.01 / np.sqrt(8), rel=1e-3)
    # 10 mm at 2.5 m and f = 500: points move by 2 px and, at the distance's sphere, a little more off the axis.
    assert projection_error_px(wrong, rig) == pytest.approx(2 / np.sqrt(8), rel=0.15)


def test_focal_lengths_two_per_cent_long(rig) -> None:
    wrong = {name: replace(c, K=c.K * np.array([[1.02], [1.02], [1.0]])) for name, c in rig.items()}
    for camera in wrong.values():
        camera.K[:2, 2] = [240.0, 320.0]
    assert focal_error_percent(wrong, rig) == pytest.approx(2.0)
    # A point moves from the centre by 2 % of its distance; the grid is uniform over 480 x 640 px.
    spread = (np.arange(GRID) + 0.5) / GRID - 0.5
    expected = 0.02 * np.sqrt(np.mean(spread**2) * (480**2 + 640**2))
    assert projection_error_px(wrong, rig) == pytest.approx(expected, rel=1e-6)


def test_forgotten_distortion(rig) -> None:
    true = {name: replace(c, dist=np.array([-0.1, 0.04, 1e-3, -5e-4, 0.01])) for name, c in rig.items()}
    camera = true["c0"]
    x, y = np.meshgrid((np.arange(GRID) + 0.5) / GRID * 480, (np.arange(GRID) + 0.5) / GRID * 640)
    pixels = np.stack([x.ravel(), y.ravel()], 1)
    # OpenCV: without distortion the same ray is seen where undistortPoints with P = K puts it.
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    straight = cv2.undistortPoints(pixels[:, None], camera.K, camera.dist, P=camera.K, criteria=criteria)[:, 0]
    expected = np.sqrt(((straight - pixels) ** 2).sum(1).mean())
    assert expected > 1
    assert projection_error_px(rig, true) == pytest.approx(expected, rel=1e-5)


def test_lights_off_by_a_millimetre(rig) -> None:
    elsewhere, R, t = moved(rig)
    lights = np.random.default_rng(1).normal(size=(6, 3))
    wrong = lights + np.array([0.0, 0.001, 0.0])
    assert light_error_in_rig_m(wrong @ R.T + t, elsewhere, lights, rig) == pytest.approx(0.001, rel=1e-6)


def test_only_cameras_of_both_count(rig) -> None:
    fewer = {name: rig[name] for name in ("c0", "c1", "c2", "c3")} | {"extra": rig["c4"]}
    assert camera_center_error_m(fewer, rig) < 1e-9


def test_too_few_cameras(rig) -> None:
    with pytest.raises(InputError, match="cameras to compare: found 2 in both"):
        align_rigs({name: rig[name] for name in ("c0", "c1")}, rig)
    with pytest.raises(InputError, match="found 0 in both"):
        align_rigs({"other": rig["c0"]}, rig)


def test_subject_and_pixel_size(rig) -> None:
    np.testing.assert_allclose(focus(rig), SUBJECT, atol=1e-9)
    assert pixel_size_m(rig) == pytest.approx(DISTANCE_M / FOCAL_PX)
