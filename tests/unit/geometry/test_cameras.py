"""Cameras against OpenCV's projectPoints, and files that are not what they should be."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras

DISTORTION = np.array([-0.2, 0.05, 0.002, -0.001, 0.01])


def some_camera(seed: int = 0, dist: np.ndarray = DISTORTION) -> Camera:
    """A camera 3 m in front of the origin, turned by up to 20 degrees."""
    rng = np.random.default_rng(seed)
    R = cv2.Rodrigues(rng.uniform(-0.2, 0.2, 3))[0]
    K = np.array([[900.0, 0, 331], [0, 910, 402], [0, 0, 1]])
    return Camera(R, np.array([0.1, -0.2, 3.0]), K, dist, 640, 832)


def some_points(count: int = 200, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (count, 3))


def opencv_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """By OpenCV, whose first pixel centre is (0, 0): principal point half a pixel less, results half a pixel more."""
    K = camera.K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(camera.R)[0], camera.t, K, camera.dist)
    return pixels.reshape(-1, 2) + 0.5


@pytest.mark.parametrize("seed", range(4))
def test_project_agrees_with_opencv(seed: int) -> None:
    camera, points = some_camera(seed), some_points()
    pixels, depth = camera.project(points)
    # 1e-9 px: float64 rounding of 1e-16 times coordinates of 1e3, through the angle-axis vector that OpenCV takes.
    np.testing.assert_allclose(pixels, opencv_pixels(camera, points), atol=1e-9)
    np.testing.assert_allclose(depth, (camera.R @ points.T).T[:, 2] + camera.t[2], rtol=1e-14)


def test_derivatives_by_points_of_the_world_are_those_of_differences() -> None:
    camera, points, step = some_camera(), some_points(20), 1e-6
    pixels, by_point = camera.project_with_derivative(points)
    np.testing.assert_allclose(pixels, opencv_pixels(camera, points), atol=1e-9)
    for axis in range(3):
        ahead, behind = (opencv_pixels(camera, points + way * step * np.eye(3)[axis]) for way in (1, -1))
        # 1e-9 px of rounding over the step, of slopes of some hundred pixels a metre.
        np.testing.assert_allclose(by_point[:, :, axis], (ahead - behind) / (2 * step), atol=2e-3)


def test_opencv_K_is_half_a_pixel_less() -> None:
    camera = some_camera()
    np.testing.assert_array_equal(camera.opencv_K() - camera.K, [[0, 0, -0.5], [0, 0, -0.5], [0, 0, 0]])


def test_project_keeps_leading_axes_and_depths_behind() -> None:
    camera = some_camera()
    points = some_points(12).reshape(3, 4, 3)
    pixels, depth = camera.project(points)
    assert pixels.shape == (3, 4, 2)
    assert depth.shape == (3, 4)
    np.testing.assert_array_equal(pixels[1, 2], camera.project(points[1, 2])[0])
    assert camera.project(camera.center - camera.R[2])[1] == pytest.approx(-1)


def test_undistort_inverts_the_distortion() -> None:
    camera, points = some_camera(), some_points()
    in_camera = points @ camera.R.T + camera.t
    pixels, _ = camera.project(points)
    # 1e-9: OpenCV iterates to 1e-12 in normalised coordinates.
    np.testing.assert_allclose(camera.undistort(pixels), in_camera[:, :2] / in_camera[:, 2:], atol=1e-9)


def test_rays_start_at_the_centre_and_meet_the_points() -> None:
    camera, points = some_camera(), some_points()
    directions = camera.ray_directions(camera.project(points)[0])
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-14)
    expected = points - camera.center
    np.testing.assert_allclose(directions, expected / np.linalg.norm(expected, axis=1)[:, None], atol=1e-9)
    np.testing.assert_allclose(camera.R @ camera.center + camera.t, 0, atol=1e-14)


@given(factor=st.integers(1, 8), seed=st.integers(0, 100))
@settings(max_examples=25, deadline=None)
def test_downsampled_pixels_are_sensor_pixels_divided(factor: int, seed: int) -> None:
    camera, points = some_camera(seed), some_points(20)
    small = camera.downsampled(factor)
    np.testing.assert_allclose(small.project(points)[0] * factor, camera.project(points)[0], rtol=1e-13)
    assert (small.width, small.height) == (round(640 / factor), round(832 / factor))


def test_pixel_centre_of_a_downsampled_image_is_the_middle_of_its_block() -> None:
    """Averaging 4 x 4 sensor pixels: the first image pixel covers 0 to 4, so its centre lies at 2."""
    camera = some_camera(dist=np.zeros(5))
    ray_sensor = camera.ray_directions(np.array([[2.0, 2.0]]))
    ray_image = camera.downsampled(4).ray_directions(np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(ray_image, ray_sensor, atol=1e-14)


def test_files_keep_every_bit(tmp_path: Path) -> None:
    cameras = {"cam00": some_camera(3), "cam01": some_camera(4, np.zeros(5))}
    write_cameras(tmp_path / "cameras.json", cameras)
    read = read_cameras(tmp_path / "cameras.json")
    assert list(read) == ["cam00", "cam01"]
    for name, camera in cameras.items():
        for key in ("R", "t", "K", "dist"):
            np.testing.assert_array_equal(getattr(read[name], key), getattr(camera, key))
        assert (read[name].width, read[name].height) == (640, 832)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda entry: entry.pop("K"), r"camera a: K: expected \(3, 3\) finite numbers, found None"),
        (lambda entry: entry.update(t=[1, 2]), r"camera a: t: expected \(3,\)"),
        (lambda entry: entry.update(dist=[0, 0, 0, 0]), "camera a: dist"),
        (lambda entry: entry.update(R=[[1, 0], [1]]), "camera a: R"),
        (lambda entry: entry.update(R="identity"), "camera a: R"),
        (lambda entry: entry["t"].__setitem__(0, float("inf")), "camera a: t"),
        (lambda entry: entry.pop("width"), "camera a: width: expected a positive number of pixels, found None"),
        (lambda entry: entry.update(height=0), "camera a: height"),
        (
            lambda entry: entry.update(lens="fish"),
            "lens: expected one of brown_conrady, fisheye, found 'fish'",
        ),
        (lambda entry: entry.update(lens="fisheye"), r"camera a: dist: expected \(4,\)"),
    ],
)
def test_a_wrong_entry_is_named(change, words: str, tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    write_cameras(path, {"a": some_camera()})
    content = json.loads(path.read_text())
    change(content["cameras"]["a"])
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words):
        read_cameras(path)


@pytest.mark.parametrize(
    "content", ["{}", "[]", '{"cameras": {}}', '{"cameras": [1]}', '{"cameras": {"a": 3}}', "nonsense"]
)
def test_a_file_without_cameras_is_named(content: str, tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text(content)
    with pytest.raises(InputError, match=r"cameras\.json: "):
        read_cameras(tmp_path / "cameras.json")
