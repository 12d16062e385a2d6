"""The stage on photographs of real rigs: an inverted board, images not taken at once, a checkerboard, no board."""

from __future__ import annotations

import itertools
import logging

import numpy as np
import pytest

from benchmarks.bench_photographed_rigs import angle_deg
from benchmarks.feature_rigs import prepare_stereo_pair
from benchmarks.photographed_rigs import (
    caliscope_cameras,
    opencv_left_focal,
    prepare_caliscope,
    prepare_checkerboard,
)
from pipeline.base.errors import InputError
from pipeline.base.files import read_table
from pipeline.calibration.cameras import board_calibration
from pipeline.calibration.cameras.board_search import find_boards
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.stages.calibrate_cameras import run
from tests.support.shared_data import shared_data

CALISCOPE, needs_caliscope = shared_data("data/rig_caliscope")
SAMPLES, needs_samples = shared_data("data/calib_opencv_chessboard")


@pytest.fixture(scope="module", autouse=True)
def boards_found_once():
    """Looks for the boards of a folder's images once: that takes longer than all else, and times do not change it."""
    found = {}

    def find_once(capture, views, *rest):
        images = tuple((view["path"], view.get("frame")) for view in views)
        if images not in found:
            found[images] = find_boards(capture, views, *rest)
        return found[images]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(board_calibration, "find_boards", find_once)
        yield


def quality_of(arguments):
    return read_table(arguments["out"] / "quality_cameras.parquet").set_index("camera")


@needs_caliscope
def test_four_webcams_and_an_inverted_board_that_moves(tmp_path, caplog):
    arguments = prepare_caliscope(CALISCOPE, tmp_path, "known")
    with caplog.at_level(logging.INFO):
        run(**arguments, threads=2)
    assert "declared 4 x 5 squares, DICT_4X4_1000; found: 4 x 5 squares, DICT_4X4_1000, inverted" in caplog.text
    assert "single images are off by" in caplog.text
    authors, cameras = caliscope_cameras(CALISCOPE), read_cameras(arguments["out"] / "rig.json")
    for a, b in itertools.combinations(authors, 2):
        theirs = np.linalg.norm(authors[a].center - authors[b].center)
        # The authors took the images for simultaneous, which costs them about a per cent.
        assert np.linalg.norm(cameras[a].center - cameras[b].center) == pytest.approx(theirs, rel=0.03)
        assert angle_deg(cameras[a], cameras[b], authors[a], authors[b]) < 2.5
    for name, camera in cameras.items():
        assert pytest.approx(authors[name].K) == camera.K
    # Theirs are 0.33 to 0.54 px.
    assert quality_of(arguments).rms_px.max() < 0.4


@needs_caliscope
def test_lenses_of_the_webcams_are_refined(tmp_path):
    arguments = prepare_caliscope(CALISCOPE, tmp_path, "refine")
    run(**arguments, threads=2)
    authors, cameras = caliscope_cameras(CALISCOPE), read_cameras(arguments["out"] / "rig.json")
    quality = quality_of(arguments)
    for name, camera in cameras.items():
        assert camera.K[0, 0] == pytest.approx(authors[name].K[0, 0], rel=0.015)
        assert abs(camera.K[0, 0] / authors[name].K[0, 0] - 1) < 4 * quality.focal_sigma[name]
    for a, b in itertools.combinations(authors, 2):
        theirs = np.linalg.norm(authors[a].center - authors[b].center)
        assert np.linalg.norm(cameras[a].center - cameras[b].center) == pytest.approx(theirs, rel=0.03)
    # With the authors' lenses as they are, 0.31, 0.23, 0.27 and 0.38 px.
    assert (quality.rms_px < [0.29, 0.24, 0.27, 0.37]).all()


@needs_caliscope
def test_the_same_images_taken_for_simultaneous_are_refused(tmp_path):
    arguments = prepare_caliscope(CALISCOPE, tmp_path, "known", times=False)
    with pytest.raises(InputError, match="expected cameras that stand still"):
        run(**arguments, threads=2)


@needs_samples
def test_a_stereo_pair_and_a_checkerboard(tmp_path):
    arguments = prepare_checkerboard(SAMPLES, tmp_path)
    run(**arguments, threads=2)
    cameras, quality = read_cameras(arguments["out"] / "rig.json"), quality_of(arguments)
    left, right = cameras["left"], cameras["right"]
    # 0.5 %: as far apart as the same photographs' two published fits, 535.9 and 533.0.
    assert left.K[0, 0] == pytest.approx(opencv_left_focal(SAMPLES), rel=5e-3)
    # 83.6 mm by cv2.stereoCalibrate on the same photographs.
    assert np.linalg.norm(left.center - right.center) == pytest.approx(0.0836, abs=5e-4)
    # 0.41 px by cv2.calibrateCamera.
    assert quality.rms_px.max() < 0.41
    assert quality.views.min() >= 12


@needs_samples
def test_a_stereo_pair_without_its_checkerboard(tmp_path):
    """Its features, with the lenses and the baseline that the boards give: turn and direction are theirs."""
    boards = prepare_checkerboard(SAMPLES, tmp_path / "boards")
    run(**boards, threads=2)
    true = read_cameras(boards["out"] / "rig.json")
    baseline = float(np.linalg.norm(true["left"].center - true["right"].center))
    arguments = prepare_stereo_pair(SAMPLES, tmp_path / "features", true, baseline, "known")
    run(**arguments, threads=2)
    cameras = read_cameras(arguments["out"] / "rig.json")
    (pair,) = read_table(arguments["out"] / "pairs_cameras.parquet").itertuples()
    bars = np.hypot(pair.turn_sigma_deg, read_table(boards["out"] / "pairs_cameras.parquet").turn_sigma_deg[0])
    # Three normal numbers, whose root mean square is below 3 but once in 10^4.
    assert angle_deg(cameras["left"], cameras["right"], true["left"], true["right"]) < 3 * np.sqrt(3) * bars
    assert len(read_table(arguments["out"] / "residuals_cameras.parquet")) > 2000


@needs_samples
def test_a_stereo_pair_whose_lenses_nothing_tells_is_refused_for_them(tmp_path):
    unused = Camera(np.eye(3), np.zeros(3), np.eye(3), np.zeros(5), 640, 480)
    arguments = prepare_stereo_pair(SAMPLES, tmp_path, {"left": unused, "right": unused}, 0.0832, "estimate")
    with pytest.raises(InputError, match="its focal length is uncertain: give it"):
        run(**arguments, threads=2)
