"""HumanOLAT captures, their cameras written in either direction, compared with what they were made from."""

from __future__ import annotations

import logging
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.humanolat import held_out, image_of
from pipeline.stages.import_capture import run
from tests.support.datasets.environments import assert_explained
from tests.support.datasets.humanolat_layout import (
    CAMERAS,
    ENVIRONMENTS,
    FULL,
    LIGHTS,
    ORDER,
    TEST_CAMERA,
    calibration,
    images_of_lights,
    true_head,
    write_humanolat,
)
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set, score_as_preset
from tests.support.datasets.projected import assert_outlined

DIRECTIONS = ("camera-from-world", "world-from-camera")


@pytest.fixture(scope="module")
def truth():
    return true_head(image=(32, 48))


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_humanolat(tmp_path_factory.mktemp("set"), truth)


def copy_of(shipped, folder):
    return shutil.copytree(shipped, folder / shipped.name)


@pytest.fixture(scope="module", params=DIRECTIONS)
def imported(request, truth, shipped, tmp_path_factory):
    """Folders of the native capture and of the results of the stages that follow, and the direction."""
    folder = tmp_path_factory.mktemp("imported")
    source = copy_of(shipped, folder)
    (source / "shared/cameras.calib").write_text(calibration(truth, request.param))
    return *import_set("humanolat", source, folder), request.param


def test_cameras_lights_and_meshes_are_the_true_ones(truth, imported):
    _, results, _ = imported
    assert_true_cameras(results, truth, CAMERAS, FULL)
    assert_true_lights(results, truth)
    arrays = read_arrays(results / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == sorted(truth.frames)
    for vertices in arrays["vertices"]:
        np.testing.assert_allclose(vertices, truth.vertices(FULL), atol=1e-6)


def test_each_image_has_its_light_and_skipped_ones_none(truth, imported):
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    single = patterns[~patterns.frame.isin(list(ENVIRONMENTS))]
    assert single.intensity_r.eq(1).all() and single.intensity_b.eq(1).all()
    shown = single.groupby("frame").light.apply(list).to_dict()
    assert shown.pop(FULL) == [f"L{light:03d}" for light in range(LIGHTS)]
    assert shown == {number: [f"L{light:03d}"] for number, light in images_of_lights().items()}
    # The numbers that the set's page lists.
    listed = {0: 15, 18: 33, 19: 35, 38: 54, 39: 56, 318: 348, 319: 350, 330: 361}
    assert {k: image_of(k) for k in listed} == listed


def test_lights_of_environments_make_the_images_of_a_camera_that_tests(truth, imported):
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    for number in ENVIRONMENTS:
        assert_explained(truth, patterns, number, TEST_CAMERA)
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    assert described["splits"]["test_frames"] == list(ENVIRONMENTS)
    said = described["imported"]["computed"]["light patterns of environments"]
    assert "images 2: 3, 13" in said and f"over {len(CAMERAS) - 1} training cameras" in said


def test_images_that_no_lights_explain_are_named_and_left_out(shipped, tmp_path, caplog):
    root = copy_of(shipped, tmp_path)
    for name in CAMERAS:
        image = cv2.imread(str(root / f"images_processed/{name}/capture.{FULL:06d}.avif"))
        cv2.imwrite(str(root / f"images_processed/{name}/capture.000013.avif"), image[::-1])
    run(dataset="humanolat", source=root, subject="x", out=tmp_path / "out")
    described = yaml.safe_load((tmp_path / "out/capture.yaml").read_text())
    assert described["imported"]["left_out"]["images that single lights do not explain"].startswith("13 (0.")
    assert described["splits"]["test_frames"] == [3]


def test_without_environments_all_lights_are_white(shipped, tmp_path):
    settings = ImportCapture(environments=False)
    run(dataset="humanolat", source=shipped, subject="x", out=tmp_path / "out", settings=settings)
    assert list(pd.read_csv(tmp_path / "out/patterns.csv")) == ["frame", "light", "intensity"]
    assert not set(ENVIRONMENTS) & set(pd.read_csv(tmp_path / "out/frames.csv").frame)


def test_the_direction_is_said_with_both_numbers(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    said = described["imported"]["given"]["cameras"]
    assert f"extrinsics read as {imported[2]}, as the masks decide" in said
    assert all(f"{direction} 0." in said for direction in DIRECTIONS)
    splits = described["splits"]
    assert splits["test_cameras"] == [TEST_CAMERA]
    numbers = list(images_of_lights())
    assert (splits["test_patterns"], splits["validation_patterns"]) == (numbers[1::3], numbers[2::3])
    assert len(ORDER) == len(numbers)


def test_split_counts_cameras_from_0_and_lights_without_those_on_the_door():
    """Like the set's example. Of lights that fire in their order, 178 and 179 are the first on the door."""
    cameras = [f"Cam{number:02d}" for number in range(1, 41)]
    found = held_out(cameras, [image_of(k) for k in range(331)], list(range(331)))
    assert found.cameras == [f"Cam{number:02d}" for number in (1, 6, 11, 16, 21, 26, 31, 36)]
    tested = [image_of(k) for k in (*range(1, 178, 3), 180, 183)]
    assert found.patterns[: len(tested)] == tested and found.validation_patterns[59] == image_of(181)
    assert len(found.patterns) == len(found.validation_patterns) == 310 // 3


def test_preset_leads_to_the_table_that_is_promised(truth, shipped, tmp_path):
    cameras = (TEST_CAMERA, *CAMERAS[1:3])
    score_as_preset("humanolat", shipped, tmp_path, {c: truth.image_size(c) for c in cameras}, cameras=cameras)


def test_masks_that_do_not_decide_are_refused_with_both_numbers(shipped, tmp_path, caplog):
    root = copy_of(shipped, tmp_path)
    for path in root.glob("segmentations/masks/000/*.png"):
        cv2.imwrite(str(path), np.zeros((48, 32), np.uint8))
    with caplog.at_level(logging.INFO), pytest.raises(InputError) as caught:
        run(dataset="humanolat", source=root, subject="x", out=tmp_path / "out")
    assert "expected one convention to overlap the masks" in str(caught.value)
    assert all(f"{direction}: 0.000" in str(caught.value) for direction in DIRECTIONS)
    assert all(f"read as {direction}: overlap" in caplog.text for direction in DIRECTIONS)


def test_origins_that_contradict_the_masks_are_refused(truth, shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    path = root / "shared/cameras.calib"
    lines, number = path.read_text().splitlines(), -1
    for n, line in enumerate(lines):
        number += line.startswith("camera\t")
        if line.startswith("origin"):
            camera = truth.cameras[CAMERAS[number]]
            lines[n] = "origin\t" + " ".join(str(1000 * value) for value in camera.t)
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="lines origin that agree with the masks"):
        run(dataset="humanolat", source=root, subject="x", out=tmp_path / "out")


def test_the_fake_is_as_the_sets_programs_read_it(truth, imported):
    """Their own steps: K times the image's width, the lines behind comments, images named by lights in firing order."""
    root = (imported[0] / "source").resolve()
    blocks = (root / "shared/cameras.calib").read_text().split("camera\t")[1:]
    rows = [line.removeprefix("# ").split() for line in blocks[2].splitlines() if line.startswith("# ")]
    at = {row[0]: number for number, row in enumerate(rows) if len(row) == 1}
    T = np.vstack([np.array(rows[at["extrinsics"] + 1 : at["extrinsics"] + 4], float), [0, 0, 0, 1]])
    K = np.array(rows[at["intrinsics"] + 1 : at["intrinsics"] + 4], float)
    mask = cv2.imread(str(root / "segmentations/masks/000/Cam03.png"), cv2.IMREAD_UNCHANGED)
    K[:2] *= mask.shape[1]
    from_world = T if imported[2] == DIRECTIONS[0] else np.linalg.inv(T)
    lines = (root / "model/model.obj").read_text().splitlines()
    model = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    seen = model @ from_world[:3, :3].T + from_world[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] @ K[:2, :2].T + K[:2, 2]
    assert_outlined(mask, pixels)
    origin = next(line for line in blocks[2].splitlines() if line.startswith("origin")).split()[1:]
    np.testing.assert_allclose(np.array(origin, float), -from_world[:3, :3].T @ from_world[:3, 3], atol=1e-6)
    points = np.array([line.split()[1:] for line in (root / "shared/LSX_light_positions_aligned.pc").open()], float)
    order = [int(line) - 1 for line in (root / "shared/LSX3_light_z_spiral.txt").open()]
    np.testing.assert_array_equal(points, truth.lights_m)
    for k, number in ((0, 15), (18, 33), (19, 35)):
        assert (root / f"images_processed/Cam03/capture.{number:06d}.avif").is_file()
        assert truth.frames[number] == {order[k]: 1.0}
