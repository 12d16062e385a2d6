"""Keypoints in a detector's order, and keypoints and masks that were detected, in the index of a tiny capture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.capture.images import ImageSource
from pipeline.capture.index.detected_files import DetectedFiles
from pipeline.capture.index.validation import index_folder
from pipeline.capture.keypoint_orders import EYE_COLUMNS
from tests.support.captures.builder import HEIGHT, WIDTH, build_capture, edit_manifest, write_lines


@pytest.fixture
def capture(tmp_path):
    root = build_capture(tmp_path / "tiny")
    write_lines(root / "template/keypoints.csv", "keypoint,node_index", "mid_hip,1", "kp7,2")
    return root


def write_keypoints(root, keypoints):
    rows = [(0, "left", keypoint, 1.0 + n, 2.0, 0.5) for n, keypoint in enumerate(keypoints)]
    table = pd.DataFrame(rows, columns=["frame", "camera", "keypoint", "x", "y", "confidence"])
    table.to_parquet(root / "keypoints_2d.parquet", index=False)


def in_order(root, order, **template):
    def edit(manifest):
        manifest["keypoints_order"] = order
        manifest["template"] |= template

    edit_manifest(root, edit)


def test_numbers_of_an_order_become_the_templates_names(capture, tmp_path):
    write_keypoints(capture, ["8", "0", "17"])  # BODY_25: the middle of the hips, the nose, an ear.
    write_lines(capture / "template/points.csv", "keypoint,point", "kp7,nose")
    in_order(capture, "openpose_body_25", points="template/points.csv")
    assert index_folder(capture, folder=tmp_path).keypoints == 2
    found = pd.read_parquet(tmp_path / "keypoints_2d.parquet")
    assert [(row.keypoint, row.x) for row in found.itertuples()] == [("kp7", 2.0), ("mid_hip", 1.0)]


def test_label_that_the_order_does_not_have_is_named(capture):
    write_keypoints(capture, ["MidHip", "Tail"])
    in_order(capture, "openpose_body_25")
    with pytest.raises(InputError, match=r"keypoints_2d.parquet: keypoint: .*openpose_body_25, found Tail"):
        index_folder(capture)


def test_template_that_shares_no_point_with_the_order_is_refused(capture):
    write_keypoints(capture, ["3"])
    in_order(capture, "ibug_68")
    with pytest.raises(InputError, match=r"template.keypoints: expected points of ibug_68, .*; name keypoints so, or"):
        index_folder(capture)


def test_points_of_a_template_are_checked(capture):
    write_lines(capture / "template/points.csv", "keypoint,point", "kp9,nose", "kp7,snout")
    in_order(capture, "coco_17", points="template/points.csv")
    with pytest.raises(InputError) as caught:
        index_folder(capture)
    assert "keypoint: " in str(caught.value) and "kp9" in str(caught.value) and "snout" in str(caught.value)


def test_detected_keypoints_and_masks_stand_in_for_the_captures(capture, tmp_path):
    folder = tmp_path / "results/detected"
    (folder / "masks/left").mkdir(parents=True)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[2:4, 3:7] = 255
    assert cv2.imwrite(str(folder / "masks/left/000000.png"), mask)
    row = {"camera": "left", "frame": 0, "mask_path": "left/000000.png", "digest": "abc", "share": 0.1}
    pd.DataFrame([row]).to_parquet(folder / "masks.parquet", index=False)
    write_keypoints(folder, ["kp7"])
    eyes = pd.DataFrame([(0, "left", "left_pupil", 1.0, 2.0, 0.5)], columns=list(EYE_COLUMNS))
    eyes.to_parquet(folder / "eye_points.parquet", index=False)
    detected = DetectedFiles(folder / "keypoints_2d.parquet", folder / "masks.parquet")
    index = index_folder(capture, detected=detected, folder=tmp_path)
    assert pd.read_parquet(tmp_path / "keypoints_2d.parquet")["keypoint"].tolist() == ["kp7"]
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "eye_points.parquet"), eyes)
    images = index.tables["images"].set_index(["camera", "frame"])
    assert images.mask_path.notna().sum() == 1 and images.mask_digest[("left", 0)] == "abc"
    source = ImageSource.from_index(capture, index.contents["capture"]["images"])
    np.testing.assert_array_equal(source.read_mask(images.mask_path[("left", 0)], mask.shape), mask)


def test_clean_plates_stand_in_for_masks_and_both_are_one_too_many(capture):
    plates = "plates/{camera}.exr"
    edit_manifest(capture, lambda manifest: manifest["masks"].update(clean_plates=plates))
    with pytest.raises(InputError, match=r"masks.path: expected this pattern, or else masks.clean_plates, found both"):
        index_folder(capture)
    edit_manifest(capture, lambda manifest: manifest["masks"].pop("path"))
    write_keypoints(capture, ["kp7"])
    assert index_folder(capture).tables["images"]["mask_path"].isna().all()


def test_table_of_other_masks_is_refused(capture, tmp_path):
    table = tmp_path / "masks.parquet"
    pd.DataFrame({"camera": ["left"], "frame": [0]}).to_parquet(table)
    with pytest.raises(InputError, match="expected the table of segment_subject, found no digest, mask_path"):
        index_folder(capture, detected=DetectedFiles(masks=Path(table)))
