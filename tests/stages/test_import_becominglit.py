"""A BecomingLit capture in the set's layout, imported and compared with what it was made from."""

from __future__ import annotations

import json
import os
import shutil

import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.color import corrected
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.capture.images import ImageSource
from pipeline.capture.keypoint_orders import read_orders
from pipeline.config.import_capture import ImportCapture
from pipeline.figures.tracked_capture import read_tracked_capture
from pipeline.figures.tracking_verdicts import frame_verdicts
from pipeline.stages import book_patterns
from pipeline.stages.import_capture import run
from tests.support.datasets.becominglit_layout import (
    CAMERAS,
    LANDMARKS,
    ON_OUTLINE,
    SEQUENCES,
    TEST_CAMERA,
    intensity,
    light_pattern,
    marked_vertices,
    pattern_of,
    true_head,
    write_becominglit,
)
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set, score_as_preset

FRAMES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 6, 100000: 9, 100001: 10, 100002: 11, 100003: 12}
"""Imported -> true: the sequences are EXP-2 and FREE, whose last frame lies behind its last mesh."""


CHIN = "face_8"
"""The lowest point of a face's outline, which is nearly the same from all sides."""


@pytest.fixture(scope="module")
def truth():
    return true_head()


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_becominglit(tmp_path_factory.mktemp("set"), truth)


@pytest.fixture(scope="module")
def imported(shipped, tmp_path_factory):
    """Folders of the native capture, and of the results of the stages that follow."""
    capture, results = import_set("becominglit", shipped, tmp_path_factory.mktemp("imported"))
    cameras, lights = results / "calibration/cameras.json", results / "calibration/lights.parquet"
    book_patterns.run(capture=capture, index=results / "index", lights=lights, cameras=cameras, out=results)
    return capture, results


def test_cameras_project_as_the_true_ones(truth, imported):
    assert_true_cameras(imported[1], truth, CAMERAS, 4)


def test_lights_and_patterns_are_the_true_ones(truth, imported):
    assert_true_lights(imported[1], truth)
    patterns = pd.read_parquet(imported[1] / "patterns.parquet")
    assert sorted(patterns.frame.unique()) == sorted(FRAMES)
    for frame, rows in patterns.groupby("frame"):
        number = pattern_of(FRAMES[frame])
        expected = {f"L{light:03d}": intensity(number, duration) for light, duration in light_pattern(number)}
        assert dict(zip(rows.light, rows.intensity_r, strict=True)) == pytest.approx(expected, abs=1e-12)


def test_meshes_are_the_true_ones(truth, imported):
    arrays = read_arrays(imported[1] / "tracking/0000.safetensors")
    table = pd.read_parquet(imported[1] / "tracking/0000.parquet")
    assert arrays["frames"].tolist() == sorted(FRAMES)
    for frame, status, vertices in zip(arrays["frames"], table.status, arrays["vertices"], strict=True):
        lit = pattern_of(FRAMES[frame]) == 0
        assert status == ("given" if lit else "between")
        # Between meshes the head turns about the middle that was fitted, with an open mouth a millimetre off the true.
        np.testing.assert_allclose(vertices, truth.vertices(FRAMES[frame]), atol=1e-6 if lit else 1e-3)
    turn = arrays["root_rotation"]
    assert np.abs(turn - turn[0]).max() > 0.05, "the motion of the head is no part of its shape"


def test_landmarks_mark_the_true_vertices_and_fit_the_meshes(truth, imported):
    capture, results = imported
    order, right = read_orders()["wflw_98"].points, marked_vertices(truth)
    placed = pd.read_csv(capture / "keypoints.csv").set_index("keypoint").vertex
    assert set(placed.index) - {order[k] for k in range(LANDMARKS) if k not in ON_OUTLINE} <= {CHIN}
    assert all(placed[order[k]] == right[k] for k in range(LANDMARKS) if k not in ON_OUTLINE)
    table = pd.read_parquet(results / "tracking/0000.parquet").set_index("frame")
    given, seen = table[table.status == "given"], len(placed) * len(CAMERAS)
    assert (given.observations == seen).all() and (given.inliers == seen).all() and (given.rms_px < 0.2).all()
    assert (table.observations[table.status == "between"] == 0).all()
    verdicts = pd.read_csv(results / "tracking/verdicts_0000.csv").set_index("kind")
    assert verdicts.reason["keypoints"].startswith(f"100% of {seen * len(given)} detections")


def test_review_shows_landmarks_beside_given_meshes(imported):
    capture, results = imported
    found = read_tracked_capture(
        capture, results / "index", results / "calibration", [results / "tracking/0000.safetensors"],
        results / "frames.parquet",
    )  # fmt: skip
    inner = [name != CHIN for name in found.keypoint_names]
    assert np.nanmax(found.residual_px[..., inner]) < 1e-4 and np.isnan(found.triangulated_m).all()
    verdicts, seen = {verdict.name: verdict for verdict in frame_verdicts(found)}, len(CAMERAS) * len(inner)
    assert f" px, {seen} of {seen} keypoints fit" in verdicts["0"].reason
    assert verdicts["0"].grade == "good" and "keypoints fit" not in verdicts["1"].reason


def test_landmarks_of_something_else_are_refused_by_name_and_without_any_nothing_is_lost(shipped, tmp_path):
    root = shutil.copytree(shipped, tmp_path / "1001")
    path = root / f"sequences/FREE/landmark2d/PIPnet/cam_{CAMERAS[0]}.npz"
    np.savez(path, **{"0": np.zeros((68, 2))})
    with pytest.raises(InputError, match=rf"cam_{CAMERAS[0]}.npz: expected 98 x 2 finite numbers .* found \(68, 2\)"):
        run(dataset="becominglit", source=root, subject="x", out=tmp_path / "out")
    for folder in root.glob("sequences/*/landmark2d"):
        shutil.rmtree(folder)
    run(dataset="becominglit", source=root, subject="x", out=tmp_path / "out")
    described = yaml.safe_load((tmp_path / "out/capture.yaml").read_text())
    assert "keypoints_2d" not in described and "keypoints" not in described["template"]


def test_colours_are_those_of_the_sets_own_order(truth, imported):
    capture, results = imported
    source = ImageSource.from_index(capture, json.loads((results / "index/capture.json").read_text())["images"])
    colors = json.loads((results / "calibration/color.json").read_text())["cameras"]
    images = pd.read_parquet(results / "index/images.parquet").set_index(["camera", "frame"])
    row = images.loc[CAMERAS[1], 100000]
    shown = corrected(source.read(row.path, 100000), np.array(colors[CAMERAS[1]]))
    # AVIF is lossy, and its errors grow with the slope of sRGB.
    np.testing.assert_allclose(shown, truth.image(CAMERAS[1], 9), atol=0.08)
    dark = shown[:10, :10]
    np.testing.assert_allclose(dark, 0, atol=0.004)
    mask = source.read_mask(row.mask_path, shown.shape)
    assert (mask[-1] == 0).all() and mask[36, 24] == 255, "clothes are no subject"


def test_splits_sync_and_provenance_are_the_sets(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    assert described["splits"]["test_cameras"] == [TEST_CAMERA]
    assert described["splits"]["test_segments"] == ["FREE"]
    assert described["imported"]["left_out"]["frames that lie between no two meshes"] == "1: 100004"
    assert json.loads((imported[1] / "sync.json").read_text())["verdict"] == "in_sync"


def test_a_capture_that_was_not_preprocessed_is_told_what_makes_its_meshes(shipped, tmp_path):
    made = shutil.ignore_patterns("alpha_birefnet", "facer_segmentation", "flame_tracking")
    root = shutil.copytree(shipped, tmp_path / "1001", ignore=made)
    with pytest.raises(InputError, match=r"meshes_posed: expected meshes, found none; .*flame_tracker\.py"):
        run(dataset="becominglit", source=root, subject="x", out=tmp_path / "out")


def test_the_fake_is_as_the_sets_loader_reads_it(truth, shipped):
    """Its own steps: K over its downscale without a shift, camera-from-world, meshes in the world."""
    content = json.loads((shipped / "calibration/camera_calibration.json").read_text())
    shared, pose = content["cam_data"], np.array(content["world_to_cam"][CAMERAS[2]])
    lines = (shipped / "sequences/FREE/flame_tracking/meshes_posed/frame_000000.ply").read_bytes()
    start = lines.index(b"end_header\n") + len(b"end_header\n")
    vertices = np.frombuffer(lines[start:], "<f4", 3 * len(truth.vertices(9))).reshape(-1, 3)
    seen = vertices @ pose[:3, :3].T + pose[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] * [shared["fx"], shared["fy"]] + [shared["cx"], shared["cy"]]
    expected = truth.cameras[CAMERAS[2]].project(truth.vertices(SEQUENCES["FREE"][0])) + 0.5
    np.testing.assert_allclose(pixels, expected, atol=1e-4)


def test_a_quarter_of_the_size_is_the_mean_of_light(truth, shipped, tmp_path):
    """The loader's own downscale: K over 4, images averaged; nothing is copied."""
    capture, results = import_set("becominglit", shipped, tmp_path, ImportCapture(reduced=4))
    facts = json.loads((results / "index/capture.json").read_text())["images"]
    source = ImageSource.from_index(capture, facts)
    row = pd.read_parquet(results / "index/images.parquet").set_index(["camera", "frame"]).loc[CAMERAS[1], 100000]
    whole = ImageSource.from_index(capture, {**facts, "reduced": 1}).read(row.path, None)
    small, mask = source.read(row.path, None), source.read_mask(row.mask_path, (18, 12))
    assert small.shape == (18, 12, 3) and mask.shape == (18, 12)
    np.testing.assert_allclose(small[5, 3], whole[20:24, 12:16].mean((0, 1)), rtol=1e-5)
    assert mask[9, 6] == 255 and mask[mask < 255].max() > 0
    assert facts["downsample_from_sensor"] == 4
    tracked = pd.read_parquet(results / "tracking/0000.parquet")
    assert tracked.observations.max() > 0 and tracked.rms_px.max() < 0.1, "landmarks are reduced, too"
    assert_true_cameras(results, truth, CAMERAS, 4)
    described = yaml.safe_load((capture / "capture.yaml").read_text())["imported"]["computed"]
    assert described["resolution"] == "import_capture.reduced: means of 4 x 4 pixels, as read"


def test_preset_leads_to_the_table_that_is_promised(truth, shipped, tmp_path):
    """Of a set whose other sequences show the first frame of one."""
    root, cameras = shutil.copytree(shipped, tmp_path / "1001", copy_function=os.link), (*CAMERAS[:2], TEST_CAMERA)
    later = shutil.ignore_patterns("light_pattern_per_frame.json", "frame_00000[1-9].*")
    for name in ("EMOTIONS", "SEN-1", "SEN-2", "SEN-3"):
        shutil.copytree(root / "sequences/EXP-2", root / "sequences" / name, copy_function=os.link, ignore=later)
        (root / "sequences" / name / "light_pattern_per_frame.json").write_text("[[0, 0]]")
    sizes = {name: tuple(side // 4 for side in truth.image_size(name)) for name in cameras}
    score_as_preset("becominglit", root, tmp_path, sizes, cameras=cameras)
