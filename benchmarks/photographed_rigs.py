"""Rigs that others photographed and calibrated: their images as input of calibrate_cameras, and their results."""

from __future__ import annotations

import csv
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.files import write_json, write_table
from pipeline.geometry.cameras import Camera, write_cameras

CALISCOPE_BOARD = {"squares_x": 4, "squares_y": 5, "square_m": 0.054, "marker_m": 0.0405, "dictionary": "DICT_4X4_1000"}
"""As the note of the data has it; that it is printed white on black is left to be found."""

CALISCOPE_SIZE = (1280, 720)

CHECKERBOARD = {"squares_x": 10, "squares_y": 7, "square_m": 0.025}
"""Of OpenCV's samples: 9 x 6 inner corners."""

CHECKERBOARD_SIZE = (640, 480)


def caliscope_cameras(data: Path) -> dict[str, Camera]:
    """The authors' cameras, of their table, by the names cam_0 to cam_3."""
    table = tomllib.loads((data / "camera_array.toml").read_text())["cameras"]
    return {f"cam_{name}": _camera(entry) for name, entry in table.items()}


def caliscope_frames(data: Path, camera: str, every: int) -> Iterator[tuple[int, np.ndarray]]:
    """Number and BGR image of one in `every` frames of a camera's video, from the first on."""
    video = cv2.VideoCapture(str(data / f"calibration/extrinsic/{camera}.mp4"))
    number = 0
    while video.grab():
        if number % every == 0:
            yield number, video.retrieve()[1]
        number += 1


def _camera(entry: Mapping[str, Any]) -> Camera:
    K = np.array(entry["matrix"], np.float64)
    # OpenCV's first pixel centre is (0, 0).
    K[:2, 2] += PIXEL_CENTER
    R, t = np.array(entry["rotation"], np.float64), np.array(entry["translation"], np.float64)
    return Camera(R, t, K, np.array(entry["distortions"], np.float64), *entry["size"])


def prepare_caliscope(data: Path, folder: Path, intrinsics: str, times: bool = True) -> dict[str, Path]:
    """Videos of four cameras with their times: arguments of calibrate_cameras.

    Args:
        intrinsics: estimate, refine or known; the lenses are the authors'.
        times: False: as if the images of a view had been taken at once.
    """
    cameras = caliscope_cameras(data)
    folder.mkdir(parents=True, exist_ok=True)
    write_cameras(folder / "lenses.json", cameras)
    with (data / "calibration/extrinsic/timestamps.csv").open() as file:
        rows = list(csv.DictReader(file))
    first = min(int(row["frame_index"]) for row in rows)
    views = []
    for name in cameras:
        shutil.copyfile(data / f"calibration/extrinsic/{name}.mp4", folder / f"{name}.mp4")
    for row in rows:
        frame, name = int(row["frame_index"]) - first, f"cam_{row['cam_id']}"
        view = {"camera": name, "view": frame, "path": f"{name}.mp4", "frame": frame, "digest": ""}
        views.append({**view, "time_s": float(row["frame_time"])} if times else view)
    views = sorted(views, key=lambda view: (view["camera"], view["view"]))
    section = {"method": "charuco", **CALISCOPE_BOARD, "intrinsics": intrinsics}
    if intrinsics != "estimate":
        section["lenses_from"] = {"format": "cameras_json", "path": "lenses.json"}
    return _write_index(folder, dict.fromkeys(cameras, CALISCOPE_SIZE), {**section, "views": views})


def prepare_checkerboard(data: Path, folder: Path) -> dict[str, Path]:
    """Photographs of a stereo pair: arguments of calibrate_cameras."""
    views = []
    for side in ("left", "right"):
        for path in sorted(data.glob(f"{side}[0-9][0-9].jpg")):
            (folder / side).mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, folder / side / path.name)
            views.append({"camera": side, "view": int(path.stem[-2:]), "path": f"{side}/{path.name}", "digest": ""})
    section = {"method": "boards", "checkerboards": [CHECKERBOARD], "views": views}
    return _write_index(folder, dict.fromkeys(("left", "right"), CHECKERBOARD_SIZE), section)


def opencv_left_focal(data: Path) -> float:
    """Focal length of the left camera as its authors have it, pixels."""
    storage = cv2.FileStorage(str(data / "left_intrinsics.yml"), cv2.FILE_STORAGE_READ)
    return float(storage.getNode("camera_matrix").mat()[0, 0])


@dataclass(frozen=True)
class OpencvPair:
    """The stereo pair by cv2: each lens by calibrateCamera, then the pair by stereoCalibrate."""

    left_rms_px: float
    right_focal_px: float
    baseline_mm: float
    turn_deg: float


def opencv_pair(data: Path) -> OpencvPair:
    """Calibrate the photographed stereo pair with OpenCV alone."""
    grid = (CHECKERBOARD["squares_x"] - 1, CHECKERBOARD["squares_y"] - 1)
    corners_m = np.zeros((grid[0] * grid[1], 3), np.float32)
    corners_m[:, :2] = np.mgrid[: grid[0], : grid[1]].T.reshape(-1, 2) * CHECKERBOARD["square_m"]
    left, right = ([_checkerboard(path, grid) for path in sorted(data.glob(f"{side}[0-9][0-9].jpg"))]
                   for side in ("left", "right"))  # fmt: skip
    points = [corners_m] * len(left)
    alone = [cv2.calibrateCamera(points, seen, CHECKERBOARD_SIZE, None, None) for seen in (left, right)]
    (rms, K1, d1, *_), (_, K2, d2, *_) = alone
    _, _, _, _, _, R, t, *_ = cv2.stereoCalibrate(
        points, left, right, K1, d1, K2, d2, CHECKERBOARD_SIZE, flags=cv2.CALIB_FIX_INTRINSIC
    )
    turn = np.degrees(np.linalg.norm(cv2.Rodrigues(R)[0]))
    return OpencvPair(rms, float(K2[0, 0]), 1000 * float(np.linalg.norm(t)), float(turn))


def _checkerboard(path: Path, grid: tuple[int, int]) -> np.ndarray:
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    corners = cv2.findChessboardCorners(gray, grid)[1]
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 1e-3)
    return cv2.cornerSubPix(gray, corners, (5, 5), (-1, -1), stop)


def _write_index(folder: Path, sizes: Mapping[str, tuple[int, int]], section: Mapping[str, Any]) -> dict[str, Path]:
    rows = [
        {"camera": name, "width": w, "height": h, "sensor_width": w, "sensor_height": h}
        for name, (w, h) in sizes.items()
    ]
    write_table(folder / "index/cameras.parquet", pd.DataFrame(rows))
    write_json(folder / "index/calibration_cameras.json", section)
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}
