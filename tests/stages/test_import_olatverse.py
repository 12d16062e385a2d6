"""OLATverse objects in both units and axes, compared with what they were made from."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.config.import_capture import ImportCapture
from pipeline.geometry.cameras import read_cameras
from pipeline.stages.import_capture import run
from tests.support.datasets.environments import assert_explained
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set, score_as_preset
from tests.support.datasets.olatverse_layout import (
    BENCHMARK_TEST_CAMERA,
    BLIND_CAMERA,
    CAMERAS,
    ENVIRONMENTS,
    FULL,
    INTENSITY,
    LIGHTS,
    METRES,
    MILLIMETRES,
    POLARISED,
    REPEATED,
    camera_entry,
    images_of_lights,
    true_object,
    write_olatverse,
)
from tests.support.datasets.projected import assert_outlined

IMAGE = (32, 48)
CASES = {"as released": ("blender", MILLIMETRES), "other readings": ("opencv", METRES)}


@pytest.fixture(scope="module")
def truth():
    return true_object(image=IMAGE)


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_olatverse(tmp_path_factory.mktemp("set"), truth)


def copy_of(shipped, folder):
    shutil.copytree(shipped.parent, folder, dirs_exist_ok=True)
    return folder / shipped.name


@pytest.fixture(scope="module", params=CASES)
def imported(request, truth, shipped, tmp_path_factory):
    """Folders of the native capture and of the results of the stages that follow, and the case."""
    folder, (axes, unit) = tmp_path_factory.mktemp("imported"), CASES[request.param]
    source = copy_of(shipped, folder / "set")
    frames = [camera_entry(name, camera, axes, unit) for name, camera in truth.cameras.items()]
    (source / "all_cam.json").write_text(json.dumps({"frames": frames}))
    return *import_set("olatverse", source, folder), request.param


def test_cameras_lights_and_meshes_are_the_true_ones(truth, imported):
    _, results, _ = imported
    assert_true_cameras(results, truth, CAMERAS, FULL)
    assert_true_lights(results, truth)
    arrays = read_arrays(results / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == sorted(truth.frames)
    for vertices in arrays["vertices"]:
        np.testing.assert_allclose(vertices, truth.vertices(FULL), atol=1e-6)


def test_each_image_has_its_light_and_repeated_entries_count_once(imported):
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    patterns = patterns[~patterns.frame.isin(list(ENVIRONMENTS))]
    shown = patterns.groupby("frame").light.apply(list).to_dict()
    assert shown.pop(FULL) == [f"L{light:03d}" for light in range(LIGHTS)]
    assert shown == {number: [f"L{light:03d}"] for number, light in images_of_lights().items()}
    assert (patterns.intensity_r == 1).all()


def test_lights_of_environments_make_the_images_of_a_camera_that_tests(truth, imported):
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    for number in ENVIRONMENTS:
        assert_explained(truth, patterns, number, BENCHMARK_TEST_CAMERA, INTENSITY)


def test_axes_units_and_splits_are_said_with_all_numbers(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    cameras, left_out = described["imported"]["given"]["cameras"], described["imported"]["left_out"]
    released = imported[2] == "as released"
    axes = "Blender's axes" if released else "OpenCV's axes"
    assert f"read in {axes} and a mesh in millimetres, as the masks decide" in cameras
    assert all(f"{each} and a mesh in metres 0.0" in cameras for each in ("Blender's axes", "OpenCV's axes"))
    assert f"poses in {'millimetres' if released else 'metres'}, as far apart as the lights" in cameras
    assert left_out["cameras without images"] == f"1: {BLIND_CAMERA}"
    assert left_out["cameras behind polarisers"].startswith(f"1: {POLARISED};")
    numbers, splits = list(images_of_lights()), described["splits"]
    assert splits["test_cameras"] == [BENCHMARK_TEST_CAMERA]
    assert (splits["test_patterns"], splits["validation_patterns"]) == (numbers[1::3], numbers[2::3])


def test_preset_leads_to_metrics_of_held_out_cameras_and_lights(truth, shipped, tmp_path):
    cameras = ("Cam01", "Cam05", BENCHMARK_TEST_CAMERA)
    sizes = {name: truth.image_size(name) for name in cameras}
    scored = score_as_preset("olatverse", shipped, tmp_path, sizes, cameras=cameras)
    assert {"validation", "test_cameras", "held_out_lights"} <= set(scored.split)
    assert np.isfinite(scored.psnr_db).all()


def test_objects_of_the_training_set_get_a_hull_and_the_published_split(truth, shipped, tmp_path):
    root = copy_of(shipped, tmp_path / "set")
    shutil.rmtree(root / "model")
    for path in root.glob("transforms_*.json"):
        path.unlink()
    settings = ImportCapture(hull_cells=32, cameras=(*CAMERAS, POLARISED))
    run(dataset="olatverse", source=root, subject="x", out=tmp_path / "out", settings=settings)
    described = yaml.safe_load((tmp_path / "out/capture.yaml").read_text())
    assert "visual hull of 6 masks" in described["imported"]["computed"]["meshes"]
    assert described["splits"]["test_cameras"] == ["Cam01", "Cam27"]
    assert described["splits"]["test_patterns"] == list(images_of_lights())[1::3]
    assert POLARISED in read_cameras(tmp_path / "out/cameras.json"), "asked for by name"


def test_repeated_lights_that_differ_are_named(shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    path = tmp_path / "shared/all_lights.json"
    content = json.loads(path.read_text())
    assert len(content["frames"]) == LIGHTS + REPEATED
    content["frames"][-1]["pl_pos"][0] += 0.5
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"light_idx {REPEATED - 1}: expected .*in a later entry"):
        run(dataset="olatverse", source=root, subject="x", out=tmp_path / "out")


def test_missing_lights_are_named_with_where_they_are(shipped, tmp_path):
    root = shutil.copytree(shipped, tmp_path / shipped.name)
    with pytest.raises(InputError, match=r"all_lights.json: file: expected one, found none; .*xilongzhou/OLATverse"):
        run(dataset="olatverse", source=root, subject="x", out=tmp_path / "out")


def test_several_models_ask_for_the_name_of_one(shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    shutil.copy(root / "model/model.obj", root / "model/other.obj")
    with pytest.raises(InputError, match=r"expected one mesh, found model/model.obj, model/other.obj; name one by"):
        run(dataset="olatverse", source=root, subject="x", out=tmp_path / "out")


def test_masks_that_do_not_decide_are_refused_with_all_numbers(shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    for path in root.glob("mask/*.png"):
        cv2.imwrite(str(path), np.zeros(IMAGE[::-1], np.uint8))
    with pytest.raises(InputError, match="expected one convention to overlap the masks") as caught:
        run(dataset="olatverse", source=root, subject="x", out=tmp_path / "out")
    assert str(caught.value).count(": 0.000") == 4


def test_the_fake_is_as_loaders_of_the_set_read_it(truth, shipped):
    """Steps of GS3's: cx, cy, fx, fy of each frame, Blender's world-from-camera, a light's place and intensity."""
    content = json.loads((shipped / "transforms_train.json").read_text())["frames"]
    listed = json.loads((shipped.parent / "shared/all_lights.json").read_text())["frames"]
    frame = content[-1]
    name, file = frame["cam_idx"], frame["file_path"].split("/")[-1]
    assert (shipped / f"masked_olat/{name}/{file}.avif").is_file()
    cx, cy, fx, fy = frame["camera_intrinsics"]
    pose = np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])
    lines = (shipped / "model/model.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    seen = (vertices - pose[:3, 3]) @ pose[:3, :3]
    pixels = seen[:, :2] / seen[:, 2:] * [fx, fy] + [cx, cy]
    mask = cv2.imread(str(shipped / f"mask/{name}.png"), cv2.IMREAD_UNCHANGED)
    assert_outlined(mask, pixels)
    lit = {entry["light_idx"]: entry for entry in listed}
    assert sorted(lit) == list(range(LIGHTS)) and lit[frame["light_idx"]]["pl_pos"] == frame["pl_pos"]
    np.testing.assert_array_equal(frame["pl_pos"], truth.lights_m[frame["light_idx"]])
