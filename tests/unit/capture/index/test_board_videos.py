"""Boards in videos, their times and given lenses: what the index says of them, and what it refuses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.capture.gray import read_view_gray
from pipeline.capture.index.validation import index_folder
from tests.support.captures.builder import CAMERAS, SENSOR, build_capture, write_lines

FRAMES = 4


@pytest.fixture
def filmed(tmp_path):
    """A capture whose board views are frames of uniform grey: 40, 80, 120, 160."""
    root = build_capture(tmp_path / "tiny", measured=True)
    for camera in CAMERAS:
        path = str(root / f"calibration/{camera}.avi")
        writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 10, SENSOR)
        for frame in range(FRAMES):
            writer.write(np.full((SENSOR[1], SENSOR[0], 3), 40 * (frame + 1), np.uint8))
        writer.release()
    rows = [f"{camera},{frame},{0.1 * frame + 0.01 * c}" for c, camera in enumerate(CAMERAS) for frame in range(FRAMES)]
    write_lines(root / "calibration/times.csv", "camera,view,time_s", *rows)
    change(root, path="calibration/{camera}.avi", times="calibration/times.csv")
    return root


def change(root, **keys):
    content = yaml.safe_load((root / "capture.yaml").read_text())
    content["calibration"]["cameras"].update(keys)
    (root / "capture.yaml").write_text(yaml.safe_dump(content))


def test_every_frame_is_a_view_with_its_time(filmed):
    views = index_folder(filmed).contents["calibration_cameras"]["views"]
    assert [(view["camera"], view["view"]) for view in views] == [(c, f) for c in CAMERAS for f in range(FRAMES)]
    assert views[FRAMES + 2]["time_s"] == pytest.approx(0.21)
    # In any order; MJPG keeps a uniform grey to a count or two.
    for view in [views[k] for k in (3, 1, 1, 6, 0)]:
        assert read_view_gray(filmed, view).mean() == pytest.approx(40 * (view["view"] + 1), abs=3)


def test_a_frame_beyond_the_end_is_named(filmed):
    with pytest.raises(InputError, match="expected a frame 9, found none"):
        read_view_gray(filmed, {"path": "calibration/left.avi", "frame": 9})


def refused(root):
    with pytest.raises(InputError) as caught:
        index_folder(root)
    return str(caught.value)


def test_a_time_is_missing(filmed):
    write_lines(filmed / "calibration/times.csv", "camera,view,time_s", "left,0,0.0")
    assert "calibration/times.csv: time_s: expected a row for each image of a board" in refused(filmed)


def test_no_video(filmed):
    (filmed / "calibration/right.avi").write_bytes(b"nothing")
    assert "expected a video that OpenCV decodes, found none" in refused(filmed)


def test_lenses_of_another_model(filmed):
    change(filmed, intrinsics="known", lens="fisheye", lenses_from={"path": "calibration/cameras.json"})
    other = build_capture(filmed.parent / "other")
    (filmed / "calibration/cameras.json").write_bytes((other / "calibration/cameras.json").read_bytes())
    told = refused(filmed)
    assert "calibration/cameras.json: left: lens: expected fisheye, found brown_conrady" in told
    change(filmed, lens="brown_conrady")
    content = index_folder(filmed).contents["calibration_cameras"]
    assert content["intrinsics"] == "known"
    assert content["lenses_digest"]
