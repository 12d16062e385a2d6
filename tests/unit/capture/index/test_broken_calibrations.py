"""A tiny capture whose calibration is broken one way at a time: each break must be named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.captures.broken import Break, check_break, manifest
from tests.support.captures.builder import (
    save,
    truncate,
    write_lines,
)


def known_cameras(change: Callable[[dict], object]) -> Break:
    def edit(root: Path) -> None:
        path = root / "calibration/cameras.json"
        content = json.loads(path.read_text())
        change(content["cameras"])
        path.write_text(json.dumps(content))

    return edit


KNOWN_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "no cameras.json": (
        lambda root: (root / "calibration/cameras.json").unlink(),
        ["calibration/cameras.json: expected a file"],
    ),
    "no json": (
        lambda root: (root / "calibration/cameras.json").write_text("{"),
        ["calibration/cameras.json: expected a JSON"],
    ),
    "camera left out": (known_cameras(lambda c: c.pop("left")), ["calibration/cameras.json: left", "found no entry"]),
    "image resolution": (
        known_cameras(lambda c: c["left"].update(width=8)),
        ["left: width x height: expected the sensor's 16 x 12"],
    ),
    "mirrored": (
        known_cameras(lambda c: c["left"].update(R=np.diag([1.0, 1, -1]).tolist())),
        ["left: R: expected a rotation", "mirrored"],
    ),
    "scaled": (
        known_cameras(lambda c: c["left"].update(R=np.diag([2.0, 2, 2]).tolist())),
        ["left: R: expected a rotation"],
    ),
    "distortion of four": (known_cameras(lambda c: c["left"].update(dist=[0.0] * 4)), ["camera left: dist"]),
    "two known cameras at once": (
        known_cameras(lambda c: (c["left"].update(width=8), c.pop("right"))),
        ["cameras.json: left: width x height", "cameras.json: right: expected every camera"],
    ),
    "unknown format of cameras": (
        manifest(lambda m: m["calibration"]["cameras"].update(format="bundler")),
        [
            "calibration.cameras.format: expected 'cameras_json', 'colmap', 'nerfstudio', ",
            " or 'auto', found text 'bundler'",
        ],
    ),
    "folder without its format": (
        manifest(lambda m: m["calibration"]["cameras"].update(path="calibration/sparse")),
        ["calibration.cameras.path: expected a path that ends in .json"],
    ),
    "no COLMAP model": (
        manifest(lambda m: m["calibration"]["cameras"].update(path="calibration/sparse", format="colmap")),
        ["calibration/sparse: expected the folder of a COLMAP model, found none"],
    ),
    "nerfstudio without frames": (
        manifest(lambda m: m["calibration"]["cameras"].update(format="nerfstudio")),
        ["calibration/cameras.json: frames: expected a list"],
    ),
}


MEASURED_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "keys of another method": (
        manifest(lambda m: m["calibration"]["cameras"].update(radius_m=1)),
        ["calibration.cameras.radius_m", "an unknown key"],
    ),
    "key of the method missing": (
        manifest(lambda m: m["calibration"]["cameras"].pop("square_m")),
        ["calibration.cameras.square_m: expected side of a square"],
    ),
    "marker larger than square": (
        manifest(lambda m: m["calibration"]["cameras"].update(marker_m=0.2)),
        ["calibration.cameras.marker_m: expected less than"],
    ),
    "unknown dictionary": (
        manifest(lambda m: m["calibration"]["cameras"].update(dictionary="DICT_9X9")),
        ["calibration.cameras.dictionary", "cv2.aruco"],
    ),
    "small dictionary": (
        manifest(lambda m: m["calibration"]["cameras"].update(dictionary="DICT_5X5_50", squares_x=20, squares_y=20)),
        ["calibration.cameras.dictionary", "at least 200 markers"],
    ),
    "camera without a view": (
        lambda root: shutil.rmtree(root / "calibration/charuco/left"),
        ["at least one view of the board per camera, found none for left"],
    ),
    "view of unknown camera": (
        lambda root: shutil.copytree(root / "calibration/charuco/left", root / "calibration/charuco/middle"),
        ["camera", "found middle"],
    ),
    "view at image size": (
        lambda root: save(root / "calibration/charuco/left/003.png", np.zeros((6, 8), np.uint8)),
        ["left/003.png: left: size: expected 16 x 12"],
    ),
    "truncated view": (
        lambda root: truncate(root / "calibration/charuco/left/003.png"),
        ["charuco/left/003.png: expected a whole image"],
    ),
    "no silhouette": (
        lambda root: (root / "calibration/ball/low/left/silhouette.png").unlink(),
        ["silhouette: expected one per ball", "none for low left"],
    ),
    "unknown light": (
        lambda root: (root / "calibration/ball/low/left/A.png").rename(root / "calibration/ball/low/left/Q.png"),
        ["light", "found Q"],
    ),
    "no ball images": (
        lambda root: shutil.rmtree(root / "calibration/ball"),
        ["expected images of the mirror ball, found none"],
    ),
    "one sighting": (
        lambda root: shutil.rmtree(root / "calibration/ball/low/left"),
        ["at least 2 pairs of ball position and camera"],
    ),
    "no chart image": (
        lambda root: (root / "calibration/chart/left.exr").unlink(),
        ["an image of the chart per camera, found none for left"],
    ),
    "patch missing": (
        lambda root: write_lines(root / "calibration/chart/chart.csv", "patch,r,g,b", "1,0.1,0.1,0.1"),
        ["patch: expected 1 to 24"],
    ),
    "stage frame open": (
        manifest(lambda m: m["calibration"].update(lights={"method": "known"})),
        ["calibration.lights.method: expected mirror_ball", "frame of their own"],
    ),
}


@pytest.mark.parametrize("name", KNOWN_BREAKS)
def test_known_calibration_complaint(name: str, known: Path, tmp_path: Path) -> None:
    check_break(known, tmp_path, *KNOWN_BREAKS[name])


@pytest.mark.parametrize("name", MEASURED_BREAKS)
def test_measured_calibration_complaint(name: str, measured: Path, tmp_path: Path) -> None:
    check_break(measured, tmp_path, *MEASURED_BREAKS[name])
