"""Recordings of a board that cannot be calibrated, or only just: each is told apart and named, or survives."""

from __future__ import annotations

import logging

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_json
from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import read_cameras
from pipeline.stages.calibrate_cameras import run
from tests.support.drawings.boards import BOARD, FOCAL, SIZE, K, camera_at, draw, pose, write_capture
from tests.support.rigs.cameras import boards_in_stage, center_errors, observe, planted_cameras, solve

TURNS = np.random.default_rng(2).uniform(-0.5, 0.5, (12, 3))
PLACES = np.random.default_rng(3).uniform([-0.15, -0.1, -0.1], [0.15, 0.1, 0.2], (12, 3))
BOARDS = [pose(turn, place) for turn, place in zip(TURNS, PLACES, strict=True)]
RIG = {"a": -18.0, "b": 0.0, "c": 18.0}
"""Angle of each camera on its arc, degrees."""


def record(views, rig=RIG, boards=BOARDS):
    """{(camera, view): image} of the views that each camera takes."""
    return {
        (name, v): draw(camera_at(rig[name]), [(BOARD, boards[v])]) for name, numbers in views.items() for v in numbers
    }


def calibrate(folder, images, settings=None, **options):
    # Good to a third of a per cent: corners of 0.1 px in images of 320 x 240.
    run(**write_capture(folder, images, **options), settings=settings or CalibrateCameras(distortion=0))
    return read_cameras(folder / "out/rig.json")


def refused(folder, images, **options):
    with pytest.raises(InputError) as caught:
        calibrate(folder, images, **options)
    assert not (folder / "out").exists()
    return str(caught.value)


def test_too_few_views(tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        message = refused(tmp_path, record({"a": range(6), "b": range(6), "c": range(2)}))
    assert "camera c: expected the board in at least 3 views, found 2; record more" in message
    # The others are judged all the same, and every camera has its line before the error.
    assert "camera a: good" in caplog.text
    assert "camera c: failed: 2 views of 3 needed" in caplog.text


def test_all_views_parallel(tmp_path, caplog):
    rng = np.random.default_rng(0)
    boards = [pose([0, 0, 0], rng.uniform([-0.1, -0.1, 0], [0.1, 0.1, 0])) for _ in range(8)]
    with caplog.at_level(logging.INFO):
        message = refused(tmp_path, record({"b": range(8)}, boards=boards))
    assert "camera b: expected a focal length known to 1 %" in message
    assert "all its views of the board are parallel (within" in message
    assert "metres" not in message  # the distance is as open as the focal length
    assert "camera b: failed" in caplog.text


def test_board_visible_to_one_camera_only(tmp_path):
    images = record({"a": range(6)})
    images |= {("b", v): np.full_like(images["a", v], 128) for v in range(6)}
    message = refused(tmp_path, images)
    assert "camera b: expected the board in at least 3 views, found 0" in message
    assert "found none in 6 images; no OpenCV dictionary matches either" in message


def test_cameras_that_never_see_the_board_at_once(tmp_path):
    message = refused(tmp_path, record({"a": range(5), "b": range(5, 10)}))
    assert "expected cameras joined by shared views, found (a); (b)" in message


def test_two_groups_are_both_named(tmp_path, caplog):
    rig = {"a": -18.0, "b": 0.0, "c": 18.0, "d": 10.0}
    with caplog.at_level(logging.INFO):
        message = refused(tmp_path, record({"a": range(5), "b": range(5), "c": range(5, 10), "d": range(5, 10)}, rig))
    assert "expected cameras joined by shared views, found (a, b); (c, d)" in message
    assert "camera d: failed: shares no view with (a, b)" in caplog.text


def test_wrong_dictionary(tmp_path):
    wrong = {**vars(BOARD), "dictionary": "DICT_6X6_100"}
    message = refused(tmp_path, record({"a": range(2)}), board_keys=wrong)
    assert "expected a board of DICT_6X6_100, found none in 2 images; its markers match DICT_5X5_50" in message


def test_wrong_first_marker(tmp_path):
    wrong = {"boards": [{**vars(BOARD), "first_marker": 100}]}
    message = refused(tmp_path, record({"a": range(2)}), board_keys=wrong)
    assert "its markers 0 to 16 are those of no board: check first_marker" in message


def test_mirrored_board(tmp_path):
    mirrored = {key: np.ascontiguousarray(image[:, ::-1]) for key, image in record({"a": range(3)}).items()}
    message = refused(tmp_path, mirrored)
    assert "flip the images, or print the board unmirrored" in message


def test_one_camera_that_mirrors_its_images(tmp_path):
    images = record({"a": range(5), "b": range(5)})
    images |= {("b", v): np.ascontiguousarray(images["b", v][:, ::-1]) for v in range(5)}
    message = refused(tmp_path, images)
    assert "camera b: expected the board in at least 3 views, found 0" in message
    assert "in their mirror images there are" in message


def test_one_camera_that_mirrors_its_video(tmp_path, caplog):
    """As a webcam's preview does: the other cameras are judged, the video is named with what to do."""
    images = record({"a": range(5), "b": range(5), "c": range(5)})
    files = write_capture(tmp_path, images)
    videos = {}
    for camera in RIG:
        videos[camera] = f"{camera}.avi"
        writer = cv2.VideoWriter(str(tmp_path / videos[camera]), cv2.VideoWriter_fourcc(*"FFV1"), 10, SIZE)
        for v in range(5):
            gray = images[camera, v][:, ::-1] if camera == "b" else images[camera, v]
            writer.write(np.repeat(gray[..., None], 3, 2))
        writer.release()
    path = tmp_path / "index/calibration_cameras.json"
    content = read_json(path)
    for entry in content["views"]:
        entry |= {"path": videos[entry["camera"]], "frame": entry["view"]}
    write_json(path, content)
    with caplog.at_level(logging.INFO), pytest.raises(InputError) as caught:
        run(**files, settings=CalibrateCameras(distortion=0))
    assert "camera b: expected the board in at least 3 views, found 0" in str(caught.value)
    assert "in their mirror images there are" in str(caught.value) and "flip the images" in str(caught.value)
    assert "camera a: good" in caplog.text and "camera c: good" in caplog.text


@pytest.mark.parametrize("turned_deg", [0.3, 8.0])
def test_a_camera_knocked_halfway_through(tmp_path, caplog, turned_deg):
    """2 px and 56 px: neither spoils the other cameras, and both are noticed, named and dated."""
    images = record(dict.fromkeys(RIG, range(12)))
    for v in range(7, 12):
        images["b", v] = draw(camera_at(RIG["b"], turned_deg=turned_deg), [(BOARD, BOARDS[v])])
    with caplog.at_level(logging.INFO):
        message = refused(tmp_path, images)
    assert "expected cameras that stand still, found b moved before view 7" in message
    assert "remove or record again the views before 7, or those from it on" in message
    assert "camera b: failed: b moved before view 7" in caplog.text
    assert "camera a: good" in caplog.text
    assert "camera c: good" in caplog.text


def test_of_two_cameras_either_may_have_been_knocked(tmp_path):
    images = record({"a": range(12), "b": range(12)})
    for v in range(5, 12):
        images["a", v] = draw(camera_at(RIG["a"], turned_deg=1.0), [(BOARD, BOARDS[v])])
    message = refused(tmp_path, images)
    assert "a or b moved before view 5" in message or "b or a moved before view 5" in message


def test_mixed_up_images_are_not_taken_for_a_movement(tmp_path, caplog):
    """Half of one camera's images under each other's numbers: no two poses of the camera explain them."""
    images = record(dict.fromkeys(RIG, range(12)))
    mixed = [1, 3, 4, 6, 8, 9, 11]
    right = {v: images["b", v] for v in mixed}
    images |= {("b", v): right[w] for v, w in zip(mixed, mixed[1:] + mixed[:1], strict=True)}
    with caplog.at_level(logging.INFO):
        message = refused(tmp_path, images)
    assert "camera b: expected views that fit together, found 7 of 12 views could not be brought together" in message
    assert "1, 3, 4, 6, 8" in message
    assert "look for images of another camera or shot" in message
    assert "moved before" not in message
    assert "camera a: good" in caplog.text


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000), ("cm", 100)])
def test_lengths_in_other_units_than_metres(tmp_path, unit, factor):
    wrong = {**vars(BOARD), "square_m": factor * BOARD.square_m, "marker_m": factor * BOARD.marker_m}
    message = refused(tmp_path, record(dict.fromkeys(RIG, range(5))), board_keys=wrong)
    assert "square_m: expected cameras within 50 m of the boards, found 1" in message
    assert "are square_m and marker_m in metres?" in message


def test_several_boards_each_on_its_own(case, tmp_path):
    """Two boards of one dictionary, moved apart from view to view, as on a cube that is turned in the hand."""
    small = [CharucoBoard(5, 4, 0.08, 0.06, "DICT_5X5_250", first_marker=first) for first in (0, 40)]
    images = {}
    for v in range(8):
        placed = [(small[0], pose(TURNS[v], [-0.22, 0, 0], small[0])), (small[1], pose(-TURNS[v], [0.22, 0, 0.1]))]
        placed[1] = (small[1], pose(-TURNS[v], [0.22, 0, 0.05], small[1]))
        for name, angle in RIG.items():
            images[name, v] = draw(camera_at(angle), placed)
    cameras = calibrate(tmp_path, images, board_keys={"boards": [vars(board) for board in small]})
    case.check(max(abs(camera.K[0, 0] / FOCAL - 1) for camera in cameras.values()), 5e-3)
    # Cameras 18 degrees apart at 1.3 m.
    apart = 2 * 1.3 * np.sin(np.radians(9))
    assert np.linalg.norm(cameras["a"].center - cameras["b"].center) == pytest.approx(apart, abs=3e-3)
    corners = read_table(tmp_path / "out/residuals_cameras.parquet")
    assert set(corners.board) == {0, 1}
    assert corners.corner.max() == 11  # counted on each board
    verdicts = pd.read_csv(tmp_path / "out/verdicts_cameras.csv")
    assert verdicts.grade.tolist() == ["weak"] * 3  # boards of 40 cm at 1.3 m: focal lengths to half a per cent
    assert verdicts.reason.str.startswith("its focal length is uncertain").all()


def test_pairs_that_share_two_or_three_views(case):
    """A chain: each camera sees two or three boards together with the next one, and none with any other."""
    cameras = planted_cameras(6, np.random.default_rng(0))
    boards = boards_in_stage(60, np.random.default_rng(1))
    seen = observe(cameras, boards, 0.1, np.random.default_rng(2))
    shared, keep = {}, np.zeros(len(seen.camera), bool)
    for view in np.unique(seen.view):
        for c in range(5):
            whole = [np.sum((seen.camera == k) & (seen.view == view)) == 24 for k in (c, c + 1)]
            if all(whole) and shared.get(c, 0) < 2 + c % 2:
                shared[c] = shared.get(c, 0) + 1
                keep |= np.isin(seen.camera, [c, c + 1]) & (seen.view == view)
                break
        else:  # a view for one camera alone, so that its lens is known
            c = int(view) % 6
            keep |= (seen.camera == c) & (seen.view == view)
    assert sorted(shared.values()) == [2, 2, 2, 3, 3]
    rig, _ = solve(seen.select(keep), 6)
    errors = np.linalg.norm(center_errors(rig.cameras, cameras), axis=1)
    assert np.all(errors < 4 * np.sqrt(3) * rig.center_sigma_m)
    # A chain over 2.5 m bends at each link by the pose of two or three views of 0.1 px: centimetres at its ends.
    case.check(errors.max(), 0.05, unit="m")


def test_views_partly_outside_the_image(case):
    """Every board is cut: no view has more than 16 of its 24 corners."""
    cameras, boards = planted_cameras(6, np.random.default_rng(7)), boards_in_stage(40, np.random.default_rng(8))
    seen = observe(cameras, boards, 0.1, np.random.default_rng(9))
    column = seen.corner % 6
    # Which side is cut differs from view to view and camera to camera.
    right = (seen.view + seen.camera) % 2 == 0
    cut = seen.select(np.where(right, column < 4, column > 2))
    rig, _ = solve(Observations(cut.camera, cut.view, cut.corner, cut.pixel), 6)
    errors = np.linalg.norm(center_errors(rig.cameras, cameras), axis=1)
    assert np.all(errors < 4 * np.sqrt(3) * rig.center_sigma_m)
    case.check(errors.max(), 5e-3, unit="m")
    assert rig.focal_sigma.max() < 2e-3


def refocused(image, zoom):
    """The image by a lens whose focal length is `zoom` times as long: larger about the principal point."""
    (cx, cy), shift = K[:2, 2] - 0.5, 1 - zoom
    enlarge = np.array([[zoom, 0, shift * cx], [0, zoom, shift * cy]])
    return cv2.warpAffine(image, enlarge, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def test_a_camera_refocused_halfway_through(tmp_path, caplog):
    """3 % longer from view 6 on: no single lens fits; the camera is named, and the others are as good as ever."""
    images = record(dict.fromkeys(RIG, range(12)))
    images |= {("b", v): refocused(images["b", v], 1.03) for v in range(6, 12)}
    with caplog.at_level(logging.INFO):
        message = refused(tmp_path, images)
    # A longer lens looks like one that came nearer: 3 % of 1.3 m.
    assert "b moved before view 6" in message
    assert "a lens that was refocused looks the same" in message
    assert "camera a: good" in caplog.text and "camera c: good" in caplog.text


def test_hot_pixels_in_all_images_of_a_camera(case, tmp_path):
    """One pixel in 500 at full scale, always the same: some lie on corners and on markers."""
    images = record(dict.fromkeys(RIG, range(12)))
    hot = np.random.default_rng(6).random(SIZE[::-1]) < 1 / 500
    images |= {("b", v): np.where(hot, np.uint8(255), images["b", v]) for v in range(12)}
    cameras = calibrate(tmp_path, images)
    assert set(pd.read_csv(tmp_path / "out/verdicts_cameras.csv").grade) == {"good"}
    case.check(abs(cameras["b"].K[0, 0] / FOCAL - 1), 5e-3)


def test_motion_blur_of_some_images(case, tmp_path):
    """5 px of 320 along the rows in a third of the images of one camera."""
    images = record(dict.fromkeys(RIG, range(12)))
    streak = np.full((1, 5), 1 / 5)
    images |= {("b", v): cv2.filter2D(images["b", v], -1, streak) for v in (1, 4, 7, 10)}
    cameras = calibrate(tmp_path, images)
    assert pd.read_csv(tmp_path / "out/verdicts_cameras.csv").grade.tolist() == ["good"] * 3
    case.check(abs(cameras["b"].K[0, 0] / FOCAL - 1), 5e-3)
