"""A very small capture: complete, true to its own truth, and the same whatever the number of workers."""

import hashlib
import os

import cv2
import numpy as np
import OpenEXR
import pandas as pd
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import read_cameras
from pipeline.stages.synthesize_capture import run
from pipeline.synthesis.renderer_choice import tried_version
from tests.support.captures.synthesized import read_truth, synthesize

pytest.importorskip("mitsuba")

SETTINGS = SynthesizeCapture(
    cameras=2, lights=3, frames=2, frames_b=1, fully_lit_every=2, partial_lights_min=1, partial_lights_max=2,
    width=48, height=64, downsample_from_sensor=4, test_cameras=1, test_frames=0, uvs=False, scale_to_m=0.01,
    vertex_spacing_m=0.045, texture_size=64, spp=4, spp_fully_lit=4, supersampling=1,
    black_level=0.02, total_intensity=60.0,
    board_squares_x=4, board_squares_y=3, board_square_m=0.2, board_marker_m=0.15, board_poses=14,
    ball_positions=1, ball_cameras=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return synthesize(tmp_path_factory.mktemp("captures") / "small", SETTINGS)


@pytest.fixture(scope="module")
def truth(capture):
    return read_truth(capture, SETTINGS)


def image(capture, camera, frame):
    with OpenEXR.File(str(capture / f"images/{camera}/{frame:06d}.exr")) as file:
        return file.channels()["RGB"].pixels.astype(np.float32) - SETTINGS.black_level


def mask(capture, camera, frame):
    return cv2.imread(str(capture / f"masks/{camera}/{frame:06d}.png"), cv2.IMREAD_UNCHANGED)


def test_every_file_named_by_capture_yaml_exists(capture):
    manifest = yaml.safe_load((capture / "capture.yaml").read_text())
    assert manifest["format"] == "lightstage-capture/1"
    for camera in ("cam00", "cam01"):
        for frame in range(2):
            assert (capture / manifest["images"]["path"].format(camera=camera, frame=frame)).exists()
            assert (capture / manifest["masks"]["path"].format(camera=camera, frame=frame)).exists()
        calibration = manifest["calibration"]
        assert (capture / calibration["color"]["path"].format(camera=camera)).exists()
        assert (capture / calibration["lights"]["silhouette"].format(camera=camera, position=0)).exists()
        for light in ("L000", "L001", "L002"):
            path = calibration["lights"]["path"].format(camera=camera, position=0, light=light)
            sensor_image = cv2.imread(str(capture / path), cv2.IMREAD_UNCHANGED)
            assert sensor_image.shape == (256, 192) and sensor_image.dtype == np.uint8
    assert list((capture / "calibration/charuco").glob("*/*.jpg"))
    for key in ("cameras", "frames", "lights", "patterns", "keypoints_2d"):
        assert (capture / manifest[key]).exists()
    assert (capture / manifest["template"]["mesh"]).exists()
    frames = pd.read_csv(capture / "frames.csv")
    assert list(frames.segment) == ["a", "b"]
    patterns = pd.read_csv(capture / "patterns.csv")
    assert (patterns[patterns.frame == 0].light == ["L000", "L001", "L002"]).all()
    assert len(patterns[patterns.frame == 1]) in (1, 2)


def test_truth_projects_into_the_masks(capture, truth):
    cameras, tracking = truth
    for name, camera in cameras.items():
        for frame in range(2):
            subject = mask(capture, name, frame)
            assert set(np.unique(subject)) == {0, 255}
            pixels, _ = camera.project(tracking["vertices"][frame].astype(np.float64))
            rows, columns = np.nonzero(subject)
            # Coverage of half a pixel decides, so the mask's box and the vertices' box agree within a pixel.
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            np.testing.assert_allclose([columns.min(), rows.min()], low, atol=1.3)
            np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], high, atol=1.3)
            grown = cv2.dilate(subject, np.ones((3, 3), np.uint8))
            at = pixels.astype(int)
            assert (grown[at[:, 1], at[:, 0]] == 255).mean() > 0.99
            joints, _ = camera.project(tracking["joints"][frame].astype(np.float64))
            assert (grown[joints[:, 1].astype(int), joints[:, 0].astype(int)] == 255).mean() > 0.9


def test_background_is_dark_and_noisy_as_configured(capture):
    values = np.concatenate(
        [
            image(capture, camera, frame)[cv2.dilate(mask(capture, camera, frame), np.ones((9, 9), np.uint8)) == 0]
            for camera in ("cam00", "cam01")
            for frame in range(2)
        ]
    )
    # Half floats near the black level of 0.02 step by 1.5e-5, far below the noise.
    assert values.std() == pytest.approx(SETTINGS.read_noise, rel=5 / np.sqrt(2 * values.size))
    assert abs(values.mean()) < 5 * SETTINGS.read_noise / np.sqrt(values.size) + 1e-5


def test_the_subject_is_exposed_well(capture):
    fully_lit = [image(capture, camera, 0)[mask(capture, camera, 0) == 255] for camera in ("cam00", "cam01")]
    values = np.concatenate(fully_lit)
    assert 0.05 < values.mean() < 0.5
    assert (values >= SETTINGS.saturation - 1e-3).mean() < 0.02


def test_keypoints_are_projected_joints(capture, truth):
    cameras, tracking = truth
    table = pd.read_parquet(capture / "keypoints_2d.parquet")
    keypoints = pd.read_csv(capture / "template/keypoints.csv")
    assert list(table.columns) == ["frame", "camera", "keypoint", "x", "y", "confidence"]
    assert len(table) == 2 * 2 * len(keypoints)
    assert table.confidence.between(0, 1).all()
    errors = []
    for (frame, name), rows in table.groupby(["frame", "camera"]):
        joints, _ = cameras[name].project(tracking["joints"][frame].astype(np.float64))
        errors.append(np.linalg.norm(rows[["x", "y"]].to_numpy() - joints, axis=1))
    # The median length of a two-dimensional normal error is 1.18 deviations; hidden joints have more.
    assert np.median(np.concatenate(errors)) < 1.18 * 2 * SETTINGS.keypoint_noise_px


def test_survey_is_near_the_truth(capture):
    surveyed = pd.read_csv(capture / "lights.csv")
    true = pd.read_parquet(capture / "truth/lights.parquet")
    assert list(surveyed.light) == list(true.light)
    error = np.abs(surveyed[["x", "y", "z"]].to_numpy() - true[["x", "y", "z"]].to_numpy())
    assert 0 < error.max() < 5 * SETTINGS.survey_error_m


def test_chart_shows_its_patches_under_the_camera_response(capture):
    response = np.array(read_json(capture / "truth/color.json")["raw_from_true"]["cam00"])
    with OpenEXR.File(str(capture / "calibration/color_chart/cam00.exr")) as file:
        chart = file.channels()["RGB"].pixels.astype(np.float64) - SETTINGS.black_level
    patches = pd.read_csv(capture / "calibration/color_chart/chart.csv")[["r", "g", "b"]].to_numpy()
    for patch in (2, 10, 18, 19):  # blue sky, lime, white, grey
        expected = 0.9 * response @ patches[patch]
        close = np.abs(chart - expected).max(axis=2) < 0.05
        assert close.sum() > 10
        # Shot noise of 1e-2 at most, over tens of pixels.
        np.testing.assert_allclose(np.median(chart[close], axis=0), expected, atol=0.01)


def test_board_is_read_and_fits_the_true_lens(capture):
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    board = cv2.aruco.CharucoBoard((4, 3), SETTINGS.board_square_m, SETTINGS.board_marker_m, dictionary)
    cameras = read_cameras(capture / "truth/cameras.json")
    read = 0
    for path in sorted((capture / "calibration/charuco").glob("*/*.jpg")):
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(cv2.imread(str(path), 0))
        if ids is None or len(ids) < 6:
            continue
        read += 1
        camera, points = cameras[path.parent.name], np.array(board.getChessboardCorners())[ids.ravel()]
        _, turn, shift = cv2.solvePnP(points, corners, camera.opencv_K(), camera.dist)
        found, _ = cv2.projectPoints(points, turn, shift, camera.opencv_K(), camera.dist)
        # Four samples per pixel of a board with two-pixel modules: corners are read to some tenths of a pixel.
        assert np.sqrt(((found.reshape(-1, 2) - corners.reshape(-1, 2)) ** 2).sum(axis=1).mean()) < 0.5
    assert read >= 2


def test_workers_do_not_change_the_capture(capture, tmp_path):
    run(subject="small", out=tmp_path / "again", workers=2, settings=SETTINGS)

    def digests(root):
        files = [path for path in sorted(root.rglob("*")) if path.is_file()]
        return {path.relative_to(root): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

    assert digests(tmp_path / "again") == digests(capture)


def test_impossible_settings_are_named_at_once(tmp_path):
    settings = SETTINGS.model_copy(update={"partial_lights_max": 9, "ball_cameras": 3, "board_marker_m": 0.3})
    with pytest.raises(InputError) as error:
        run(subject="small", out=tmp_path / "never", settings=settings)
    for key in ("partial_lights_max", "ball_cameras", "board_marker_m"):
        assert key in str(error.value)
    assert not (tmp_path / "never").exists()


def test_vectorized_renderer_takes_the_same_images(capture, tmp_path):
    if not tried_version(dict(os.environ)):
        pytest.skip("no LLVM library")
    settings = SETTINGS.model_copy(update={"renderer": "llvm"})
    synthesize(tmp_path / "llvm", settings)
    assert read_json(tmp_path / "llvm/truth/renderer.json")["renderer"] == "llvm"
    assert read_json(capture / "truth/renderer.json")["renderer"] == "scalar"
    for name in ("keypoints_2d.parquet", "truth/tracking.safetensors", "calibration/color_chart/cam00.exr"):
        assert (tmp_path / "llvm" / name).read_bytes() == (capture / name).read_bytes()
    for camera in ("cam00", "cam01"):
        for frame in range(2):
            both = mask(capture, camera, frame) != mask(tmp_path / "llvm", camera, frame)
            # Four places in a pixel decide of the scalar renderer's edges: one in ten edge pixels may change sides.
            outline = cv2.morphologyEx(mask(capture, camera, frame), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
            assert both.sum() < 0.15 * (outline > 0).sum()
            inside = cv2.erode(mask(capture, camera, frame), np.ones((3, 3), np.uint8)) > 0
            pair = [image(root, camera, frame)[inside] for root in (capture, tmp_path / "llvm")]
            # Light is drawn by four paths a pixel: noise of half the value, over some hundred pixels.
            assert pair[1].mean() == pytest.approx(pair[0].mean(), rel=0.1)
            assert np.corrcoef(pair[0].ravel(), pair[1].ravel())[0, 1] > 0.7
