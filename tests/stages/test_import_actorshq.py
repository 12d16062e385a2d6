"""An ActorsHQ sequence in the set's layout, imported and compared with what it was made from."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.config.import_capture import ImportCapture
from pipeline.geometry.cameras import read_cameras
from pipeline.stages.import_capture import run
from tests.support.datasets.actorshq_layout import (
    CAMERAS,
    FRAMES,
    LYING,
    TEST_CAMERA,
    UNUSED_CAMERA,
    VALIDATION_CAMERA,
    true_head,
    write_actorshq,
    write_meshes,
)
from tests.support.datasets.imported import assert_true_cameras, import_set
from tests.support.datasets.projected import assert_outlined


@pytest.fixture(scope="module")
def truth():
    return true_head()


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_actorshq(tmp_path_factory.mktemp("set"), truth)


@pytest.fixture(scope="module")
def settings(truth, tmp_path_factory):
    return ImportCapture(mesh=str(write_meshes(tmp_path_factory.mktemp("meshes"), truth)))


@pytest.fixture(scope="module")
def imported(shipped, settings, tmp_path_factory):
    """Folders of the native capture, and of the results of the stages that follow."""
    return import_set("actorshq", shipped, tmp_path_factory.mktemp("imported"), settings)


def test_cameras_and_meshes_are_the_true_ones_in_a_world_whose_y_is_up(truth, imported):
    assert_true_cameras(imported[1], truth, CAMERAS, FRAMES[0])
    lying = read_cameras(imported[1] / "calibration/cameras.json")[LYING]
    assert lying.width > lying.height
    arrays = read_arrays(imported[1] / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == list(FRAMES)
    for frame, vertices in zip(FRAMES, arrays["vertices"], strict=True):
        given = frame in truth.keyed
        # In between, the motion is one that was fitted to the meshes.
        np.testing.assert_allclose(vertices, truth.vertices(frame), atol=1e-6 if given else 1e-5)


def test_the_authors_cameras_and_constant_light_are_said(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    assert described["splits"]["test_cameras"] == [TEST_CAMERA]
    assert described["splits"]["validation_cameras"] == [VALIDATION_CAMERA]
    assumed = described["imported"]["assumed"]
    assert assumed["times"].startswith("25 frames a second, which the set does not say")
    assert "sRGB" in assumed["how images store light"] and "32 lights" in assumed["light"]
    left_out = described["imported"]["left_out"]
    assert left_out["cameras in no part of the authors' split"] == f"1: {UNUSED_CAMERA}"
    assert "of the projected meshes lies in the masks" in described["imported"]["given"]["meshes"]
    assert json.loads((imported[1] / "index/capture.json").read_text())["constant_light"] is True
    table = pd.read_parquet(imported[1] / "tracking/0000.parquet")
    assert (table.silhouette_iou > 0.8).all()


def test_what_is_not_there_or_of_no_use_is_said(shipped, settings, tmp_path):
    def refusal(root, chosen=settings):
        with pytest.raises(InputError) as caught:
            run(dataset="actorshq", source=root, subject="x", out=tmp_path / "out", settings=chosen)
        return str(caught.value)

    assert "3 problems" in refusal(shipped.parent)
    assert "meshes.abc has other vertices in each frame" in refusal(shipped, ImportCapture())
    one = f"{settings.mesh}/Frame{FRAMES[0]:06d}.obj"
    assert "expected a folder of meshes" in refusal(shipped, ImportCapture(mesh=one))
    root = shutil.copytree(shipped, tmp_path / "set")
    lines = (root / "calibration.csv").read_text().splitlines()
    columns = lines[0].split(",")
    for line, expected in (("w", "the shape of its images"), ("rx", "in the masks")):
        rows = [row.split(",") for row in lines[1:]]
        for row in rows:
            row[columns.index(line)] = "100" if line == "w" else str(-float(row[columns.index(line)]))
        (root / "calibration.csv").write_text("\n".join([lines[0], *(",".join(row) for row in rows)]))
        assert expected in refusal(root)


def test_what_is_assumed_is_in_the_log(shipped, settings, tmp_path, caplog):
    run(dataset="actorshq", source=shipped, subject="x", out=tmp_path / "out", settings=settings)
    for told in ("light: 32 lights of one", "times: 25 frames a second", "how images store light: sRGB"):
        assert f"assumed: {told}" in caplog.text


def test_the_fake_is_as_the_sets_loader_reads_it(truth, shipped, settings):
    """Its own steps: world-from-camera by axis and angle, lenses times the image's size, files by camera and frame."""
    with (shipped / "calibration.csv").open() as table:
        row = next(row for row in csv.DictReader(table) if row["name"] == LYING)
    value = {key: float(number) for key, number in row.items() if key != "name"}
    R, place = Rotation.from_rotvec([value[a] for a in ("rx", "ry", "rz")]), [value[a] for a in ("tx", "ty", "tz")]
    path = next(each for each in Path(settings.mesh).iterdir() if int(each.stem[-6:]) == FRAMES[3])
    vertices = np.array([line.split()[1:] for line in path.open() if line[0] == "v"], float)
    seen = R.inv().apply(vertices - place)
    size = np.array([value["w"], value["h"]])
    lens = np.array([value["fx"], value["fy"]]) * size, np.array([value["px"], value["py"]]) * size
    pixels = seen[:, :2] / seen[:, 2:] * lens[0] + lens[1]
    mask = cv2.imread(str(shipped / f"masks/{LYING}/{LYING}_mask{FRAMES[3]:06d}.png"), cv2.IMREAD_UNCHANGED)
    image = cv2.imread(str(shipped / f"rgbs/{LYING}/{LYING}_rgb{FRAMES[3]:06d}.jpg"))
    assert image.shape[:2] == mask.shape == tuple(size[::-1])
    assert_outlined(mask, pixels)
