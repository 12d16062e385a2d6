"""Keypoints and masks of photographs: the plumbing by a detector that says what the test says, MediaPipe on a face."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

import pipeline.stages.detect_landmarks as detect_landmarks
import pipeline.stages.segment_subject as segment_subject
from pipeline.base.errors import InputError
from pipeline.config.detect_landmarks import DetectLandmarks
from pipeline.config.segment_subject import SegmentSubject
from pipeline.detection import detector, mediapipe_detector
from pipeline.stages import index_capture
from tests.support.captures.builder import (
    CAMERAS,
    HEIGHT,
    WIDTH,
    build_capture,
    edit_manifest,
    save_exr,
    write_lines,
)
from tests.support.detection import fake_detector
from tests.support.shared_data import shared_data

MEDIAPIPE = Path(__file__).resolve().parents[2] / detector.ENVIRONMENT / "bin/python"
needs_mediapipe = pytest.mark.skipif(not MEDIAPIPE.is_file(), reason="no .venv-detect: make detect")
FACE, needs_face = shared_data("data/face_near_lights")


@pytest.fixture
def capture(tmp_path):
    """Without keypoints and masks; frame 0 alone is fully lit."""
    root = build_capture(tmp_path / "tiny")
    edit_manifest(root, lambda manifest: [manifest.pop(key) for key in ("keypoints_2d", "masks")])
    write_lines(root / "template/keypoints.csv", "keypoint,node_index", "mid_hip,1", "nose,2")
    return root


@pytest.fixture
def fake(tmp_path):
    """A function: the command of a detector that finds what the plan says."""

    def command(**plan):
        path = tmp_path / "plan.json"
        path.write_text(json.dumps(plan))
        return f"{sys.executable} {fake_detector.__file__} {path}"

    return command


def test_keypoints_of_fully_lit_frames_are_named_as_the_template_names_them(capture, tmp_path, fake):
    points = [
        ("openpose_body_25", 8, 3.5, 2.25, 0.75), ("coco_17", 0, 4.5, 1.25, 0.5), ("coco_17", 1, 1.0, 1.0, 0.9),
        ("ibug_68", 3, 2.0, 2.0, 0.9), ("smplx_144", 55, 9.0, 1.0, 0.9),
    ]  # fmt: skip
    command = fake(points=points, shown=str(tmp_path / "shown"))
    out = tmp_path / "detected"
    detect_landmarks.run(capture=capture, out=out, settings=DetectLandmarks(detector=command))
    table = pd.read_parquet(out / "keypoints_2d.parquet")
    # SMPL-X's nose, the surer one, is outside the image; eye and jaw are no keypoints of the template.
    mine = [("mid_hip", 3.5, 2.25, 0.75), ("nose", 4.5, 1.25, 0.5)]
    expected = [(0, camera, *row) for camera in CAMERAS for row in mine]
    assert list(table.itertuples(index=False, name=None)) == expected
    assert sorted(path.name for path in (tmp_path / "shown").iterdir()) == ["left_0.png", "right_0.png"]
    counts = pd.read_csv(out / "landmarks.csv")
    assert counts.to_dict("list") == {"camera": list(CAMERAS), "images": [1, 1], "found": [1, 1], "keypoints": [2, 2]}
    assert (cv2.imread(str(out / "landmarks.png")) > 0).any()


def test_detector_sees_the_picture_exposed_and_in_srgb(capture, tmp_path, fake):
    """Grey at 1 and 4 % of a lamp's brightness becomes sRGB's 25 % and 100 %, scaled by the 99.5th percentile."""
    for camera in CAMERAS:
        dark = np.full((HEIGHT, WIDTH, 3), 0.01)
        dark[:, :4] = 0.04
        save_exr(capture / f"images/{camera}/000000.exr", dark)
    settings = DetectLandmarks(detector=fake(points=[], shown=str(tmp_path / "shown")))
    detect_landmarks.run(capture=capture, out=tmp_path / "out", settings=settings)
    shown = cv2.imread(str(tmp_path / "shown/left_0.png"))
    encoded = round(255 * (1.055 * 0.25 ** (1 / 2.4) - 0.055))
    assert np.unique(shown).tolist() == [encoded, 255]


def test_all_frames_are_looked_at_if_asked_for(capture, tmp_path, fake):
    settings = DetectLandmarks(detector=fake(points=[("coco_17", 0, 1.0, 1.0, 1.0)]), frames="all")
    detect_landmarks.run(capture=capture, out=tmp_path / "out", settings=settings)
    assert pd.read_parquet(tmp_path / "out/keypoints_2d.parquet")["frame"].tolist() == [0, 0, 1, 1, 2, 2]


def test_index_takes_what_was_detected(capture, tmp_path, fake):
    out, index = tmp_path / "detected", tmp_path / "index"
    points = [("coco_17", 0, 1.5, 2.5, 0.5), ("wflw_98", 96, 4.0, 2.0, 0.9)]
    command = fake(points=points, mask=[1, 4, 2, 7])
    detect_landmarks.run(capture=capture, out=out, settings=DetectLandmarks(detector=command))
    segment_subject.run(capture=capture, out=out, settings=SegmentSubject(detector=command))
    keypoints, masks = out / "keypoints_2d.parquet", out / "masks.parquet"
    index_capture.run(capture=capture, out=index, detected_keypoints=keypoints, detected_masks=masks)
    images = pd.read_parquet(index / "images.parquet")
    assert images[images.mask_path.notna()].frame.tolist() == [0, 0]
    assert pd.read_parquet(index / "keypoints_2d.parquet")["keypoint"].tolist() == ["nose", "nose"]
    # The template has no such keypoint; estimate_gaze reads it.
    assert pd.read_parquet(index / "eye_points.parquet")["point"].tolist() == ["right_pupil", "right_pupil"]
    assert json.loads((index / "capture.json").read_text())["images"]["mask_folder"] == str(out / "masks")


def test_plates_mask_the_subject_without_a_detector(tmp_path):
    """16 x 16 pixels of noise, a square of 8 x 8 before them."""
    root, random = build_capture(tmp_path / "tiny"), np.random.default_rng(3)
    side, truth = 32, np.zeros((32, 32), bool)
    truth[8:24, 10:26] = True
    edit_manifest(root, lambda manifest: manifest.update(masks={"clean_plates": "plates/{camera}.exr"}))
    rows = [f"{camera},{side},{side},{2 * side},{2 * side}" for camera in CAMERAS]
    write_lines(root / "cameras.csv", "camera,width,height,sensor_width,sensor_height", *rows)
    for camera in CAMERAS:
        save_exr(root / f"plates/{camera}.exr", random.normal(0.1, 0.002, (side, side, 3)), dtype=np.float32)
        image = random.normal(0.1, 0.002, (side, side, 3)) + 0.3 * truth[..., None]
        save_exr(root / f"images/{camera}/000000.exr", image, dtype=np.float32)
    segment_subject.run(capture=root, out=tmp_path / "out", settings=SegmentSubject())
    table = pd.read_parquet(tmp_path / "out/masks.parquet")
    assert table[["camera", "frame"]].to_numpy().tolist() == [["left", 0], ["right", 0]]
    for path in table.mask_path:
        mask = cv2.imread(str(tmp_path / "out/masks" / path), cv2.IMREAD_UNCHANGED) > 0
        assert (mask ^ truth).sum() <= 4  # The square's corners, which closing by a disc rounds.


class TestRefused:
    def test_detector_that_fails_with_what_it_said(self, capture, tmp_path, fake):
        settings = DetectLandmarks(detector=fake(fails=True))
        with pytest.raises(InputError, match=r"detector: .*found exit status 1:\nno model here"):
            detect_landmarks.run(capture=capture, out=tmp_path / "out", settings=settings)
        assert not (tmp_path / "out").exists()

    def test_detector_that_is_not_there(self, capture, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(
            InputError, match=r"\.venv-detect/bin/python: expected the environment .* run `make detect`"
        ):
            detect_landmarks.run(capture=capture, out=tmp_path / "out")
        with pytest.raises(InputError, match="detector: expected a program that can be started, found /nowhere/it"):
            segment_subject.run(capture=capture, out=tmp_path / "out", settings=SegmentSubject(detector="/nowhere/it"))

    def test_order_that_nobody_knows(self, capture, tmp_path, fake):
        settings = DetectLandmarks(detector=fake(points=[("body_135", 0, 1.0, 1.0, 1.0)]))
        with pytest.raises(InputError, match=r"detector: order: expected one of .*coco_17.*, found body_135"):
            detect_landmarks.run(capture=capture, out=tmp_path / "out", settings=settings)

    def test_template_whose_keypoints_nobody_finds(self, capture, tmp_path):
        write_lines(capture / "template/keypoints.csv", "keypoint,node_index", "kp0,1", "kp1,2")
        with pytest.raises(InputError, match=r"template.keypoints: expected points that a detector finds, .*points"):
            detect_landmarks.run(capture=capture, out=tmp_path / "out")

    def test_capture_without_a_fully_lit_frame(self, capture, tmp_path):
        write_lines(capture / "patterns.csv", "frame,light,intensity", "0,A,1.0", "1,B,1.0")
        with pytest.raises(InputError, match=r"patterns.csv: expected fully lit frames, .* set `frames: all`"):
            segment_subject.run(capture=capture, out=tmp_path / "out")

    def test_plate_of_another_size(self, capture, tmp_path):
        edit_manifest(capture, lambda manifest: manifest.update(masks={"clean_plates": "plates/{camera}.exr"}))
        save_exr(capture / "plates/left.exr", np.zeros((HEIGHT + 1, WIDTH, 3)))
        with pytest.raises(InputError, match=r"plates/left.exr: expected 8 x 6 pixels, .* found 8 x 7"):
            segment_subject.run(capture=capture, out=tmp_path / "out")


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """Landmarks of the real face under one lamp, at an eighth of its resolution: number -> pixel."""
    folder = tmp_path_factory.mktemp("face")
    small = cv2.imread(str(FACE / "0001.png"), cv2.IMREAD_REDUCED_COLOR_8).astype(np.float64)
    bright = np.clip(small / np.percentile(small, 99.5), 0, 1)
    assert cv2.imwrite(str(folder / "face.png"), np.round(255 * bright ** (1 / 2.2)).astype(np.uint8))
    write_lines(folder / "images.csv", "image,path,camera,frame", f"0,{folder / 'face.png'},c,0")
    words = ["--images", str(folder / "images.csv"), "--out", str(folder / "points.csv"), "--parts", "face"]
    detector.run_detector(f"{MEDIAPIPE} {mediapipe_detector.__file__}", ["landmarks", *words])
    points = detector.read_points(folder / "points.csv")
    return points.assign(number=points["number"].astype(int)).set_index("number")[["x", "y"]]


@needs_face
@needs_mediapipe
def test_real_face_is_found_where_it_is(photographed):
    """Against the mask that comes with the photographs, and what is symmetrical about a face."""
    assert len(photographed) == 478
    mask = cv2.imread(str(FACE / "mask_2601x1732.png"), cv2.IMREAD_GRAYSCALE) > 0
    inner = photographed.loc[[4, 33, 133, 263, 362, 61, 291, 168]]
    # The mask is half as fine as the photographs, four times as fine as what the detector saw.
    rows, columns = (4 * inner.to_numpy()[:, ::-1]).astype(int).T
    assert mask[rows, columns].all()
    right, left = photographed.loc[33], photographed.loc[263]
    assert right.x < photographed.loc[4].x < left.x, "the person's right is on the image's left"
    assert photographed.loc[168].y < photographed.loc[4].y < photographed.loc[13].y < photographed.loc[152].y
