"""A tiny capture indexed: its tables against what was planted. Broken ones: tests/unit/capture/index."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest

from pipeline.base.errors import InputError
from pipeline.stages.index_capture import run
from tests.support.captures.builder import (
    HEIGHT,
    LIGHTS,
    SENSOR,
    WIDTH,
    build_capture,
    edit_manifest,
    replace_text,
    truncate,
    write_lines,
)
from tests.support.shared_data import shared_data

WALKER, needs_walker = shared_data("captures/walker")


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_capture(tmp_path_factory.mktemp("known") / "tiny")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_capture(tmp_path_factory.mktemp("measured") / "tiny", measured=True)


def digest(path: Path) -> str:
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


def complaints_of(capture: Path, out: Path) -> str:
    with pytest.raises(InputError) as caught:
        run(capture=capture, out=out)
    assert not out.exists(), "something was written before all was checked"
    assert not list(out.parent.glob(".*")), "rows that waited beside it are still there"
    return str(caught.value)


class TestValid:
    def test_tables_say_what_was_planted(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path)
        cameras = pd.read_parquet(tmp_path / "cameras.parquet")
        assert cameras.to_dict("list") == {
            "camera": ["left", "right"],
            "width": [WIDTH] * 2,
            "height": [HEIGHT] * 2,
            "sensor_width": [SENSOR[0]] * 2,
            "sensor_height": [SENSOR[1]] * 2,
        }
        frames = pd.read_parquet(tmp_path / "frames.parquet")
        assert frames.to_dict("list") == {
            "frame": [0, 1, 2],
            "timestamp_s": [0.0, 1 / 30, 0.5],
            "segment": ["a", "a", "b"],
        }
        lights = pd.read_parquet(tmp_path / "lights.parquet")
        assert {row.light: (row.x, row.y, row.z) for row in lights.itertuples()} == LIGHTS
        patterns = pd.read_parquet(tmp_path / "patterns.parquet")
        rows = [(0, "A", 1.0), (0, "B", 1.0), (0, "C", 0.5), (1, "A", 2.0), (2, "C", 1.0)]
        assert list(patterns.itertuples(index=False, name=None)) == [(*row, row[2], row[2]) for row in rows]

    def test_images_carry_paths_digests_and_splits(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path)
        images = pd.read_parquet(tmp_path / "images.parquet")
        assert list(zip(images["camera"], images["frame"], strict=True)) == [
            (c, f) for c in ("left", "right") for f in range(3)
        ]
        for row in images.itertuples():
            assert row.path == f"images/{row.camera}/{row.frame:06d}.exr"
            assert row.digest == digest(known / row.path)
            assert row.mask_digest == digest(known / row.mask_path)
        assert images["test_camera"].tolist() == [False] * 3 + [True] * 3
        assert images["test_frame"].tolist() == [False, True, False] * 2
        assert images["test_segment"].tolist() == [False, False, True] * 2

    def test_capture_json_holds_no_splits_and_no_calibration(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path)
        assert json.loads((tmp_path / "capture.json").read_text()) == {
            "subject": "tiny",
            "kind": "body",
            "fps": 30.0,
            "images": {"transfer": "linear", "black_level": 0.0, "downsample_from_sensor": 2},
            "template": {
                "mesh": "template/template.glb",
                "mesh_digest": digest(known / "template/template.glb"),
                "keypoints": "template/keypoints.csv",
                "keypoints_digest": digest(known / "template/keypoints.csv"),
                "scale_to_m": 0.5,
                "eyes": [],
            },
        }

    def test_known_calibration(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path)
        path = "calibration/cameras.json"
        cameras = json.loads((tmp_path / "calibration_cameras.json").read_text())
        keys = {"method": "known", "format": "cameras_json", "path": path, "scale_to_m": 1.0, "frame": "stage"}
        assert cameras == {**keys, "digest": digest(known / path)}
        assert json.loads((tmp_path / "calibration_lights.json").read_text())["method"] == "known"
        assert json.loads((tmp_path / "calibration_color.json").read_text())["method"] == "none"

    def test_measured_calibration(self, measured: Path, tmp_path: Path) -> None:
        run(capture=measured, out=tmp_path)
        cameras = json.loads((tmp_path / "calibration_cameras.json").read_text())
        assert [(view["camera"], view["view"]) for view in cameras["views"]] == [
            ("left", 0),
            ("left", 3),
            ("right", 0),
            ("right", 3),
        ]
        assert cameras["squares_x"] == 7
        assert cameras["dictionary"] == "DICT_5X5_250"
        lights = json.loads((tmp_path / "calibration_lights.json").read_text())
        assert lights["radius_m"] == 0.1
        assert {(i["position"], i["camera"], i["light"]) for i in lights["images"]} == {
            ("low", camera, light) for camera in ("left", "right") for light in LIGHTS
        }
        assert [s["path"] for s in lights["silhouettes"]] == [
            f"calibration/ball/low/{camera}/silhouette.png" for camera in ("left", "right")
        ]
        color = json.loads((tmp_path / "calibration_color.json").read_text())
        assert color["patches"][23] == [24 / 30, 24 / 40, 24 / 50]
        assert len(color["patches"]) == 24
        assert color["patches_digest"] == digest(measured / "calibration/chart/chart.csv")
        for entry in [*cameras["views"], *lights["images"], *lights["silhouettes"], *color["images"]]:
            assert entry["digest"] == digest(measured / entry["path"])

    def test_optional_parts_may_be_left_out(self, known: Path, tmp_path: Path) -> None:
        capture = shutil.copytree(known, tmp_path / "capture")
        edit_manifest(capture, lambda m: (m.pop("masks"), m.pop("keypoints_2d"), m["template"].pop("keypoints")))
        run(capture=capture, out=tmp_path / "out")
        images = pyarrow.parquet.read_table(tmp_path / "out/images.parquet")
        for column in ("mask_path", "mask_digest"):
            assert images[column].null_count == 6
            assert images[column].type != "null"
        keypoints = pd.read_parquet(tmp_path / "out/keypoints_2d.parquet")
        assert keypoints.empty
        assert list(keypoints.columns) == ["frame", "camera", "keypoint", "x", "y", "confidence"]
        assert keypoints["frame"].dtype == np.int64
        assert keypoints["x"].dtype == np.float64
        assert json.loads((tmp_path / "out/capture.json").read_text())["template"]["keypoints"] is None

    def test_a_second_run_writes_the_same_bytes(self, measured: Path, tmp_path: Path) -> None:
        run(capture=measured, out=tmp_path)
        before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        run(capture=measured, out=tmp_path)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before

    def test_rows_of_intensity_zero_are_off(self, known: Path, tmp_path: Path) -> None:
        capture = shutil.copytree(known, tmp_path / "capture")
        with open(capture / "patterns.csv", "a") as file:
            file.write("2,B,0.0\n")
        run(capture=capture, out=tmp_path / "out")
        patterns = pd.read_parquet(tmp_path / "out/patterns.parquet")
        assert patterns[patterns["frame"] == 2]["light"].tolist() == ["C"]

    def test_white_and_coloured_lights_are_indexed_alike(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path / "white")
        white = pd.read_parquet(tmp_path / "white/patterns.parquet")
        assert list(white.columns) == ["frame", "light", "intensity_r", "intensity_g", "intensity_b"]
        assert white.iloc[2].tolist() == [0, "C", 0.5, 0.5, 0.5]
        capture = shutil.copytree(known, tmp_path / "capture")
        lines = ["0,A,1,0.5,0.25", "1,B,0,0,0", "1,A,0,0,2"]
        write_lines(capture / "patterns.csv", "frame,light,intensity_r,intensity_g,intensity_b", *lines)
        run(capture=capture, out=tmp_path / "out")
        colored = pd.read_parquet(tmp_path / "out/patterns.parquet")
        assert colored.to_numpy().tolist() == [[0, "A", 1, 0.5, 0.25], [1, "A", 0, 0, 2]]

    def test_held_out_patterns_are_marked(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path / "without")
        assert not pd.read_parquet(tmp_path / "without/images.parquet")["test_pattern"].any()
        capture = shutil.copytree(known, tmp_path / "capture")
        edit_manifest(capture, lambda m: m["splits"].update(test_patterns=[1]))
        run(capture=capture, out=tmp_path / "out")
        images = pd.read_parquet(tmp_path / "out/images.parquet")
        assert set(images["frame"][images["test_pattern"]]) == {1}

    def test_validation_images_are_marked_or_left_open(self, known: Path, tmp_path: Path) -> None:
        run(capture=known, out=tmp_path / "without")
        without = pd.read_parquet(tmp_path / "without/images.parquet")
        assert without[["validation_frame", "validation_pattern"]].isna().all(axis=None)
        assert not without["validation_camera"].any()
        capture = shutil.copytree(known, tmp_path / "capture")
        edit_manifest(capture, lambda m: m["splits"].update(validation_frames=[1], validation_patterns=[]))
        run(capture=capture, out=tmp_path / "out")
        images = pd.read_parquet(tmp_path / "out/images.parquet")
        assert set(images["frame"][images["validation_frame"]]) == {1}
        assert not images[["validation_camera", "validation_pattern"]].any(axis=None)

    def test_patterns_of_a_stage_out_of_step_pass(self, known: Path, tmp_path: Path) -> None:
        """Whose frames run 1, 2, 3: book_patterns has to see them."""
        capture = shutil.copytree(known, tmp_path / "capture")
        write_lines(capture / "patterns.csv", "frame,light,intensity", "1,A,1", "2,A,2", "3,C,1")
        run(capture=capture, out=tmp_path / "out")
        assert pd.read_parquet(tmp_path / "out/patterns.parquet")["frame"].tolist() == [1, 2, 3]


def test_complaints_come_all_at_once_and_each_once(known: Path, tmp_path: Path) -> None:
    capture = shutil.copytree(known, tmp_path / "capture")
    edit_manifest(capture, lambda m: (m.pop("fps"), m.update(fsp=30)))
    replace_text(capture / "lights.csv", "1.5,0.5", "nan,0.5")
    truncate(capture / "images/left/000001.exr")
    (capture / "masks/right/000002.png").unlink()
    replace_text(capture / "template/keypoints.csv", "head,2", "head,7")
    with open(capture / "patterns.csv", "a") as file:
        file.write("1,unheard-of,1.0\n")
    message = complaints_of(capture, tmp_path / "out")
    expected = [
        "7 problems",
        "patterns.csv: light: expected one that the table of lights lists, found unheard-of",
        "capture.yaml: fps",
        "did you mean fps?",
        "lights.csv: x",
        "images/left/000001.exr",
        "masks: right",
        "keypoints.csv: node_index",
    ]
    for words in expected:
        assert message.count(words) == 1, message


def test_command_line_exits_with_1_and_no_traceback(known: Path, tmp_path: Path, repo_root: Path) -> None:
    capture = shutil.copytree(known, tmp_path / "capture")
    (capture / "frames.csv").unlink()
    command = [
        sys.executable,
        "-m",
        "pipeline.stages.index_capture",
        "--capture",
        str(capture),
        "--out",
        str(tmp_path / "out"),
    ]
    result = subprocess.run(command, cwd=repo_root, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "frames.csv" in result.stderr
    assert "Traceback" not in result.stderr


@needs_walker
def test_walker(tmp_path: Path) -> None:
    run(capture=WALKER, out=tmp_path)
    images = pd.read_parquet(tmp_path / "images.parquet")
    assert len(images) == 12 * 48
    assert set(images[images["test_camera"]]["camera"]) == {"cam02", "cam08"}
    assert set(images[images["test_frame"]]["frame"]) == {35, 38}
    patterns = pd.read_parquet(tmp_path / "patterns.parquet")
    assert len(patterns) == 1267
    assert patterns["light"].nunique() == 64
    views = json.loads((tmp_path / "calibration_cameras.json").read_text())["views"]
    assert len(views) == 127
    lights = json.loads((tmp_path / "calibration_lights.json").read_text())
    assert (len(lights["images"]), len(lights["silhouettes"])) == (576, 9)


def test_rate_that_is_off_by_less_than_a_unit_is_told(known: Path, tmp_path: Path, caplog) -> None:
    """Frames may have been left out before they were numbered: worth a look, and no error."""
    capture = shutil.copytree(known, tmp_path / "tiny")
    edit_manifest(capture, lambda manifest: manifest.update(fps=24))
    run(capture=capture, out=tmp_path / "out")
    assert "timestamp_s: expected seconds, 0.0416667 apart from frame to frame as fps says (24)" in caplog.text


def test_capture_without_keypoints_is_told_that_tracking_will_refuse(known: Path, tmp_path: Path, caplog) -> None:
    capture = shutil.copytree(known, tmp_path / "tiny")
    edit_manifest(capture, lambda manifest: (manifest.pop("keypoints_2d"), manifest["template"].pop("keypoints")))
    run(capture=capture, out=tmp_path / "out")
    assert "keypoints_2d: none, or empty: calibration runs, but track_mesh will refuse" in caplog.text
