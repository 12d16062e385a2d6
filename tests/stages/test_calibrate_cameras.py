"""The stage on drawn boards: what it writes and says. What it refuses: tests/hard_cases."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_json
from pipeline.calibration.cameras import board_search
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.stages.calibrate_cameras import run
from tests.support.drawings.boards import BOARD, FOCAL, SIZE, camera_at, draw, pose, write_capture

TILTS = [(0.5, 0.1, 0.0), (-0.4, 0.4, 0.1), (0.1, -0.5, -0.2), (0.3, 0.3, 0.4), (-0.3, -0.4, 0.2)]
RIG = {"left": 0.0, "right": 8.0}
BASELINE_M = 2 * 1.3 * np.sin(np.radians(4))


def record(views=range(5)):
    return {
        (name, v): draw(camera_at(angle), [(BOARD, pose(TILTS[v % 5], [0.0, 0.0, 0.0]))])
        for name, angle in RIG.items()
        for v in views
    }


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawn")
    run(**write_capture(folder, record()), threads=2, settings=CalibrateCameras(distortion=0))
    return folder / "out"


def test_two_drawn_cameras(calibrated):
    cameras = read_cameras(calibrated / "rig.json")
    # Corners to 0.1 px of 60 px per square, ten views: a few parts in a thousand.
    for camera in cameras.values():
        assert camera.K[0, 0] == pytest.approx(FOCAL, rel=5e-3)
        assert camera.K[:2, 2] == pytest.approx([160, 120], abs=2)
    baseline = np.linalg.norm(cameras["left"].center - cameras["right"].center)
    assert baseline == pytest.approx(BASELINE_M, abs=2e-3)


@pytest.mark.parametrize("use", ["known", "refine"])
def test_given_lenses_stay_or_are_refined(tmp_path, use):
    """Lenses that are 1.5 % too long, and no wider: refined ones are as good as those that boards alone tell."""
    wrong = 1.015 * FOCAL
    lens = Camera(np.eye(3), np.zeros(3), np.array([[wrong, 0, 160], [0, wrong, 120], [0, 0, 1.0]]), np.zeros(5), *SIZE)
    given = {"intrinsics": use, "lenses_from": {"format": "cameras_json", "path": "lenses.json"}}
    arguments = write_capture(tmp_path, record(), board_keys={**vars(BOARD), **given})
    write_cameras(tmp_path / "lenses.json", dict.fromkeys(RIG, lens))
    run(**arguments)
    cameras, quality = read_cameras(tmp_path / "out/rig.json"), read_table(tmp_path / "out/quality_cameras.parquet")
    for camera, sigma in zip(cameras.values(), quality.focal_sigma, strict=True):
        if use == "known":
            assert camera.K.tolist() == lens.K.tolist() and sigma == 0
        else:
            assert camera.K[0, 0] == pytest.approx(FOCAL, rel=5e-3)
            assert abs(camera.K[0, 0] / FOCAL - 1) < 4 * sigma < 0.01
    baseline = np.linalg.norm(cameras["left"].center - cameras["right"].center)
    # A lens that is 1.5 % too long has cameras farther away, and their distance with it.
    assert baseline == pytest.approx((1.015 if use == "known" else 1) * BASELINE_M, abs=2e-3)


def test_a_residual_for_every_corner(calibrated):
    residuals = read_table(calibrated / "residuals_cameras.parquet")
    columns = ["camera", "view", "board", "corner", "x", "y", "residual_x", "residual_y", "weight"]
    assert list(residuals.columns) == columns
    assert set(residuals.camera) == {"left", "right"}
    assert set(residuals.board) == {0}
    assert np.sqrt((residuals[["residual_x", "residual_y"]] ** 2).to_numpy().sum(1).mean()) < 0.2


def test_quality_and_verdict_of_every_camera(calibrated):
    quality = read_table(calibrated / "quality_cameras.parquet").set_index("camera")
    residuals = read_table(calibrated / "residuals_cameras.parquet")
    for name, row in quality.iterrows():
        mine = residuals[residuals.camera == name]
        assert row.views == 5
        assert row.corners == len(mine)
        assert row.rms_px == pytest.approx(np.sqrt((mine.residual_x**2 + mine.residual_y**2).mean()))
        cells = {(int(x / 40), int(y / 30)) for x, y in zip(mine.x, mine.y, strict=True)}
        assert row.coverage == pytest.approx(len(cells) / 64)
        # The two most different of the planted turns are 55 degrees apart.
        assert row.tilt_deg == pytest.approx(55, abs=6)
    verdicts = pd.read_csv(calibrated / "verdicts_cameras.csv")
    assert list(verdicts.columns) == ["kind", "name", "grade", "reason"]
    assert verdicts.name.tolist() == ["left", "right"]
    assert verdicts.reason.str.contains("5 views, ").all()


def test_fewer_views_on_request_are_evenly_spread(tmp_path, caplog):
    paths = write_capture(tmp_path, record(range(7)))
    with caplog.at_level(logging.INFO):
        run(**paths, settings=CalibrateCameras(distortion=0, most_views=4))
    residuals = read_table(tmp_path / "out/residuals_cameras.parquet")
    assert sorted(set(residuals.view)) == [0, 2, 4, 6]
    assert "camera left: weak: few views: 5 wanted" in caplog.text


def in_shares(arguments, count, **words):
    """The same arguments, and tables of so many shares of the images."""
    shares = arguments["out"].with_name("shares")
    for share in range(count):
        run(**{**arguments, "out": shares}, share=share, shares=count, **words)
    return {**arguments, "out": arguments["out"].with_name("joined")}, tuple(sorted(shares.iterdir(), reverse=True))


@pytest.mark.parametrize("printed", ["as declared", "inverted"])
@pytest.mark.parametrize("sizes", [[3, 3, 4], [0, *[1] * 10]])
def test_shares_of_the_images_give_the_same_bytes(tmp_path, monkeypatch, printed, sizes):
    """Also with more shares than cameras, and than images; and no image is read again."""
    images = record()
    arguments = write_capture(
        tmp_path, {k: 255 - gray if printed == "inverted" else gray for k, gray in images.items()}
    )
    words = {"settings": CalibrateCameras(distortion=0)}
    run(**arguments, **words)
    joined, tables = in_shares(arguments, len(sizes), **words)
    assert sorted(len(read_table(table)) for table in tables) == sizes
    monkeypatch.setattr(board_search, "read_view_gray", lambda *_: pytest.fail("read again"))
    run(**joined, **words, found=tables)
    for path in sorted(arguments["out"].iterdir()):
        assert path.read_bytes() == (joined["out"] / path.name).read_bytes(), path.name
    with pytest.raises(InputError, match=r"shares: expected tables of 10 images and 1 boards, each once"):
        run(**joined, **words, found=tables[:2])
    with pytest.raises(InputError, match=r"expected columns image, board, variant, .* found camera"):
        run(**joined, **words, found=(arguments["out"] / "residuals_cameras.parquet",))


def test_of_views_with_times_those_where_the_board_rests_are_used(tmp_path):
    """It rests for three images at a time and then jumps; jobs that share the cameras find the same."""
    images = {(name, v): image for (name, place), image in record().items() for v in range(3 * place, 3 * place + 3)}
    arguments = write_capture(tmp_path, images)
    path = tmp_path / "index/calibration_cameras.json"
    content = read_json(path)
    for entry in content["views"]:
        entry["time_s"] = 0.1 * entry["view"] + 0.02 * (entry["camera"] == "right")
    write_json(path, content)
    words = {"settings": CalibrateCameras(distortion=0, most_views=5)}
    run(**arguments, **words)
    residuals = read_table(tmp_path / "out/residuals_cameras.parquet")
    assert sorted(set(residuals.view)) == [0, 4, 7, 10, 13]
    cameras = read_cameras(tmp_path / "out/rig.json")
    baseline = np.linalg.norm(cameras["left"].center - cameras["right"].center)
    assert baseline == pytest.approx(BASELINE_M, abs=2e-3)
    joined, tables = in_shares(arguments, 2, **words)
    run(**joined, **words, found=tables)
    for written in sorted(arguments["out"].iterdir()):
        assert written.read_bytes() == (joined["out"] / written.name).read_bytes(), written.name


@pytest.mark.parametrize("images", [{("a", 0): "blank", ("b", 0): "blank"}, {("a", 0): "large", ("b", 0): "large"}])
def test_what_one_job_refuses_is_refused_in_the_same_words_where_shares_are_joined(tmp_path, images):
    """Shares of images without a board, or of another size, are no error by themselves."""
    grays = {"blank": np.full((240, 320), 200, np.uint8), "large": np.full((480, 640), 200, np.uint8)}
    arguments = write_capture(tmp_path, {key: grays[name] for key, name in images.items()})
    with pytest.raises(InputError) as alone:
        run(**arguments)
    joined, tables = in_shares(arguments, 2)
    with pytest.raises(InputError) as together:
        run(**joined, found=tables)
    assert str(together.value) == str(alone.value)


def test_an_image_of_another_size_is_named(tmp_path):
    paths = write_capture(tmp_path, record([0]), size=(640, 480))
    with pytest.raises(InputError, match=r"left_0.png: size: expected the sensor's 640x480, found 320x240"):
        run(**paths)


def known(folder, size):
    paths = write_capture(folder, {}, cameras=["a", "b"])
    camera = Camera(np.eye(3), np.zeros(3), np.diag([400.0, 400, 1]), np.zeros(5), *size)
    write_cameras(folder / "given.json", {"a": camera, "b": camera, "spare": camera})
    write_json(folder / "index/calibration_cameras.json", {"method": "known", "path": "given.json", "digest": ""})
    return paths


@pytest.mark.parametrize("asked", [{"share": 0, "shares": 2}, {"found": (Path("0000.parquet"),)}])
def test_shares_of_cameras_without_boards_are_refused(tmp_path, asked):
    with pytest.raises(InputError, match=r"json: method: expected one with boards .* found known; leave --share and"):
        run(**known(tmp_path, SIZE), **asked)
    assert not (tmp_path / "out").exists()


def test_known_cameras_pass(tmp_path):
    run(**known(tmp_path, SIZE))
    assert set(read_cameras(tmp_path / "out/rig.json")) == {"a", "b"}
    assert len(read_table(tmp_path / "out/residuals_cameras.parquet")) == 0


def test_known_cameras_of_another_size_are_refused(tmp_path):
    with pytest.raises(InputError, match="a: width x height: expected the sensor's 320 x 240, found 640 x 480"):
        run(**known(tmp_path, (640, 480)))
