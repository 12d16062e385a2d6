"""A NeRSemble participant in the set's layout, imported and compared with what it was made from."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.color import corrected
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.capture.images import ImageSource
from pipeline.config.import_capture import ImportCapture
from pipeline.stages.import_capture import run
from tests.support.datasets.imported import assert_true_cameras, import_set
from tests.support.datasets.nersemble_layout import (
    CAMERAS,
    FPS,
    SEQUENCES,
    SHORT,
    TEST_CAMERA,
    TEST_SEQUENCE,
    TURN,
    expanded,
    polynomial_of,
    true_head,
    write_meshes,
    write_nersemble,
)

FRAMES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 6, 100000: 9, 100001: 10, 100002: 11, 100003: 12}
"""Imported -> true: the sequences are EXP-2-eyes and FREE, whose last frame lies behind its last mesh."""


@pytest.fixture(scope="module")
def truth():
    return true_head()


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_nersemble(tmp_path_factory.mktemp("set"), truth)


@pytest.fixture(scope="module")
def settings(truth, tmp_path_factory):
    return ImportCapture(mesh=str(write_meshes(tmp_path_factory.mktemp("meshes"), truth)))


@pytest.fixture(scope="module")
def imported(shipped, settings, tmp_path_factory):
    """Folders of the native capture, and of the results of the stages that follow."""
    return import_set("nersemble", shipped, tmp_path_factory.mktemp("imported"), settings)


def test_cameras_and_meshes_are_the_true_ones_in_a_world_whose_y_is_up(truth, imported):
    assert_true_cameras(imported[1], truth, CAMERAS, 4)
    arrays = read_arrays(imported[1] / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == sorted(FRAMES)
    for frame, vertices in zip(arrays["frames"], arrays["vertices"], strict=True):
        given = FRAMES[frame] in truth.keyed
        # Between meshes the head turns about the middle that was fitted.
        np.testing.assert_allclose(vertices, truth.vertices(FRAMES[frame]), atol=1e-6 if given else 1e-3)


def test_frames_of_videos_are_read_in_place_with_their_polynomials(truth, imported):
    capture, results = imported
    source = ImageSource.from_index(capture, json.loads((results / "index/capture.json").read_text())["images"])
    colors = json.loads((results / "calibration/color.json").read_text())["cameras"]
    images = pd.read_parquet(results / "index/images.parquet").set_index(["camera", "frame"])
    assert len(images) == len(CAMERAS) * len(FRAMES)
    for camera, frame in ((CAMERAS[1], 100002), (CAMERAS[0], 3), (CAMERAS[0], 2)):
        row = images.loc[camera, frame]
        stored = source.read(row.path, frame)
        np.testing.assert_allclose(np.array(colors[camera]), polynomial_of(camera), rtol=1e-12)
        shown = corrected(stored, np.array(colors[camera]))
        np.testing.assert_allclose(shown, expanded(stored) @ polynomial_of(camera).T, atol=1e-6)
        true, mask = truth.image(camera, FRAMES[frame]), source.read_mask(row.mask_path, stored.shape)
        # Videos of so few pixels lose much of their chroma; means over the head little.
        inside = cv2.erode((true.max(2) > 0.02).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        np.testing.assert_allclose(shown[inside].mean(0), true[inside].mean(0), rtol=0.1)
        assert (mask[inside] >= 128).mean() > 0.98 and (mask[:4] < 128).all()


def test_splits_light_and_provenance_are_said(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    assert described["splits"]["test_cameras"] == [TEST_CAMERA]
    assert described["splits"]["test_segments"] == [TEST_SEQUENCE]
    assert described["constant_light"] is True and described["fps"] == FPS
    left_out, given = (described["imported"][word] for word in ("left_out", "given"))
    assert left_out["frames that lie between no two meshes"] == "1: 100004"
    assert left_out["images that are not there"] == f"1 of {SHORT[0]} {SHORT[1]}"
    assert "of the projected meshes lies in the masks" in given["meshes"]
    assert "K is of 2200 x 3208" in given["cameras"] and "11 terms" in given["colour"]
    assert not any(path.suffix in (".png", ".jpg", ".avif") for path in imported[0].iterdir()), "no second set"


def test_without_masks_or_colours_that_is_said(shipped, settings, tmp_path, caplog):
    root = shutil.copytree(shipped, tmp_path / "set", ignore=shutil.ignore_patterns("alpha_maps", "color_cal*"))
    run(dataset="nersemble", source=root, subject="x", out=tmp_path / "out", settings=settings)
    imported = yaml.safe_load((tmp_path / "out/capture.yaml").read_text())["imported"]
    assert "outlines of the meshes, for 55 of 55 images" in imported["computed"]["masks"]
    assert "color_calibration.json is not there" in imported["left_out"]["colour"] and "not there" in caplog.text
    assert "assumed: light: 32 lights of one brightness" in caplog.text
    assert not (tmp_path / "out/color.json").exists()


def test_what_is_missing_or_wrong_is_said(shipped, settings, tmp_path):
    def refusal(root, chosen=settings):
        with pytest.raises(InputError) as caught:
            run(dataset="nersemble", source=root, subject="x", out=tmp_path / "out", settings=chosen)
        return str(caught.value)

    assert "2 problems" in refusal(shipped.parent)
    assert "the set ships none: fit FLAME" in refusal(shipped, ImportCapture())
    assert "expected some of EXP-2-eyes, FREE" in refusal(shipped, settings.model_copy(update={"segments": ("HAIR",)}))
    root = shutil.copytree(shipped, tmp_path / "set")
    path = root / "calibration/camera_params.json"
    content = json.loads(path.read_text())
    inverted = {name: np.linalg.inv(pose).tolist() for name, pose in content["world_2_cam"].items()}
    path.write_text(json.dumps(content | {"world_2_cam": inverted}))
    assert "expected at least 0.5 of the projected meshes in the masks, found 0" in refusal(root)
    path.write_text(json.dumps(content | {"intrinsics": (0.3 * np.array(content["intrinsics"])).tolist()}))
    assert "a principal point near the middle" in refusal(root)
    colors = {name: [row[:6] for row in polynomial_of(name).tolist()] for name in CAMERAS}
    (root / "calibration/color_calibration.json").write_text(json.dumps(colors))
    path.write_text(json.dumps(content))
    assert "3 rows of finite numbers, as many as 3, 4, 5, 7" in refusal(root)


def test_the_fake_is_as_the_sets_loader_reads_it(truth, shipped, settings):
    """Its own steps: K over the downscale of 2200 x 3208 without a shift, camera-from-world, a frame by its number."""
    content = json.loads((shipped / "calibration/camera_params.json").read_text())
    pose, K = np.array(content["world_2_cam"][CAMERAS[2]]), np.array(content["intrinsics"])
    video = cv2.VideoCapture(str(shipped / f"sequences/FREE/images/cam_{CAMERAS[2]}.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == len(SEQUENCES["FREE"])
    video.set(cv2.CAP_PROP_POS_FRAMES, 2)
    height, width = video.read()[1].shape[:2]
    seen = (truth.vertices(11) @ TURN.T) @ pose[:3, :3].T + pose[:3, 3]
    pixels = (seen / seen[:, 2:]) @ K[:2].T * [width / 2200, height / 3208]
    np.testing.assert_allclose(pixels, truth.cameras[CAMERAS[2]].project(truth.vertices(11)) + 0.5, atol=1e-6)
