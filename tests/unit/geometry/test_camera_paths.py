"""Camera paths: where they look, what they pass through, how they turn."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.geometry.camera_paths import look_at, orbit, through_cameras, through_keyframes

CENTER = np.array([0.2, 1.0, -0.3])


def assert_proper(camera) -> None:
    np.testing.assert_allclose(camera.R @ camera.R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.R) == pytest.approx(1)


def test_look_at_agrees_with_opencv_about_where_things_are() -> None:
    camera = look_at(np.array([2.0, 1.5, 1.0]), CENTER, 40.0, 300, 200)
    assert_proper(camera)
    points = CENTER + np.array([[0, 0, 0], [0, 0.1, 0], [0.1, 0, 0]])
    seen = cv2.projectPoints(points, cv2.Rodrigues(camera.R)[0], camera.t, camera.K, None)[0][:, 0]
    np.testing.assert_allclose(seen[0], [150, 100], atol=1e-9)
    assert seen[1, 1] < 100  # up is up
    assert seen[1, 0] == pytest.approx(150, abs=1e-9)  # and upright
    assert seen[2, 0] > 150  # from +x and +z, the world's x goes to the right: not mirrored


def test_field_of_view_spans_the_height() -> None:
    camera = look_at(np.zeros(3), np.array([0, 0, -1.0]), 60.0, 100, 80)
    top = np.array([0.0, np.tan(np.radians(30)), -1.0])
    np.testing.assert_allclose(camera.project(top[None])[0][0], [50, 0], atol=1e-9)


@pytest.mark.parametrize("rise", [2.0, -2.0])
def test_straight_up_and_down_have_an_orientation(rise) -> None:
    assert_proper(look_at(CENTER + np.array([0, rise, 0]), CENTER, 40.0, 10, 10))


def test_orbit_keeps_its_distance_and_loops() -> None:
    cameras = orbit(CENTER, 2.0, 0.5, 1.0, 40.0, 64, 48, 8)
    offsets = np.stack([camera.center for camera in cameras]) - CENTER
    np.testing.assert_allclose(np.hypot(offsets[:, 0], offsets[:, 2]), 2.0)
    np.testing.assert_allclose(offsets[:, 1], 0.5)
    np.testing.assert_allclose(offsets[0], [0, 0.5, 2], atol=1e-12)
    np.testing.assert_allclose(offsets[2], [2, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(offsets[-1, 0], -np.sqrt(2), atol=1e-12)  # the next would be the first again
    for camera in cameras:
        np.testing.assert_allclose(camera.project(CENTER[None])[0][0], [32, 24], atol=1e-9)


def test_path_passes_through_calibrated_cameras_smoothly() -> None:
    knots = orbit(CENTER, 2.0, 0.5, 0.5, 40.0, 640, 480, 3)
    bent = [replace(camera, dist=np.array([0.1, 0, 0, 0, 0])) for camera in knots]
    path = through_cameras(bent, 240, 21)
    for knot, camera in zip(knots, path[::10], strict=True):
        np.testing.assert_allclose(camera.center, knot.center, atol=1e-9)
        np.testing.assert_allclose(camera.R, knot.R, atol=1e-9)
        np.testing.assert_allclose(camera.K, knot.downsampled(2).K, atol=1e-9)
    assert all((camera.width, camera.height) == (320, 240) and not camera.dist.any() for camera in path)
    for camera in path:
        assert_proper(camera)
    steps = np.linalg.norm(np.diff([camera.center for camera in path], axis=0), axis=1)
    assert steps.max() < 2.5 * steps.mean()
    assert len(through_cameras(bent[:1], 240, 4)) == 4


def keyframe_file(folder, keys):
    (folder / "keys.json").write_text(json.dumps({"keyframes": keys}))
    return folder / "keys.json"


def test_keyframes_are_met_and_held(tmp_path) -> None:
    keys = [
        {"picture": 2, "eye": [0, 0, 2], "target": [0, 0, 0], "fov_y_degrees": 30},
        {"picture": 4, "eye": [0, 0, 3], "target": [0, 0, 0], "fov_y_degrees": 50},
        {"picture": 6, "eye": [1, 0, 3], "target": [0, 0, 0], "fov_y_degrees": 50},
    ]
    path = through_keyframes(keyframe_file(tmp_path, keys), 40, 30, 9)
    centers = np.stack([camera.center for camera in path])
    np.testing.assert_allclose(centers[[0, 1, 2]], [[0, 0, 2]] * 3, atol=1e-12)
    np.testing.assert_allclose(centers[[4, 6, 8]], [[0, 0, 3], [1, 0, 3], [1, 0, 3]], atol=1e-12)
    assert 2 < centers[3, 2] < 3
    assert path[4].K[1, 1] == pytest.approx(15 / np.tan(np.radians(25)))


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ([], "keyframes"),
        ([{"picture": 0, "eye": [0, 0], "target": [0, 0, 0]}], "eye"),
        ([{"picture": 0, "eye": [0, 0, 0], "target": [0, 0, 0]}], "away from the eye"),
        ([{"picture": p, "eye": [0, 0, 1], "target": [0, 0, 0]} for p in (3, 1)], "rising"),
    ],
)
def test_wrong_keyframes_are_said(tmp_path, keys, said) -> None:
    with pytest.raises(InputError, match=said):
        through_keyframes(keyframe_file(tmp_path, keys), 40, 30, 3)
