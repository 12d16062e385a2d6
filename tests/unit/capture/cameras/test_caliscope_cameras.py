"""Cameras of caliscope's files against projections by OpenCV."""

from __future__ import annotations

import tomllib

import cv2
import numpy as np
import pytest

from tests.support.rigs.camera_files import CENTERS, POINTS, SAME_PX, SIZE, looking_at_the_stage, read
from tests.support.shared_data import shared_data

RIG, with_rig = shared_data("data/rig_caliscope")

K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
TERMS = {False: [-0.12, 0.05, 0.002, -0.003, 0.01], True: [-0.04, 0.01, -0.004, 0.0006]}
NAMES = {"0": "cam00", "1": "cam01"}
SIZES = {"cam_0": SIZE, "cam_1": SIZE}


def section(header, center, fisheye=False, matrix=False, extra=""):
    R = looking_at_the_stage(center)
    rotation = R.tolist() if matrix else cv2.Rodrigues(R)[0][:, 0].tolist()
    return (
        f"[{header}]\nsize = [{SIZE[0]}, {SIZE[1]}]\nmatrix = {K.tolist()}\ndistortions = {TERMS[fisheye]}\n"
        f"rotation = {rotation}\ntranslation = {(-R @ center).tolist()}\nfisheye = {str(fisheye).lower()}\n{extra}\n"
    )


def read_text(folder, text, sizes=SIZES):
    (folder / "array.toml").write_text(text)
    return read(folder, sizes, format="caliscope", path="array.toml")


def opencv_pixels(entry, points=POINTS):
    """Pixels whose first centre is (0, 0)."""
    turn = np.array(entry["rotation"])
    turn = cv2.Rodrigues(turn)[0] if turn.shape == (3, 3) else turn
    project = cv2.fisheye.projectPoints if entry.get("fisheye") else cv2.projectPoints
    arguments = [np.array(entry["matrix"]), np.array(entry["distortions"])]
    return project(points[:, None], turn.reshape(3, 1), np.array(entry["translation"]), *arguments)[0].reshape(-1, 2)


@pytest.mark.parametrize("layout", ["cameras.{}", "cam_{}"])
@pytest.mark.parametrize("fisheye", [False, True])
@pytest.mark.parametrize("matrix", [False, True])
def test_projections_are_opencvs(tmp_path, layout, fisheye, matrix):
    text = "".join(section(layout.format(key), CENTERS[name], fisheye, matrix) for key, name in NAMES.items())
    cameras, complaints = read_text(tmp_path, text)
    assert not complaints
    content = tomllib.loads(text)
    for key, name in NAMES.items():
        entry = content["cameras"][key] if "cameras" in content else content[f"cam_{key}"]
        pixels, _ = cameras[f"cam_{key}"].project(POINTS)
        assert np.abs(pixels - opencv_pixels(entry) - 0.5).max() < SAME_PX
        assert cameras[f"cam_{key}"].center == pytest.approx(CENTERS[name], abs=1e-6)


@pytest.mark.parametrize(
    ("extra", "expected"),
    [
        ("rotation_count = 1", "camera 0: rotation_count: expected 0, found 1; calibrate without"),
        ("", "cam_1: expected a section of this name, found none; cameras of the file"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, extra, expected):
    text = section("cameras.0", CENTERS["cam00"], extra=extra) + section("cameras.7", CENTERS["cam01"])
    _, complaints = read_text(tmp_path, text)
    assert expected in complaints
    assert "named after: 7; name the capture's cameras" in complaints


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("0.0006]", "0.0006, 0.1]"), "distortions: expected 4 finite numbers"),
        (("size = [640", "size = [320"), "width x height: expected the sensor's 640 x 480, found 320 x 480"),
        (("translation", "place"), "translation: expected 3 finite numbers, found none"),
        (("[cameras.0]", "[other]"), "cameras: expected sections cameras.0"),
        (("[cameras.0]", "[cameras.0"), "expected a TOML file"),
    ],
)
def test_faults_are_named(tmp_path, change, expected):
    text = section("cameras.0", CENTERS["cam00"], fisheye=True).replace(*change)
    assert expected in read_text(tmp_path, text, {"0": SIZE})[1]


@with_rig
@pytest.mark.parametrize("file", ["camera_array.toml", "config.toml"])
def test_recorded_rig_projects_as_its_authors_cameras(file):
    cameras, complaints = read(RIG, {f"cam_{k}": (1280, 720) for k in range(4)}, format="caliscope", path=file)
    assert not complaints
    for key, entry in tomllib.loads((RIG / "camera_array.toml").read_text())["cameras"].items():
        camera = cameras[f"cam_{key}"]
        points = camera.center + 0.8 * camera.R[2] + 0.2 * (POINTS - [0, 1, 0])
        assert np.abs(camera.project(points)[0] - opencv_pixels(entry, points) - 0.5).max() < SAME_PX
