"""Eyes and gaze of a valid capture: what the index has of them, frame by frame."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.capture.index.eye_tables import between_directions
from pipeline.capture.index.validation import index_folder
from tests.support.captures.builder import build_capture, edit_manifest, write_lines, write_template

ROUNDING = 1e-12
"""A few roundings of numbers of size one."""


def with_eyes(root: Path, *directions: str) -> Path:
    build_capture(root)
    write_template(root / "template/template.glb", copies=2)
    places = [f"{eye},{v}" for eye, vertices in (("right", range(4, 8)), ("left", range(4))) for v in vertices]
    write_lines(root / "template/eyes.csv", "eye,vertex", *places)
    edit_manifest(root, lambda m: m["template"].update(eyes="template/eyes.csv"))
    if directions:
        write_lines(root / "gaze.csv", "frame,eye,x,y,z", *directions)
        edit_manifest(root, lambda m: m.update(gaze="gaze.csv"))
    return root


def test_a_capture_without_eyes_has_empty_tables(tmp_path: Path) -> None:
    index = index_folder(build_capture(tmp_path / "tiny"))
    assert list(index.tables["eyes"]) == ["eye", "vertex"]
    assert list(index.tables["gaze"]) == ["frame", "eye", "x", "y", "z", "interpolated"]
    assert len(index.tables["eyes"]) == len(index.tables["gaze"]) == 0
    assert index.contents["capture"]["template"]["eyes"] == []


def test_eyes_without_gaze_are_eyes(tmp_path: Path) -> None:
    index = index_folder(with_eyes(tmp_path / "tiny"))
    assert list(index.tables["eyes"].itertuples(index=False, name=None)) == [
        *(("left", v) for v in range(4)), *(("right", v) for v in range(4, 8)),
    ]  # fmt: skip
    assert len(index.tables["gaze"]) == 0
    assert index.contents["capture"]["template"]["eyes"] == ["left", "right"]


def test_gaze_is_complete_and_of_unit_length_and_what_is_made_up_is_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Frames 0 and 1 are of segment a, frame 2 of b."""
    root = with_eyes(tmp_path / "tiny", "0,left,0,0,1", "0,right,0,0.6,0.796", "2,left,1,0,0")
    with caplog.at_level(logging.WARNING):
        gaze = index_folder(root).tables["gaze"]
    assert "gaze.csv: 3 of 6 directions interpolated" in caplog.text
    assert list(zip(gaze.frame, gaze.eye, gaze.interpolated, strict=True)) == [
        (0, "left", False), (0, "right", False), (1, "left", True), (1, "right", True), (2, "left", False),
        (2, "right", True),
    ]  # fmt: skip
    directions = gaze[["x", "y", "z"]].to_numpy()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=ROUNDING)
    np.testing.assert_allclose(directions[2], [0, 0, 1], atol=ROUNDING)  # of its own segment, not on the way to b
    np.testing.assert_allclose(directions[5], directions[1], atol=ROUNDING)  # there is no other


def test_between_frames_of_a_segment_gaze_goes_by_time(tmp_path: Path) -> None:
    root = with_eyes(
        tmp_path / "tiny", *(f"{f},{e},{v}" for f, v in ((0, "0,0,1"), (2, "1,0,0")) for e in ("left", "right"))
    )
    write_lines(root / "frames.csv", "frame,timestamp_s,segment", "0,0.0,a", "1,0.1,a", "2,0.4,a", "3,0.5,b")
    write_lines(root / "patterns.csv", "frame,light,intensity", "0,A,1.0", "3,A,1.0")
    for camera in ("left", "right"):
        for kind in ("images", "masks"):
            (source,) = (root / kind / camera).glob("000002.*")
            (source.parent / source.name.replace("2", "3")).write_bytes(source.read_bytes())
    gaze = index_folder(root).tables["gaze"].query("eye == 'left'")
    angle = np.pi / 2 * 0.1 / 0.4
    np.testing.assert_allclose(gaze[["x", "z"]].to_numpy()[1], [np.sin(angle), np.cos(angle)], atol=ROUNDING)
    np.testing.assert_allclose(gaze[["x", "z"]].to_numpy()[3], [1, 0], atol=ROUNDING)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_directions_between_are_unit_and_on_the_way(share: float) -> None:
    rng = np.random.default_rng(0)
    start, end = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 50, 3)))
    found = between_directions(start, end, np.full(50, share))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=ROUNDING)
    whole = np.arctan2(np.linalg.norm(np.cross(start, end), axis=1), (start * end).sum(1))
    gone = np.arctan2(np.linalg.norm(np.cross(start, found), axis=1), (start * found).sum(1))
    np.testing.assert_allclose(gone, share * whole, atol=ROUNDING)


def test_between_opposite_or_equal_directions_is_one_of_them() -> None:
    start = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1]])
    end = np.array([[0.0, 0, -1], [0, 0, -1], [0, 0, 1]])
    found = between_directions(start, end, np.array([0.4, 0.6, 0.5]))
    np.testing.assert_array_equal(found, [[0, 0, 1], [0, 0, -1], [0, 0, 1]])


def test_keypoints_that_template_points_calls_pupils_are_points_of_eyes(tmp_path: Path) -> None:
    root = build_capture(tmp_path / "tiny")
    index_folder(root, folder=tmp_path)
    assert pd.read_parquet(tmp_path / "eye_points.parquet").empty
    write_lines(root / "template/points.csv", "keypoint,point", "head,left_pupil", "hip,mid_hip")
    edit_manifest(root, lambda m: m["template"].update(points="template/points.csv"))
    index_folder(root, folder=tmp_path)
    heads = pd.read_parquet(tmp_path / "keypoints_2d.parquet").query("keypoint == 'head'").reset_index(drop=True)
    points = pd.read_parquet(tmp_path / "eye_points.parquet")
    assert len(points) == len(heads) > 0 and set(points.point) == {"left_pupil"}
    np.testing.assert_array_equal(points[["x", "y"]], heads[["x", "y"]])
