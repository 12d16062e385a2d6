"""A Goliath capture in the set's layout, imported and compared with what it was made from."""

from __future__ import annotations

import json
import logging
import shutil
import zipfile

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.capture.images import ImageSource
from pipeline.config.import_capture import ImportCapture
from pipeline.geometry.cameras import read_cameras
from pipeline.stages import segment_subject
from pipeline.stages.import_capture import run
from tests.support.datasets.goliath_layout import (
    BLACK,
    BLIND_CAMERA,
    CAMERAS,
    DURATION,
    WHITE_BALANCE,
    light_pattern,
    part_labels,
    pattern_of,
    png,
    stored,
    true_head,
    write_goliath,
    write_zip,
)
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set

KEPT = [*range(7), 9, 10, 11, 12]
"""Frames with a mesh or between two of their segment: the second begins, and ends, beside one only."""

ALONE = {7, 8, 13}


@pytest.fixture(scope="module")
def truth():
    return true_head()


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_goliath(tmp_path_factory.mktemp("set"), truth)


@pytest.fixture(scope="module")
def imported(shipped, tmp_path_factory):
    """Folders of the native capture, and of the results of the stages that follow."""
    before = sizes(shipped)
    capture, results = import_set("goliath", shipped, tmp_path_factory.mktemp("imported"))
    assert sizes(shipped) == before, "something was written into the set"
    return capture, results


def sizes(folder):
    return {path: path.stat().st_size for path in folder.rglob("*") if path.is_file()}


def test_cameras_project_as_the_true_ones(truth, imported):
    assert BLIND_CAMERA in truth.cameras
    assert_true_cameras(imported[1], truth, CAMERAS, 4)
    for name, camera in read_cameras(imported[1] / "calibration/cameras.json").items():
        assert (camera.width, camera.height) == (truth.cameras[name].width, truth.cameras[name].height)


def test_lights_and_patterns_are_the_true_ones(truth, imported):
    assert_true_lights(imported[1], truth)
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    assert sorted(patterns.frame.unique()) == KEPT
    for frame, rows in patterns.groupby("frame"):
        expected = {f"L{light:03d}": duration / DURATION for light, duration in light_pattern(pattern_of(frame))}
        assert dict(zip(rows.light, rows.intensity_g, strict=True)) == pytest.approx(expected, abs=1e-12)


def test_meshes_are_the_true_ones_also_between_lit_frames(truth, imported):
    arrays = read_arrays(imported[1] / "tracking/0000.safetensors")
    table = pd.read_parquet(imported[1] / "tracking/0000.parquet")
    assert arrays["frames"].tolist() == KEPT
    assert table.status.tolist() == ["given" if pattern_of(frame) == 0 else "between" for frame in KEPT]
    for frame, vertices in zip(KEPT, arrays["vertices"], strict=True):
        np.testing.assert_allclose(vertices, truth.vertices(frame), atol=1e-6)
    assert (table.silhouette_iou[table.masks > 0] > 0.8).all()


def test_images_masks_and_colours_are_read_in_place(truth, imported):
    capture, results = imported
    images = pd.read_parquet(results / "index/images.parquet")
    assert len(images) == len(CAMERAS) * len(KEPT) and images.mask_path.isna().sum() == len(CAMERAS) * 6
    source = ImageSource.from_index(capture, json.loads((results / "index/capture.json").read_text())["images"])
    colors = json.loads((results / "calibration/color.json").read_text())["cameras"]
    row = images[(images.camera == CAMERAS[1]) & (images.frame == 3)].iloc[0]
    shown = source.read(row.path, int(row.frame)) @ np.array(colors[CAMERAS[1]]).T
    counts = stored(truth.image(CAMERAS[1], 3)).astype(np.float64)
    # AVIF is lossy: a few counts of 255.
    np.testing.assert_allclose(shown, (counts - BLACK) * WHITE_BALANCE / 255, atol=0.06)
    mask = source.read_mask(row.mask_path, shown.shape)
    labels = part_labels(truth, CAMERAS[1], 3)
    np.testing.assert_array_equal(mask, np.kron(np.isin(labels, (1, 2)), np.ones((2, 2))) * 255)
    copied = [path for path in capture.iterdir() if path.is_file()]
    assert not {path.suffix for path in copied} & {".avif", ".png", ".zip", ".ply"}


def test_splits_and_provenance_are_the_sets(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    assert described["splits"]["test_cameras"] == ["401645"]
    assert described["splits"]["test_segments"] == ["SEN_fox"]
    left_out = described["imported"]["left_out"]
    assert left_out["frames that lie between no two meshes"] == "3: 7, 8, 13"
    assert left_out["cameras without images"] == f"1: {BLIND_CAMERA}"
    assert left_out["lights that no pattern turns on"] == "1: L016"


def test_backgrounds_mask_fully_lit_frames_where_they_are_asked_for(truth, imported, tmp_path):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    plates = "source/per_view_background/per_view_background.zip/{camera}.png"
    assert described["masks"]["clean_plates"] == plates
    assert "segment_subject" in described["imported"]["given"]["clean plates"]
    segment_subject.run(capture=imported[0], out=tmp_path / "out")
    table = pd.read_parquet(tmp_path / "out/masks.parquet")
    assert sorted(table.frame.unique()) == [frame for frame in KEPT if pattern_of(frame) == 0]
    row = table[(table.camera == CAMERAS[1]) & (table.frame == 3)].iloc[0]
    found = cv2.imread(str(tmp_path / "out/masks" / row.mask_path), cv2.IMREAD_UNCHANGED) >= 128
    shown = truth.image(CAMERAS[1], 3).max(2) > 0
    assert (found & shown).sum() / (found | shown).sum() > 0.9


def test_without_a_background_of_every_camera_none_is_taken(shipped, tmp_path):
    root = broken_copy(shipped, tmp_path)
    (root / "per_view_background/per_view_background.zip").unlink()
    run(dataset="goliath", source=root, subject="x", out=tmp_path / "out")
    assert "clean_plates" not in yaml.safe_load((tmp_path / "out/capture.yaml").read_text())["masks"]


@pytest.mark.parametrize("other", [(2, 3), (1, 4)], ids=["half the size", "four channels"])
def test_backgrounds_unlike_the_images_are_left_out_and_their_cameras_named(truth, shipped, tmp_path, other):
    root = broken_copy(shipped, tmp_path)
    plates = {}
    for name in CAMERAS:
        width, height = truth.image_size(name)
        smaller, channels = other if name == CAMERAS[1] else (1, 3)
        plates[f"{name}.png"] = png(np.zeros((height // smaller, width // smaller, channels), np.uint8))
    write_zip(root / "per_view_background/per_view_background.zip", plates)
    run(dataset="goliath", source=root, subject="x", out=tmp_path / "out")
    described = yaml.safe_load((tmp_path / "out/capture.yaml").read_text())
    assert "clean_plates" not in described["masks"]
    left_out = described["imported"]["left_out"]["per_view_background/per_view_background.zip"]
    assert left_out.endswith(f"as large as their images: {CAMERAS[1]}")


def broken_copy(shipped, folder):
    root = folder / shipped.name
    shutil.copytree(shipped, root)
    return root


def refusal(root, out, **settings):
    with pytest.raises(InputError) as caught:
        run(dataset="goliath", source=root, subject="x", out=out, settings=ImportCapture(**settings))
    assert not (out / "capture.yaml").exists()
    return str(caught.value)


def test_everything_that_is_missing_is_named_at_once(shipped, tmp_path):
    root = broken_copy(shipped, tmp_path)
    (root / "head_pose/head_pose.zip").unlink()
    (root / "lights/light_pattern_metadata.json").unlink()
    message = refusal(root, tmp_path / "out")
    assert "2 problems" in message and "head_pose/head_pose.zip" in message
    assert "light_pattern_metadata.json: file: expected one, found none; it is part of the release" in message


def test_matrices_that_are_not_transposed_are_refused(shipped, tmp_path):
    root = broken_copy(shipped, tmp_path)
    path = root / "camera_calibration.json"
    content = json.loads(path.read_text())
    for entry in content["KRT"]:
        entry["K"] = np.array(entry["K"]).T.tolist()
    path.write_text(json.dumps(content))
    assert "expected K and T transposed" in refusal(root, tmp_path / "out")


def test_inverted_head_poses_do_not_pass_the_masks(truth, shipped, tmp_path):
    root = broken_copy(shipped, tmp_path)
    with zipfile.ZipFile(root / "head_pose/head_pose.zip", "w") as archive:
        for frame in truth.keyed:
            R, t = truth.pose(frame)
            rows = np.concatenate([R.T, -1000 * (R.T @ t)[:, None]], axis=1)
            archive.writestr(f"{frame:06d}.txt", "\n".join(" ".join(map(str, row)) for row in rows))
    message = refusal(root, tmp_path / "out")
    assert "expected at least 0.5 of the projected meshes in the masks, found 0." in message


def test_meshes_without_faces_ask_for_a_topology(truth, shipped, tmp_path):
    root = broken_copy(shipped, tmp_path)
    (root / "kinematic_tracking/template_mesh.obj").rename(tmp_path / "faces.obj")
    assert "set import_capture.topology" in refusal(root, tmp_path / "out")
    settings = ImportCapture(topology=str(tmp_path / "faces.obj"), cameras=("400001", "400130"), segments=("EXP_brow",))
    run(dataset="goliath", source=root, subject="x", out=tmp_path / "out", settings=settings)
    assert pd.read_csv(tmp_path / "out/frames.csv").frame.tolist() == list(range(7))
    assert pd.read_csv(tmp_path / "out/cameras.csv").camera.astype(str).tolist() == ["400001", "400130"]


def test_frames_without_meshes_are_named_in_the_log(shipped, tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        run(dataset="goliath", source=shipped, subject="x", out=tmp_path / "out")
    assert "3 frames lie between no two meshes of their segment; left out: [7, 8, 13]" in caplog.text
    assert "6 frames without a mesh lie between two and get an interpolated one: [1, 2, 4, 5, 10, 11]" in caplog.text


def test_the_fake_is_as_the_sets_loader_reads_it(truth, shipped):
    """Its own steps: transposed K and T, half a pixel, world-from-head, labels twice as large."""
    entry = next(e for e in json.loads((shipped / "camera_calibration.json").read_text())["KRT"]
                 if e["cameraId"] == CAMERAS[0])  # fmt: skip
    K, Rt = np.array(entry["K"]).T, np.array(entry["T"]).T[:3, :4]
    K[:2, :2] /= 2
    K[:2, 2] = (K[:2, 2] + 0.5) / 2 - 0.5
    with zipfile.ZipFile(shipped / "head_pose/head_pose.zip") as archive:
        pose = np.array([line.split(" ") for line in archive.read("000003.txt").decode().splitlines()], np.float64)
    world = 1000 * truth.in_head(3) @ pose[:, :3].T + pose[:, 3]
    seen = world @ Rt[:, :3].T + Rt[:, 3]
    pixels = (seen[:, :2] / seen[:, 2:]) @ K[:2, :2].T + K[:2, 2]
    with zipfile.ZipFile(shipped / f"segmentation_parts/cam{CAMERAS[0]}.zip") as archive:
        content = np.frombuffer(archive.read(f"cam{CAMERAS[0]}/000003.png"), np.uint8)
    labels = cv2.imdecode(content, cv2.IMREAD_UNCHANGED).repeat(2, 0).repeat(2, 1)
    at = np.round(pixels).astype(int)
    inside = np.isin(labels[at[:, 1], at[:, 0]], (1, 2))
    assert inside.mean() > 0.9, "only vertices on the outline may fall beside it"
