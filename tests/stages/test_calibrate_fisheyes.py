"""The stage on boards drawn through fisheyes, ray by ray."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_table
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.lenses import FISHEYE
from pipeline.stages.calibrate_cameras import run
from tests.support.drawings.boards import BOARD, pose, write_capture
from tests.support.drawings.fisheyes import FOCAL, SIZE, TERMS, draw_fisheye

VIEWS = 14
BASELINE_M = 0.2
KEYS = {**vars(BOARD), "lens": "fisheye"}


def camera(side):
    """cam_from_world of two cameras side by side, looking the same way but for 6 degrees."""
    result = np.eye(4)
    result[:3, :3] = cv2.Rodrigues(np.radians([0.0, 3.0 * side, 0.0]))[0]
    result[:3, 3] = -result[:3, :3] @ [side * BASELINE_M / 2, 0, 0]
    return result


RIG = {"left": camera(-1), "right": camera(1)}


def board_poses():
    """Boards all around the cameras, up to 65 degrees aside, facing them more or less."""
    rng = np.random.default_rng(1)
    poses = []
    for v in range(VIEWS):
        aside, around = np.radians(65) * np.sqrt((v + 0.5) / VIEWS), 2.4 * v
        ray = np.array([np.sin(aside) * np.cos(around), np.sin(aside) * np.sin(around), np.cos(aside)])
        turn = cv2.Rodrigues(aside * np.array([-np.sin(around), np.cos(around), 0.0]))[0]
        tilted = cv2.Rodrigues(turn @ cv2.Rodrigues(rng.uniform(-0.45, 0.45, 3))[0])[0].ravel()
        poses.append(pose(tilted, rng.uniform(0.6, 0.8) * ray))
    return poses


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fisheyes")
    images = {
        (name, v): draw_fisheye(cam_from_world, [(BOARD, placed)])
        for v, placed in enumerate(board_poses())
        for name, cam_from_world in RIG.items()
    }
    run(**write_capture(folder, images, KEYS, SIZE), threads=2, settings=CalibrateCameras(least_views=3))
    return folder / "out"


def test_two_drawn_fisheyes(calibrated):
    cameras = read_cameras(calibrated / "rig.json")
    quality = read_table(calibrated / "quality_cameras.parquet").set_index("camera")
    assert quality.coverage.min() > 0.5
    for name, found in cameras.items():
        assert found.lens is FISHEYE
        assert found.K[0, 0] == pytest.approx(FOCAL, rel=5e-3)
        assert quality.rms_px[name] < 0.2
        # Where corners were, up to 70 degrees from the axis: every ray to a third of a pixel.
        angle, around = np.meshgrid(np.radians(np.arange(0, 71, 5)), np.linspace(0, 2 * np.pi, 13))
        radius = angle * (1 + sum(k * angle ** (2 * n) for n, k in enumerate(TERMS, 1)))
        direction = np.stack([np.cos(around), np.sin(around)], -1)
        pixels = FOCAL * radius[..., None] * direction + np.array(SIZE) / 2
        rays = np.concatenate([np.sin(angle)[..., None] * direction, np.cos(angle)[..., None]], -1)
        theirs = found.project(found.center + rays @ found.R)[0]
        # A turn of the camera is a shift of the middle of its image, which a lens alone does not tell from one.
        left = theirs - pixels
        assert np.abs(left - left.mean((0, 1))).max() < 0.35
    baseline = np.linalg.norm(cameras["left"].center - cameras["right"].center)
    assert baseline == pytest.approx(BASELINE_M, abs=1e-3)
    turn = np.degrees(np.linalg.norm(cv2.Rodrigues(cameras["left"].R @ cameras["right"].R.T)[0]))
    assert turn == pytest.approx(6.0, abs=0.2)


def test_number_of_coefficients_of_another_lens_is_refused(tmp_path):
    gray = np.full(SIZE[::-1], 128, np.uint8)
    paths = write_capture(tmp_path, {("a", 0): gray}, KEYS, SIZE)
    with pytest.raises(
        InputError, match="distortion: expected auto or one of 0, 1, 2, 4, found 5; set calibrate_cameras"
    ):
        run(**paths, settings=CalibrateCameras(distortion=5))
