"""OpenIllumination objects of both kinds, read in either direction, compared with what they were made from."""

from __future__ import annotations

import json
import logging
import shutil

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
from pipeline.geometry.mesh_files import decode_mesh
from pipeline.stages.import_capture import run
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set, score_as_preset
from tests.support.datasets.openillumination_layout import (
    BLIND_CAMERA,
    CAMERAS,
    LIGHTS,
    LIT_BY,
    LOST_CAMERA,
    OLAT,
    PATTERNS,
    TEST_CAMERA,
    pose,
    true_object,
    write_light_table,
    write_mesh,
    write_openillumination,
)
from tests.support.datasets.projected import assert_outlined

IMAGE = (32, 48)
AXES = {"opencv": "OpenCV's axes", "blender": "Blender's axes"}


@pytest.fixture(scope="module")
def truth():
    return true_object(image=IMAGE)


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_openillumination(tmp_path_factory.mktemp("set"), truth)


def copy_of(shipped, folder):
    shutil.copytree(shipped.parents[1], folder, dirs_exist_ok=True)
    return folder / OLAT / shipped.name


def turn_poses(root, truth, axes, times):
    """Write all poses in other axes, and positions times a number."""
    for path in (root / "output").glob("transforms_*.json"):
        content = json.loads(path.read_text())
        for name in content["frames"]:
            camera = truth.cameras[CAMERAS[0] if name == BLIND_CAMERA else name]
            content["frames"][name] = pose(camera, OLAT, axes, times)
        path.write_text(json.dumps(content))


@pytest.fixture(scope="module", params=[("opencv", 1.0), ("blender", 4.0)], ids=lambda case: case[0])
def imported(request, truth, shipped, tmp_path_factory):
    """Folders of the native capture and of the results of the stages that follow, and the axes; the mesh is named."""
    folder, (axes, times) = tmp_path_factory.mktemp("imported"), request.param
    source = copy_of(shipped, folder / "set")
    turn_poses(source, truth, axes, times)
    mesh = write_mesh(folder / "egg.obj", truth, times=times)
    return *import_set("openillumination", source, folder, ImportCapture(mesh=str(mesh))), axes


def test_cameras_lights_and_named_mesh_are_the_true_ones(truth, imported):
    _, results, _ = imported
    assert_true_cameras(results, truth, CAMERAS, 0)
    vertices = truth.vertices(0)
    assert_true_lights(results, truth)
    arrays = read_arrays(results / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == list(range(LIGHTS))
    np.testing.assert_allclose(arrays["vertices"], np.tile(vertices, (LIGHTS, 1, 1)), atol=1e-6)


def test_each_image_has_the_light_of_its_folder_and_masks_of_0_and_1_count(truth, imported):
    capture, results, _ = imported
    patterns = pd.read_parquet(results / "index/patterns.parquet")
    assert patterns.groupby("frame").light.apply(list).to_dict() == {n: [f"L{n:03d}"] for n in range(LIGHTS)}
    images = pd.read_parquet(results / "index/images.parquet").set_index(["camera", "frame"])
    assert len(images) == len(CAMERAS) * LIGHTS
    source = ImageSource.from_index(capture, json.loads((results / "index/capture.json").read_text())["images"])
    row = images.loc["CA2", 3]
    image = source.read(row.path, 3)
    # 8 bits of sRGB are finest in the dark and a two-hundredth of the range at its end.
    np.testing.assert_allclose(image, np.clip(truth.image("CA2", 3), 0, 1), atol=0.005)
    mask = source.read_mask(row.mask_path, image.shape)
    np.testing.assert_array_equal(mask, truth.labels("CA2", 0, np.full(len(truth.faces), 255)))


def test_axes_units_and_splits_are_said_with_all_numbers(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    given, left_out = described["imported"]["given"], described["imported"]["left_out"]
    assert f"read in {AXES[imported[2]]}, as the masks decide" in given["cameras"]
    assert all(f"{axes} 0." in given["cameras"] for axes in AXES.values())
    assert f"poses in {'the lights' if imported[2] == 'opencv' else 'a quarter'}" in given["cameras"]
    assert given["meshes"] == "egg.obj of import_capture.mesh, the same in all frames"
    assert described["splits"]["test_cameras"] == [TEST_CAMERA] and described["splits"]["test_patterns"] == []
    assert left_out["cameras without a pose"] == f"1: {LOST_CAMERA}"
    assert left_out["cameras without images"] == f"1: {BLIND_CAMERA}"


def test_without_a_mesh_the_hull_of_the_masks_stands_in(truth, shipped, tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        run(
            dataset="openillumination", source=shipped, subject="x", out=tmp_path, settings=ImportCapture(hull_cells=32)
        )
    assert "read as OpenCV's axes: overlap 0.9" in caplog.text
    assert "read as Blender's axes: overlap 0.000" in caplog.text
    hull = decode_mesh((tmp_path / "mesh.ply").read_bytes(), tmp_path / "mesh.ply")
    true = truth.vertices(0)
    # A pixel of the masks is 10 mm wide at the head, and so is a cell: two of these.
    assert np.abs(hull.vertices.min(0) - true.min(0)).max() < 0.02
    assert np.abs(hull.vertices.max(0) - true.max(0)).max() < 0.02
    described = yaml.safe_load((tmp_path / "capture.yaml").read_text())
    assert "visual hull of 6 masks" in described["imported"]["computed"]["meshes"]


def test_preset_leads_to_metrics_of_a_hull_and_of_images_without_full_light(truth, shipped, tmp_path):
    cameras = ("A1", TEST_CAMERA, "D3")
    sizes = {name: tuple(side // 2 for side in truth.image_size(name)) for name in cameras}
    scored = score_as_preset("openillumination", shipped, tmp_path, sizes, hull_cells=16, cameras=cameras)
    assert {"validation", "test_cameras"} <= set(scored.split) and "held_out_lights" not in set(scored.split)
    assert np.isfinite(scored.psnr_db).all()


def test_masks_that_do_not_decide_are_refused_with_both_numbers(shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    for path in root.glob("output/obj_masks/*.png"):
        cv2.imwrite(str(path), np.zeros_like(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))
    with pytest.raises(InputError, match=r"to overlap the masks .* OpenCV's axes: 0.000, Blender's axes: 0.000"):
        run(dataset="openillumination", source=root, subject="x", out=tmp_path / "out")


def test_lights_of_another_unit_are_refused(shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    np.save(tmp_path / "light_pos.npy", 40 * np.load(tmp_path / "light_pos.npy"))
    with pytest.raises(InputError, match="expected cameras about as far apart as the lights"):
        run(dataset="openillumination", source=root, subject="x", out=tmp_path / "out")


def test_poses_that_differ_between_files_are_named(shipped, tmp_path):
    root = copy_of(shipped, tmp_path)
    path = root / "output/transforms_val.json"
    content = json.loads(path.read_text())
    content["frames"][TEST_CAMERA]["transform_matrix"][0][3] += 0.1
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"transforms_val.json: {TEST_CAMERA}: expected the pose of the other files"):
        run(dataset="openillumination", source=root, subject="x", out=tmp_path / "out")


def test_a_folder_of_neither_kind_is_refused(shipped, tmp_path):
    root = shutil.copytree(shipped, tmp_path / "mine" / shipped.name)
    with pytest.raises(InputError, match="one object in OLAT or lighting_patterns"):
        run(dataset="openillumination", source=root, subject="x", out=tmp_path / "out")


@pytest.fixture(scope="module")
def patterned(tmp_path_factory):
    """An object under patterns: the truth, its folder and the table of lights that a user has to make."""
    folder, truth = tmp_path_factory.mktemp("patterns"), true_object(PATTERNS, IMAGE)
    return truth, write_openillumination(folder, truth, PATTERNS), write_light_table(folder / "lights.csv", truth)


def test_patterns_ask_for_the_lights_that_the_set_does_not_tell(patterned, tmp_path):
    with pytest.raises(InputError, match=r"import_capture.light_patterns: expected a csv .* another calibration"):
        run(dataset="openillumination", source=patterned[1], subject="x", out=tmp_path)


def test_patterns_with_a_table_of_lights_are_in_the_world_of_their_own_calibration(patterned, tmp_path):
    truth, source, table = patterned
    settings = ImportCapture(
        mesh=str(write_mesh(tmp_path / "egg.obj", truth, PATTERNS)), light_patterns=str(table), cameras=("A1", "D3")
    )
    run(dataset="openillumination", source=source, subject="x", out=tmp_path / "out", settings=settings)
    lights = pd.read_csv(tmp_path / "out/lights.csv").sort_values("light")
    np.testing.assert_allclose(lights[["x", "y", "z"]], truth.lights_m, atol=1e-6)
    patterns = pd.read_csv(tmp_path / "out/patterns.csv")
    expected = {number: sorted(f"L{light:03d}" for light in lights) for number, lights in LIT_BY.items()}
    assert patterns.groupby("frame").light.apply(sorted).to_dict() == expected
    camera = read_cameras(tmp_path / "out/cameras.json")["D3"]
    vertices = truth.vertices(1)
    np.testing.assert_allclose(camera.project(vertices)[0], truth.cameras["D3"].project(vertices) + 0.5, atol=1e-6)


@pytest.mark.parametrize(("axes", "flip"), [("opencv", [1, 1, 1]), ("blender", [1, -1, -1])])
def test_the_fake_is_as_the_sets_loaders_read_it(truth, tmp_path, axes, flip):
    """Their own steps: f = 0.5 w / tan(angle / 2), the middle of the image, world-from-camera, masks of 0 and 1."""
    root = write_openillumination(tmp_path, truth, axes=axes)
    entry = json.loads((root / "output/transforms_train.json").read_text())["frames"]["B2"]
    image = cv2.imread(str(root / "Lights/007/raw_undistorted/B2.JPG"))
    mask = cv2.imread(str(root / "output/obj_masks/B2.png"), cv2.IMREAD_UNCHANGED)
    height, width = image.shape[:2]
    assert mask.shape == (height, width) and set(np.unique(mask)) == {0, 1}
    pose = np.array(entry["transform_matrix"]) @ np.diag([*flip, 1])
    vertices = np.array([line.split()[1:] for line in write_mesh(tmp_path / "a.obj", truth).open() if line[0] == "v"])
    seen = (vertices.astype(float) - pose[:3, 3]) @ pose[:3, :3]
    focal = 0.5 * width / np.tan(0.5 * entry["camera_angle_x"])
    pixels = focal * seen[:, :2] / seen[:, 2:] + [width / 2, height / 2]
    assert_outlined(mask, pixels)
    lights = np.load(tmp_path / "light_pos.npy")
    assert lights.dtype == np.float64 and lights.shape == (LIGHTS, 3)
