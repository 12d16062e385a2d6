"""Which subjects get keypoints and masks from their photographs."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from pipeline.config.loading import load_project
from pipeline.workflow.detected_files import READY, detected_keypoints, detected_masks
from pipeline.workflow.job_files import JobFiles

KEYPOINTS, MASKS = ["results/someone/detected/keypoints_2d.parquet"], ["results/someone/detected/masks.parquet"]
NEITHER = {"images": {"path": "i"}}


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A function: both lists of files, of a recorded capture with this description and these settings."""
    monkeypatch.chdir(tmp_path)
    folder = Path("captures/someone")
    folder.mkdir(parents=True)
    Path("config/subjects").mkdir(parents=True)

    def of(description, ready=False, **settings):
        (folder / "capture.yaml").write_text(yaml.safe_dump(description))
        Path("config/subjects/someone.yaml").write_text(yaml.safe_dump(settings or {"chunk_frames": 64}))
        if ready:
            READY.parent.mkdir(exist_ok=True)
            READY.touch()
        job = JobFiles(load_project({}, {}, Path("config/subjects")), "someone")
        return detected_keypoints(job), detected_masks(job)

    return of


def test_capture_without_either_gets_both_once_the_detector_is_there(files):
    assert files(NEITHER) == ([], [])
    assert files(NEITHER, ready=True) == (KEYPOINTS, MASKS)


def test_detector_that_is_named_needs_no_environment(files):
    assert files(NEITHER, detect_landmarks={"detector": "my-detector"}) == (KEYPOINTS, [])


def test_capture_with_both_keeps_them_unless_others_are_asked_for(files):
    both = {"keypoints_2d": "k.parquet", "masks": {"path": "m"}}
    assert files(both, ready=True) == ([], [])
    asked = {"detect_landmarks": {"use": "always"}, "segment_subject": {"use": "always"}}
    assert files(both, **asked) == (KEYPOINTS, MASKS)


def test_clean_plates_need_no_detector(files):
    assert files({"keypoints_2d": "k.parquet", "masks": {"clean_plates": "p"}}) == ([], MASKS)


def test_meshes_and_never_leave_it(files):
    assert files({"meshes": {"table": "t"}}, ready=True) == ([], [])
    never = {"detect_landmarks": {"use": "never"}, "segment_subject": {"use": "never"}}
    assert files({"masks": {"clean_plates": "p"}}, ready=True, **never) == ([], [])


def test_masks_that_a_table_of_images_lists_are_the_captures(files):
    assert files({"keypoints_2d": "k.parquet", "images": {"table": "t"}}, ready=True) == ([], [])


def test_synthetic_subject_is_asked_for_by_name(files):
    assert files({}, ready=True, source="synthetic") == ([], [])
    assert files({}, source="synthetic", detect_landmarks={"use": "always"}) == (KEYPOINTS, [])
