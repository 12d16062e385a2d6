"""An ava-256 capture in the set's layout, imported and compared with what it was made from."""

from __future__ import annotations

import io
import json
import logging
import zipfile

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.capture.images import ImageSource
from pipeline.config.import_capture import ImportCapture
from pipeline.geometry.cameras import read_cameras
from pipeline.stages.import_capture import run
from tests.support.datasets.ava256_layout import (
    CAMERAS,
    DROPPED,
    SEGMENTS,
    SMALLER,
    TEST_SEGMENT,
    part_labels,
    stored,
    true_head,
    write_ava256,
    write_topology,
)
from tests.support.datasets.imported import assert_true_cameras, import_set
from tests.support.datasets.projected import assert_outlined

FIRST = SEGMENTS["EXP_neutral_peak"][0]


@pytest.fixture(scope="module")
def truth():
    return true_head()


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_ava256(tmp_path_factory.mktemp("set"), truth)


@pytest.fixture(scope="module")
def topology(truth, tmp_path_factory):
    return ImportCapture(topology=str(write_topology(tmp_path_factory.mktemp("programs"), truth)))


@pytest.fixture(scope="module")
def imported(shipped, topology, tmp_path_factory):
    """Folders of the native capture, and of the results of the stages that follow."""
    return import_set("ava256", shipped, tmp_path_factory.mktemp("imported"), topology)


def test_cameras_and_meshes_are_the_true_ones(truth, imported):
    assert_true_cameras(imported[1], truth, CAMERAS, FIRST)
    for name, camera in read_cameras(imported[1] / "calibration/cameras.json").items():
        assert (camera.width, camera.height) == (truth.cameras[name].width, truth.cameras[name].height)
    arrays = read_arrays(imported[1] / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == list(truth.frames)
    for frame, vertices in zip(truth.frames, arrays["vertices"], strict=True):
        np.testing.assert_allclose(vertices, truth.vertices(frame), atol=1e-6)


def test_images_and_masks_are_read_in_place(truth, imported):
    capture, results = imported
    described = json.loads((results / "index/capture.json").read_text())["images"]
    assert described["downsample_from_sensor"] == SMALLER
    images = pd.read_parquet(results / "index/images.parquet")
    row = images[(images.camera == CAMERAS[1]) & (images.frame == FIRST + 3)].iloc[0]
    source = ImageSource.from_index(capture, described)
    light = truth.image(CAMERAS[1], FIRST + 3)
    shown = source.read(row.path, FIRST + 3)
    # AVIF is lossy: a few counts of 255.
    np.testing.assert_allclose(stored(shown).astype(int), stored(light).astype(int), atol=20)
    assert np.abs(shown - light).mean() < 0.005
    labels = part_labels(truth, CAMERAS[1], FIRST + 3)
    np.testing.assert_array_equal(source.read_mask(row.mask_path, shown.shape), np.isin(labels, (1, 2)) * 255)


def test_constant_light_is_an_even_environment_and_says_so(truth, imported):
    capture, results = imported
    lights = pd.read_parquet(results / "calibration/lights.parquet")
    patterns = pd.read_parquet(results / "index/patterns.parquet")
    counts = patterns.groupby("frame").light.nunique()
    assert counts.index.tolist() == list(truth.frames) and set(counts) == {len(lights)}
    # Irradiance of an even environment of radiance 1 on a plane is pi, whichever way it faces.
    away = lights[["x", "y", "z"]].to_numpy() - truth.vertices(FIRST).mean(0)
    distance = np.linalg.norm(away, axis=1)
    for normal in (np.array([0.0, 1.0, 0.0]), np.array([0.6, -0.48, 0.64])):
        cosine = np.clip(away @ normal / distance, 0, None)
        assert (patterns.intensity_g.iloc[0] * cosine / distance**2).sum() == pytest.approx(np.pi, rel=0.02)
    assert json.loads((results / "index/capture.json").read_text())["constant_light"] is True
    described = yaml.safe_load((capture / "capture.yaml").read_text())
    assert "avatars are not relit" in described["imported"]["computed"]["lights"]
    assert described["splits"]["test_segments"] == [TEST_SEGMENT]
    assert described["imported"]["left_out"]["frames without images"] == f"1: {DROPPED}"


def test_the_inner_folder_is_read_as_well_and_the_resolution_said(shipped, topology, tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        run(dataset="ava256", source=shipped / "decoder", subject="x", out=tmp_path / "out", settings=topology)
    assert pd.read_parquet(tmp_path / "out/images.parquet").path.iloc[0].startswith("source/image/cam")
    assert "assumed: light: 32 lights of one brightness" in caplog.text and "assumed: how images store" in caplog.text
    assert "of its side if 2" in caplog.text and "of its side if 4" in caplog.text


def test_faces_are_asked_for_and_what_is_missing_is_named(shipped, topology, tmp_path):
    with pytest.raises(InputError, match=r"set import_capture\.topology .* assets/face_topology\.obj"):
        run(dataset="ava256", source=shipped, subject="x", out=tmp_path / "out")
    with pytest.raises(InputError, match=r"(?s)5 problems.*head_pose/head_pose\.zip: file: expected one"):
        run(dataset="ava256", source=shipped / "encoder", subject="x", out=tmp_path / "out", settings=topology)


def test_the_fake_is_as_the_sets_loader_reads_it(truth, shipped):
    """Its own steps: transposed K and T of the sensor, vertices moved by the head's pose, an image by its number."""
    inside = shipped / "decoder"
    entry = next(e for e in json.loads((inside / "camera_calibration.json").read_text())["KRT"]
                 if e["cameraId"] == CAMERAS[1])  # fmt: skip
    K, Rt = np.array(entry["K"]).T, np.array(entry["T"]).T[:3, :4]
    segment, number = (inside / "frame_list.csv").read_text().splitlines()[3].split(",")
    assert segment == next(iter(SEGMENTS))

    def member(archive, name):
        with zipfile.ZipFile(inside / archive) as opened:
            return opened.read(name)

    content = member("kinematic_tracking/registration_vertices.zip", f"{number}.ply").split(b"end_header\n", 1)[1]
    pose = np.array([line.split() for line in member("head_pose/head_pose.zip", f"{number}.txt").splitlines()], float)
    world = np.frombuffer(content, "<f4").reshape(-1, 3) @ pose[:, :3].T + pose[:, 3]
    np.testing.assert_allclose(world / 1000, truth.vertices(int(number)), atol=1e-6)
    seen = world @ Rt[:, :3].T + Rt[:, 3]
    pixels = (seen[:, :2] / seen[:, 2:] @ K[:2, :2].T + K[:2, 2] + 0.5) / SMALLER
    name = f"cam{CAMERAS[1]}"
    labels = Image.open(io.BytesIO(member(f"segmentation_parts/{name}.zip", f"{name}/{number}.png")))
    image = Image.open(io.BytesIO(member(f"image/{name}.zip", f"{name}/{number}.avif")))
    assert image.size == labels.size == truth.image_size(CAMERAS[1])
    assert_outlined(np.isin(labels, (1, 2)), pixels)
    points = np.load(io.BytesIO(member("keypoints_3d/keypoints_3d.zip", f"{number}.npy")))
    assert points.shape[1] == 6
