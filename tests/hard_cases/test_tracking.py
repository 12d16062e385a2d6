"""Captures that break trackers: the answer stays finite and near the truth, or the message says what to do."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_table
from pipeline.config.track_mesh import TrackMesh
from pipeline.stages.track_mesh import run
from tests.support.captures.walking import edited, mean_error_mm, with_template_scale, write_capture
from tests.support.figures.walking import Motion, walk
from tests.support.results.hard_case import HardCase

FRAMES = 14

SETTINGS = TrackMesh(outline_rounds=3)

GOOD_MM = 4.0
"""Mean vertex error of an unspoilt capture: 5 cameras of 0.35 px at 12 mm per pixel, less what smoothness averages."""


@pytest.fixture(scope="module")
def motion() -> Motion:
    return walk(FRAMES)


@pytest.fixture(scope="module")
def captured(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> dict:
    return write_capture(tmp_path_factory.mktemp("walk"), motion)


@pytest.fixture(scope="module")
def keypoints(captured: dict) -> pd.DataFrame:
    return read_table(captured["index"] / "keypoints_2d.parquet")


def tracked(paths: dict, settings: TrackMesh = SETTINGS) -> dict[str, np.ndarray]:
    run(**paths, chunk=0, settings=settings)
    result = read_arrays(paths["out"] / "0000.safetensors")
    assert np.isfinite(result["vertices"]).all()
    return result


def test_a_keypoint_missing_for_ten_frames(
    case: HardCase, captured: dict, keypoints: pd.DataFrame, motion: Motion, tmp_path: Path
) -> None:
    hand = (keypoints.keypoint == "k04") & keypoints.frame.between(2, 11)
    paths = edited(captured, tmp_path, keypoints_2d=keypoints[~hand])
    result = tracked(paths)
    assert np.isnan(result["keypoints"][2:12, 4]).all()
    assert np.isfinite(result["keypoints"][:2, 4]).all()
    # The elbow is then held by what hangs on it, by masks, and by the frames around: worse, but not by much.
    case.check(mean_error_mm(paths, motion), 1.5 * GOOD_MM, unit="mm")


def test_three_keypoints_seen_by_two_cameras(captured: dict, keypoints: pd.DataFrame, tmp_path: Path) -> None:
    few = keypoints[keypoints.camera.isin(["cam00", "cam02"]) & keypoints.keypoint.isin(["k00", "k03", "k08"])]
    paths = edited(captured, tmp_path, keypoints_2d=few)
    result = tracked(paths, TrackMesh(outline_rounds=0, max_iterations=10))
    assert np.abs(result["vertices"]).max() < 5.0


@pytest.mark.parametrize("death", ["silent", "wild"])
def test_a_dead_camera(
    case: HardCase, captured: dict, keypoints: pd.DataFrame, motion: Motion, tmp_path: Path, death: str
) -> None:
    dead = keypoints.camera == "cam03"
    spoilt = keypoints[~dead]
    if death == "wild":
        random = np.random.default_rng(5)
        noise = {"x": random.uniform(0, 160, dead.sum()), "y": random.uniform(0, 192, dead.sum())}
        spoilt = pd.concat([spoilt, keypoints[dead].assign(**noise)])
    images = read_table(captured["index"] / "images.parquet")
    images.loc[images.camera == "cam03", "mask_path"] = None
    paths = edited(captured, tmp_path, keypoints_2d=spoilt, images=images)
    tracked(paths)
    case.check(mean_error_mm(paths, motion), 1.5 * GOOD_MM, unit="mm")


def test_left_and_right_swapped_in_one_view(
    case: HardCase, captured: dict, keypoints: pd.DataFrame, motion: Motion, tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    names = {"k03": "k05", "k04": "k06", "k07": "k09", "k08": "k10"}
    names |= {right: left for left, right in names.items()}
    swapped = (keypoints.camera == "cam04") & keypoints.frame.between(3, 9)
    renamed = keypoints.keypoint.where(~swapped, keypoints.keypoint.replace(names))
    paths = edited(captured, tmp_path, keypoints_2d=keypoints.assign(keypoint=renamed))
    with caplog.at_level(logging.WARNING):
        tracked(paths)
    assert "exchanged in one view" in caplog.text
    case.check(mean_error_mm(paths, motion), GOOD_MM, unit="mm")
    # The observations count again, all but the detector's own outliers and pairs that one ray meets both.
    plain = edited(captured, tmp_path / "plain")
    tracked(plain)
    inliers = [read_table(p["out"] / "0000.parquet").inliers.sum() for p in (paths, plain)]
    assert inliers[0] > inliers[1] - 0.2 * 8 * 7


@pytest.mark.parametrize("turn", [np.pi, 2 * np.pi])
def test_a_rotation_through_180_degrees(case: HardCase, tmp_path: Path, turn: float) -> None:
    motion = walk(FRAMES, turn=turn, fps=12.0)
    paths = write_capture(tmp_path, motion)
    result = tracked(paths)
    case.check(mean_error_mm(paths, motion), GOOD_MM, unit="mm")
    # Neighbouring quaternions are the same rotation or a small one apart, whatever their sign.
    cosine = np.abs((result["root_rotation"][1:] * result["root_rotation"][:-1]).sum(1))
    assert (2 * np.arccos(np.clip(cosine, 0, 1)) < 1.5 * turn / (FRAMES - 1) + 0.3).all()


def test_a_subject_that_leaves_the_volume(
    case: HardCase, captured: dict, keypoints: pd.DataFrame, motion: Motion, tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    gone = keypoints.frame >= FRAMES - 3
    leaving = (keypoints.frame == FRAMES - 4) & keypoints.camera.isin(["cam00", "cam01", "cam02", "cam05"])
    images = read_table(captured["index"] / "images.parquet")
    images.loc[images.frame >= FRAMES - 3, "mask_path"] = None
    paths = edited(captured, tmp_path, keypoints_2d=keypoints[~gone & ~leaving], images=images)
    with caplog.at_level(logging.WARNING):
        result = tracked(paths)
    table = read_table(paths["out"] / "0000.parquet")
    assert table.status.tolist() == ["tracked"] * (FRAMES - 3) + ["interpolated"] * 3
    assert f"3 frames had too few keypoints and were interpolated: {list(range(FRAMES - 3, FRAMES))}" in caplog.text
    assert table.masks.tolist() == [5] * (FRAMES - 3) + [0] * 3
    unmasked = "3 frames have no mask; interpolated poses stand in for silhouettes"
    assert f"{unmasked}: {list(range(FRAMES - 3, FRAMES))}" in caplog.text
    seen = np.linalg.norm(result["vertices"] - motion.vertices, axis=-1)[: FRAMES - 3]
    case.check(1e3 * seen.mean(), 1.5 * GOOD_MM, unit="mm")
    # Nobody knows where it went: it stays where it was seen last.
    assert np.array_equal(result["vertices"][-1], result["vertices"][-4])


def test_a_degenerate_template_triangle(case: HardCase, motion: Motion, tmp_path: Path) -> None:
    paths = write_capture(tmp_path, motion, flaw=True)
    tracked(paths)
    case.check(mean_error_mm(paths, motion), GOOD_MM, unit="mm")


def test_a_template_in_centimetres(captured: dict, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"set template.scale_to_m in capture.yaml to about 0\.0"):
        run(**with_template_scale(captured, tmp_path, 1.0), chunk=0)


def test_zero_keypoints(captured: dict, keypoints: pd.DataFrame, tmp_path: Path) -> None:
    paths = edited(captured, tmp_path, keypoints_2d=keypoints[:0])
    message = r"found none in frames 0 to 13; run a 2D detector and name its table in capture.yaml"
    with pytest.raises(InputError, match=message):
        run(**paths, chunk=0)
    assert not paths["out"].exists()
