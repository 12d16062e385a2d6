"""Cameras of OpenCV's FileStorage, as its programs write them, against projections by OpenCV."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest

from pipeline.base.errors import Complaints
from pipeline.capture.cameras.known_cameras import read_known_lenses
from pipeline.capture.schema.camera_schema import CameraFile
from tests.support.rigs.camera_files import CENTERS, POINTS, SAME_PX, SIZE, SIZES, looking_at_the_stage, read
from tests.support.shared_data import shared_data

BOARDS, with_boards = shared_data("data/calib_opencv_chessboard")

K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
DIST = {False: np.array([-0.12, 0.05, 0.002, -0.003, 0.01]), True: np.array([-0.04, 0.01, -0.004, 0.0006])}

FLOAT_PX = 1e-3
"""ccalib keeps poses in float32: 6e-8 of the rotation and of 3 m, each 9 times over in 500 pixels."""


def pose(name):
    R = looking_at_the_stage(CENTERS[name])
    return R, -R @ CENTERS[name]


def write(file, **entries):
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    for key, value in entries.items():
        storage.write(key, value)
    storage.release()


def opencv_pixels(name, fisheye=False):
    R, t = pose(name)
    if fisheye:
        turn = cv2.Rodrigues(R)[0]
        return cv2.fisheye.projectPoints(POINTS[:, None], turn, t, K, DIST[True])[0][:, 0] + 0.5
    return cv2.projectPoints(POINTS, cv2.Rodrigues(R)[0], t, K, DIST[False])[0][:, 0] + 0.5


def multiview(**changes):
    """As saveToFile of apps/multiview-calibration writes two cameras, of which the second is a fisheye."""
    poses = [pose(name) for name in CENTERS]
    entries = {
        "Rs": np.array([R for R, _ in poses]), "Ts": np.array([t[:, None] for _, t in poses]),
        "Ks": np.array([K, K]), "distortions": np.concatenate([DIST[False], DIST[True]]),
        "models": np.array([0, 1]), "image_sizes": np.array([SIZE, SIZE]), "cam_ids": list(CENTERS),
        "rvecs0": np.zeros((7, 3, 1)), "errors_per_frame": np.zeros((2, 7)),
    }  # fmt: skip
    return {key: value for key, value in (entries | changes).items() if value is not None}


def ccalib(**changes):
    """As MultiCameraCalibration::writeParameters writes them, in float32."""
    entries = {"nCameras": 2}
    for k, name in enumerate(CENTERS):
        matrix = np.eye(4)
        matrix[:3] = np.concatenate([pose(name)[0], pose(name)[1][:, None]], 1)
        entries |= {f"camera_matrix_{k}": K.astype(np.float32), f"camera_pose_{k}": matrix.astype(np.float32),
                    f"camera_distortion_{k}": DIST[False][None, :4].astype(np.float32)}  # fmt: skip
    return entries | {"meanReprojectError": 0.2, "pose_timestamp_0": np.eye(4)} | changes


def single(name, fisheye=False, **changes):
    """As samples/cpp/calibration.cpp writes one camera, and a pose."""
    R, t = pose(name)
    entries = {
        "nframes": 13, "image_width": 640, "image_height": 480, "flags": 2, "fisheye_model": int(fisheye),
        "camera_matrix": K, "distortion_coefficients": DIST[fisheye][:, None], "R": R, "T": t,
    }  # fmt: skip
    return {key: value for key, value in (entries | changes).items() if value is not None}


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize("vectors", [False, True])
def test_multiview_application(tmp_path, suffix, vectors):
    turns = np.array([cv2.Rodrigues(pose(name)[0])[0] for name in CENTERS]) if vectors else multiview()["Rs"]
    write(tmp_path / f"rig.{suffix}", **multiview(Rs=turns))
    cameras, complaints = read(tmp_path, format="opencv", path=f"rig.{suffix}")
    assert not complaints
    for name in CENTERS:
        expected = opencv_pixels(name, name == "cam01")
        assert np.abs(cameras[name].project(POINTS)[0] - expected).max() < SAME_PX


def test_multi_camera_calibration_of_ccalib(tmp_path):
    write(tmp_path / "rig.xml", **ccalib())
    cameras, complaints = read(tmp_path, {"0": SIZE, "cam_1": SIZE}, format="auto", path="rig.xml")
    assert not complaints
    for key, name in zip(("0", "cam_1"), CENTERS, strict=True):
        R, t = pose(name)
        expected = cv2.projectPoints(POINTS, cv2.Rodrigues(R)[0], t, K, DIST[False][:4])[0][:, 0] + 0.5
        assert np.abs(cameras[key].project(POINTS)[0] - expected).max() < FLOAT_PX


@pytest.mark.parametrize("fisheye", [False, True])
@pytest.mark.parametrize("vector", [False, True])
def test_a_folder_of_a_file_per_camera(tmp_path, fisheye, vector):
    for name, suffix in zip(CENTERS, ("yml", "xml"), strict=True):
        turn = {"R": cv2.Rodrigues(pose(name)[0])[0]} if vector else {}
        (tmp_path / "rig").mkdir(exist_ok=True)
        write(tmp_path / f"rig/{name}.{suffix}", **single(name, fisheye, **turn))
    cameras, complaints = read(tmp_path, format="auto", path="rig")
    assert not complaints
    for name in CENTERS:
        assert np.abs(cameras[name].project(POINTS)[0] - opencv_pixels(name, fisheye)).max() < SAME_PX


def folder_of(tmp_path, entries):
    (tmp_path / "rig").mkdir()
    for name in CENTERS:
        write(tmp_path / f"rig/{name}.yml", **(entries if name == "cam00" else single(name)))
    return read(tmp_path, format="opencv", path="rig")[1]


FOLDER_BREAKS = {
    "no pose": (single("cam00", R=None, T=None), "cam00: expected a pose, R and T, found a lens alone; add it, or"),
    "half a pose": (single("cam00", T=None), "camera cam00.yml: T: expected 3 finite numbers, found none"),
    "other size": (single("cam00", image_width=700), "cam00: width x height: expected the sensor's"),
    "K of another size": (single("cam00", camera_matrix=K / [[2], [2], [1]]), "camera cam00.yml: camera_matrix: expec"),
    "NaN": (single("cam00", T=np.array([0, np.nan, 1])), "T: expected 3 finite numbers, found [0.0, nan"),
    "no lens": (single("cam00", camera_matrix=None), "camera_matrix: expected this key, found nframes"),
    "tilted": (
        single("cam00", distortion_coefficients=np.array([0.0] * 12 + [0.1, 0])),
        "distortion: expected k1, k2, p1, p2 and k3 only, found tauX of 0.1; undistort the images",
    ),
    "four terms of a fisheye": (
        single("cam00", fisheye_model=1),
        "camera cam00.yml: distortion_coefficients: expected 4 coefficients, found 5",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FOLDER_BREAKS)
def test_what_is_wrong_in_a_folder_is_named(tmp_path, name):
    entries, words = FOLDER_BREAKS[name]
    complaints = folder_of(tmp_path, entries)
    assert words in complaints
    assert "cam01" not in complaints


FILE_BREAKS = {
    "unnamed": (multiview(cam_ids=None), "cam_ids: expected the names of 2 cameras, found none"),
    "named alike": (multiview(cam_ids=["a", "a"]), "cam_ids: expected the names of 2 cameras, found ['a', 'a']"),
    "missing": (
        multiview(cam_ids=["cam00", "cam02"]),
        "cam01: expected a section of this name, found none; cameras of",
    ),
    "coefficients missing": (multiview(distortions=np.zeros(7)), "found 7 for 1 of them and 1 fisheyes"),
    "sizes missing": (multiview(image_sizes=None), "image_sizes: expected 2 x 2 finite numbers, found none"),
    "rotations missing": (multiview(Rs=None), "Rs: expected 2 rotations, found 0 numbers"),
    "omnidirectional": (ccalib(xi_1=1.2), "xi_1: expected perspective cameras, found omnidirectional ones"),
    "camera missing": (ccalib(nCameras=3), "camera_pose_2: expected 4 x 4 finite numbers, found none"),
    "stereo pair": ({"M1": K, "D1": DIST[False]}, "expected the keys of a rig, Ks or nCameras, found M1, D1; stereo"),
    "one camera": (single("cam00"), "give a folder with a file per camera, named after it"),
}


@pytest.mark.parametrize("name", FILE_BREAKS)
def test_what_is_wrong_in_a_file_is_named(tmp_path, name):
    entries, words = FILE_BREAKS[name]
    write(tmp_path / "rig.yml", **entries)
    _, complaints = read(tmp_path, format="opencv", path="rig.yml")
    assert words in complaints
    assert all(line.startswith("rig.yml: ") for line in complaints.splitlines())


def test_other_text_is_no_storage(tmp_path):
    (tmp_path / "rig.yml").write_text("cameras")
    assert "rig.yml: expected a .yml, .xml or .json of Open" in read(tmp_path, format="opencv", path="rig.yml")[1]


@with_boards
def test_lenses_of_opencvs_own_sample(tmp_path):
    (tmp_path / "lenses").mkdir()
    for name in SIZES:
        shutil.copy(BOARDS / "left_intrinsics.yml", tmp_path / f"lenses/{name}.yml")
    file, complaints = CameraFile(format="auto", path="lenses"), Complaints(tmp_path)
    cameras = read_known_lenses(tmp_path, file, "brown_conrady", SIZES, complaints)
    assert not complaints
    assert cameras["cam00"].K[0] == pytest.approx([535.91573396, 0, 342.28315473 + 0.5])
    assert cameras["cam00"].dist == pytest.approx(
        [-0.26637261, -0.03858890, 0.00178319, -0.00028122, 0.23839153], abs=1e-8
    )
