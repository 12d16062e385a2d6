"""Cameras as our own files have them, against projections by OpenCV; keys and links of any format."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest

from pipeline.capture.cameras.known_cameras import digest_known_cameras
from pipeline.capture.schema.camera_schema import KnownCameras
from pipeline.geometry.cameras import Camera, write_cameras
from tests.support.rigs.camera_files import (
    CENTERS,
    POINTS,
    SAME_PX,
    SIZE,
    SIZES,
    looking_at_the_stage,
    model,
    read,
    write_model,
)


class TestCamerasJson:
    def test_cameras_come_as_they_are_but_in_metres(self, tmp_path):
        K = np.array([[500.0, 0, 310], [0, 510, 250], [0, 0, 1]])
        dist = np.array([-0.12, 0.05, 0.002, -0.003, 0.01])
        given = {}
        for name, center in CENTERS.items():
            R = looking_at_the_stage(center)
            given[name] = Camera(R, -R @ center * 1000, K, dist, *SIZE)
        write_cameras(tmp_path / "cameras.json", given | {"spare": given["cam00"]})
        cameras, complaints = read(tmp_path, path="cameras.json", scale_to_m=0.001)
        assert not complaints
        assert set(cameras) == set(SIZES)
        for name, center in CENTERS.items():
            turn, _ = cv2.Rodrigues(looking_at_the_stage(center))
            opencv_K = K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
            expected, _ = cv2.projectPoints(POINTS, turn, -looking_at_the_stage(center) @ center, opencv_K, dist)
            assert np.abs(cameras[name].project(POINTS)[0] - expected[:, 0] - 0.5).max() < SAME_PX

    def test_a_rotation_of_five_digits_is_made_one(self, tmp_path):
        R = looking_at_the_stage(CENTERS["cam00"])
        camera = Camera(R.round(5), -R.round(5) @ CENTERS["cam00"], np.diag([500.0, 500, 1]), np.zeros(5), *SIZE)
        write_cameras(tmp_path / "cameras.json", {"cam00": camera})
        cameras, complaints = read(tmp_path, {"cam00": SIZE}, path="cameras.json")
        assert not complaints
        R = cameras["cam00"].R
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
        assert cameras["cam00"].center == pytest.approx(CENTERS["cam00"], abs=1e-4)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"path": "sparse"}, "ends in .json"),
        ({"path": "sparse", "format": "nerfstudio"}, "ends in .json"),
        ({"path": "array.json", "format": "caliscope"}, "ends in .toml"),
        ({"path": "../sparse", "format": "colmap"}, "stays inside"),
        ({"path": "cameras.json", "frame": "world"}, "'stage' or 'own'"),
        ({"path": "cameras.json", "scale_to_m": 0.0}, "greater than 0"),
        (
            {"path": "cameras.json", "format": "bundler"},
            "'cameras_json', 'colmap', .* or 'auto'",
        ),
    ],
)
def test_keys_are_checked(keys, expected):
    with pytest.raises(ValueError, match=expected):
        KnownCameras.model_validate({"method": "known", **keys})


def test_a_link_out_of_the_capture_is_refused(tmp_path):
    write_model(tmp_path / "elsewhere", model())
    shutil.copytree(tmp_path / "elsewhere", tmp_path / "capture/sparse")
    (tmp_path / "capture/sparse/cameras.bin").unlink()
    (tmp_path / "capture/sparse/cameras.bin").symlink_to(tmp_path / "elsewhere/cameras.bin")
    section = KnownCameras(method="known", format="colmap", path="sparse")
    with pytest.raises(Exception, match="expected a file inside the capture folder"):
        digest_known_cameras(tmp_path / "capture", section)
