"""The table of formats of cameras, and telling them apart."""

from __future__ import annotations

import json
from typing import get_args

import numpy as np
import pytest

from pipeline.capture.cameras.file_formats import AUTO, FORMATS, resolve_format
from pipeline.capture.schema.camera_schema import CAMERA_SUFFIXES, CameraFile
from tests.support.rigs.camera_files import model, read, write_model

CONTENTS = {
    "cameras_json": ("a.json", json.dumps({"cameras": {"cam00": {}}})),
    "nerfstudio": ("b.json", json.dumps({"frames": []})),
    "caliscope": ("c.toml", "[cam_0]\nsize = [1, 1]\n"),
    "metashape": ("d.xml", '<document version="2.0.0"/>'),
    "qualisys": ("e.qca.txt", '<?xml version="1.0"?>\n<calibration qtm-version="2023.3"/>'),
    "easymocap": ("f/intri.yml", "%YAML:1.0\n---\nnames: []\n"),
    "opencv": ("g.yml", "%YAML:1.0\n---\nnCameras: 2\n"),
    "colmap": ("h/images.bin", ""),
}
BESIDE = {"easymocap": "f/extri.yml", "colmap": "h/cameras.bin"}


def write(folder, name):
    path, content = CONTENTS[name]
    for file in filter(None, (path, BESIDE.get(name))):
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(content)
    return (folder / path).parent if name in BESIDE else folder / path


def test_table_and_schema_name_the_same_formats():
    assert set(CONTENTS) == set(FORMATS) == set(CAMERA_SUFFIXES) - {AUTO}
    assert set(get_args(CameraFile.model_fields["format"].annotation)) == set(CAMERA_SUFFIXES)


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_is_told_from_all_others(tmp_path, name):
    path = write(tmp_path, name)
    assert [key for key, camera_format in FORMATS.items() if camera_format.recognise(path)] == [name]
    assert resolve_format(AUTO, path) is FORMATS[name]


@pytest.mark.parametrize("name", FORMATS)
def test_what_a_format_is_not_given_is_not_recognised(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "noise.bin").write_bytes(np.random.default_rng(0).bytes(4096))
    for suffix in (".json", ".toml", ".xml", ".txt", ".yml"):
        (tmp_path / f"none{suffix}").write_bytes(b"\xff\xfe\x00")
    for path in [*tmp_path.iterdir(), tmp_path / "absent"]:
        assert not FORMATS[name].recognise(path)


def test_auto_reads_as_the_format_does(tmp_path):
    write_model(tmp_path / "sparse/0", model())
    cameras, complaints = read(tmp_path, format="auto", path="sparse/0")
    assert not complaints
    given, _ = read(tmp_path, format="colmap", path="sparse/0")
    for name, camera in given.items():
        np.testing.assert_array_equal(cameras[name].project(np.ones((1, 3)))[0], camera.project(np.ones((1, 3)))[0])


def test_unknown_files_name_all_formats(tmp_path):
    (tmp_path / "rig.csv").write_text("a,b\n")
    _, complaints = read(tmp_path, format="auto", path="rig.csv")
    assert complaints.startswith(
        "rig.csv: format: expected one that is known (cameras_json: a .json with the key cameras"
    )
    assert all(name in complaints for name in FORMATS)
    assert "found none" in read(tmp_path, format="auto", path="rig.json")[1]
