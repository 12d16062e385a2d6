"""The stage on drawn boards: what it refuses, what it says, and that known cameras pass."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_json, write_table
from pipeline.calibrate_cameras import run
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.geometry.charuco import Board

SIZE = (320, 240)
BOARD = Board(7, 5, 0.12, 0.09, "DICT_5X5_250")
FOCAL = 400.0
TILTS = [(0.5, 0.1, 0.0), (-0.4, 0.4, 0.1), (0.1, -0.5, -0.2), (0.3, 0.3, 0.4), (-0.3, -0.4, 0.2)]
BASELINE_M = 0.12


def draw_view(tilt, shift_m):
    """The board, tilted, before a camera that is moved sideways by `shift_m`; drawn by homography, 3 x 3 samples."""
    drawn = cv2.copyMakeBorder(BOARD.opencv().generateImage((560, 400)), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    R = cv2.Rodrigues(np.array(tilt))[0]
    t = np.array([-shift_m, 0.0, 1.3]) - R @ [0.42, 0.30, 0.0]
    K = 3 * np.array([[FOCAL, 0, 160], [0, FOCAL, 120], [0, 0, 1 / 3]])
    metres_from_drawn = np.array([[0.12 / 80, 0, -0.06], [0, 0.12 / 80, -0.06], [0, 0, 1]])
    to_centers = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    homography = K @ np.stack([R[:, 0], R[:, 1], t], 1) @ metres_from_drawn
    homography = to_centers @ homography @ np.linalg.inv(to_centers)
    fine = cv2.warpPerspective(drawn, homography, (3 * SIZE[0], 3 * SIZE[1]), borderValue=255)
    return fine.reshape(SIZE[1], 3, SIZE[0], 3).mean((1, 3)).round().astype(np.uint8)


def write_capture(folder, views, board=BOARD, size=SIZE):
    """`views`: {camera: [numbers]}; camera k is BASELINE_M to the side of camera k - 1."""
    entries = []
    for k, (camera, numbers) in enumerate(views.items()):
        for view in numbers:
            path = f"{camera}_{view}.png"
            if not (folder / path).exists():
                cv2.imwrite(str(folder / path), draw_view(TILTS[view % len(TILTS)], k * BASELINE_M))
            entries.append({"camera": camera, "view": view, "path": path, "digest": ""})
    sizes = {"width": 160, "height": 120, "sensor_width": size[0], "sensor_height": size[1]}
    write_table(folder / "index/cameras.parquet", pd.DataFrame([{"camera": name, **sizes} for name in views]))
    content = {"method": "charuco", **vars(board), "views": entries}
    write_json(folder / "index/calibration_cameras.json", content)
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}


def test_two_drawn_cameras(tmp_path):
    paths = write_capture(tmp_path, {"left": range(5), "right": range(5)})
    run(**paths, threads=2, settings=CalibrateCameras(distortion=0))
    cameras = read_cameras(tmp_path / "out/rig.json")
    # Corners to 0.1 px of 60 px per square, ten views: a few parts in a thousand.
    for camera in cameras.values():
        assert camera.K[0, 0] == pytest.approx(FOCAL, rel=5e-3)
        assert camera.K[:2, 2] == pytest.approx([160, 120], abs=2)
    baseline = np.linalg.norm(cameras["left"].center - cameras["right"].center)
    assert baseline == pytest.approx(BASELINE_M, abs=2e-3)
    residuals = read_table(tmp_path / "out/residuals_cameras.parquet")
    assert set(residuals.camera) == {"left", "right"}
    assert np.sqrt((residuals[["residual_x", "residual_y"]] ** 2).to_numpy().sum(1).mean()) < 0.2


def test_cameras_without_a_shared_view_are_named_in_groups(tmp_path):
    paths = write_capture(tmp_path, {"a": [0, 1, 2], "b": [0, 1, 2], "c": [7, 8, 9]})
    with pytest.raises(InputError, match=r"joined by shared views, found \(a, b\); \(c\)"):
        run(**paths)


def test_a_camera_with_too_few_views_is_named(tmp_path):
    paths = write_capture(tmp_path, {"a": [0, 1, 2], "b": [0, 1]})
    with pytest.raises(InputError, match="camera b: expected the board in at least 3 views, found 2"):
        run(**paths)


def test_the_wrong_dictionary_is_told_which_would_do(tmp_path):
    wrong = Board(7, 5, 0.12, 0.09, "DICT_6X6_100")
    paths = write_capture(tmp_path, {"a": [0]}, wrong)
    with pytest.raises(
        InputError, match=r"board of DICT_6X6_100, found none in 1 images; its markers match DICT_5X5_50"
    ):
        run(**paths)


def test_an_image_of_another_size_is_named(tmp_path):
    paths = write_capture(tmp_path, {"a": [0]}, size=(640, 480))
    with pytest.raises(InputError, match=r"a_0.png: size: expected the sensor's 640x480, found 320x240"):
        run(**paths)


def known(folder, size):
    paths = write_capture(folder, {"a": [], "b": []})
    camera = Camera(np.eye(3), np.zeros(3), np.diag([400.0, 400, 1]), np.zeros(5), *size)
    write_cameras(folder / "given.json", {"a": camera, "b": camera, "spare": camera})
    write_json(folder / "index/calibration_cameras.json", {"method": "known", "path": "given.json", "digest": ""})
    return paths


def test_known_cameras_pass(tmp_path):
    run(**known(tmp_path, SIZE))
    assert set(read_cameras(tmp_path / "out/rig.json")) == {"a", "b"}
    assert len(read_table(tmp_path / "out/residuals_cameras.parquet")) == 0


def test_known_cameras_of_another_size_are_refused(tmp_path):
    with pytest.raises(InputError, match="camera a: expected a camera of 320 x 240 sensor pixels, found 640 x 480"):
        run(**known(tmp_path, (640, 480)))
