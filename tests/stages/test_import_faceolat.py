"""FaceOLAT captures, numbered either way, imported and compared with what they were made from."""

from __future__ import annotations

import json
import logging
import shutil
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.capture.images import ImageSource
from pipeline.config.import_capture import ImportCapture
from pipeline.stages.import_capture import run
from tests.support.datasets.faceolat_layout import (
    BLIND_CAMERA,
    CALIBRATION,
    CAMERAS,
    CAPTURE,
    DARKER,
    DURATION,
    FRAMES,
    FULL,
    LIGHTS,
    TEST_CAMERA,
    light_pattern,
    pattern_of,
    stored,
    true_head,
    write_faceolat,
    write_meshes,
)
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set


@pytest.fixture(scope="module")
def truth():
    return true_head()


@pytest.fixture(scope="module")
def shipped(truth, tmp_path_factory):
    return write_faceolat(tmp_path_factory.mktemp("set"), truth)


@pytest.fixture(scope="module")
def meshes(truth, tmp_path_factory):
    return write_meshes(tmp_path_factory.mktemp("meshes"), truth)


def settings(meshes, **others):
    return ImportCapture(**{"segments": (CAPTURE,), "mesh": str(meshes)} | others)


@pytest.fixture(scope="module")
def imported(shipped, meshes, tmp_path_factory):
    """Folders of the native capture, and of the results of the stages that follow."""
    return import_set("faceolat", shipped, tmp_path_factory.mktemp("imported"), settings(meshes))


def refusal(root, out, chosen):
    with pytest.raises(InputError) as caught:
        run(dataset="faceolat", source=root, subject="x", out=out, settings=chosen)
    assert not (out / "capture.yaml").exists()
    return str(caught.value)


def test_cameras_lights_and_meshes_are_the_true_ones(truth, imported):
    _, results = imported
    assert BLIND_CAMERA in truth.cameras
    assert_true_cameras(results, truth, CAMERAS, 4)
    assert_true_lights(results, truth)
    arrays = read_arrays(results / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == [frame + 1 for frame in FRAMES]
    status = pd.read_parquet(results / "tracking/0000.parquet").status.tolist()
    assert status == ["given" if frame in FULL else "between" for frame in FRAMES]
    for frame in FULL:
        np.testing.assert_allclose(arrays["vertices"][frame], truth.vertices(frame), atol=1e-6)
    # In between the truth turns about the head's middle, the import about that of its first mesh, with a fitted motion.
    for frame, vertices in zip(FRAMES, arrays["vertices"], strict=True):
        np.testing.assert_allclose(vertices, truth.vertices(frame), atol=1e-5)


def test_each_image_has_its_light_and_fractions_of_durations_count(imported):
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    for frame, rows in patterns.groupby("frame"):
        expected = {f"L{light:03d}": d / DURATION for light, d in light_pattern(pattern_of(frame - 1))}
        assert dict(zip(rows.light, rows.intensity_g, strict=True)) == pytest.approx(expected, abs=1e-12)
    assert patterns.frame.nunique() == len(FRAMES)


def test_images_are_a_power_of_light_and_as_bright_as_other_captures(truth, imported):
    capture, results = imported
    described = json.loads((results / "index/capture.json").read_text())["images"]
    images = pd.read_parquet(results / "index/images.parquet")
    row = images[(images.camera == CAMERAS[1]) & (images.frame == FULL[1] + 1)].iloc[0]
    matrix = np.array(json.loads((results / "calibration/color.json").read_text())["cameras"][CAMERAS[1]])
    shown = ImageSource.from_index(capture, described).read(row.path, FULL[1] + 1) @ matrix.T
    counts = stored(truth.image(CAMERAS[1], FULL[1])).astype(np.float64)
    # AVIF is lossy: a few counts of 255 at the slope of the power, 2.2.
    np.testing.assert_allclose(shown, DARKER * (counts / 255) ** 2.2, atol=0.05)
    np.testing.assert_allclose(shown.mean(), truth.image(CAMERAS[1], FULL[1]).mean(), rtol=0.05)


def test_what_was_decided_is_said_with_all_numbers(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    given, left_out = (described["imported"][key] for key in ("given", "left_out"))
    assert "entry 0 is image 1, as brightness decides" in given["light patterns"]
    assert "radii in metres" in given["cameras"] and "radii in millimetres" in given["cameras"]
    assert "in the projected mesh" in given["meshes"]
    assert left_out["cameras without a calibration"] == f"1: {BLIND_CAMERA}"
    single = [frame + 1 for frame in FRAMES if frame not in FULL]
    splits = described["splits"]
    assert splits["test_cameras"] == [TEST_CAMERA]
    assert (splits["test_patterns"], splits["validation_patterns"]) == (single[1::3], single[2::3])


def test_a_capture_whose_list_counts_as_its_images_do_is_read_so(truth, tmp_path, caplog):
    root, meshes = write_faceolat(tmp_path, truth, first=0), write_meshes(tmp_path, truth, first=0)
    with caplog.at_level(logging.INFO):
        run(dataset="faceolat", source=root, subject="x", out=tmp_path / "out", settings=settings(meshes))
    assert all(f"if entry 0 is image {first}, fully lit images are" in caplog.text for first in (0, 1))
    patterns = pd.read_csv(tmp_path / "out/patterns.csv").groupby("frame").light.apply(list)
    assert len(patterns[FULL[1]]) == LIGHTS and patterns[FULL[1] + 1] == ["L004"]
    # Entry 0 has no image, and image 22 no entry. Before the first mesh nothing is known.
    assert patterns.index.tolist() == list(range(FULL[1], FULL[-1] + 1))


def test_images_that_do_not_decide_are_refused_with_both_numbers(shipped, meshes, tmp_path):
    root = shutil.copytree(shipped, tmp_path / "set")
    path = root / "relighting/lights/light_pattern_per_frame.json"
    shifted = [[frame, pattern_of((frame + 3) % len(FRAMES))] for frame in FRAMES]
    path.write_text(json.dumps(shifted))
    message = refusal(root, tmp_path / "out", settings(meshes))
    assert "expected fully lit images 2 times as bright as others under one numbering alone" in message
    assert "image 1: " in message and "image 0: " in message


def test_without_meshes_it_is_said_what_makes_them(shipped, meshes, tmp_path):
    message = refusal(shipped, tmp_path / "out", ImportCapture(segments=(CAPTURE,)))
    assert "import_capture.mesh: expected an .obj or .ply" in message and "run_recon.sh" in message
    one = meshes / f"{FULL[0] + 1:06d}.obj"
    far = tmp_path / "millimetres.obj"
    lines = (line.split() for line in one.read_text().splitlines())
    far.write_text("\n".join(" ".join([w, *(f"{1000 * float(v)}" if w == "v" else v for v in n)]) for w, *n in lines))
    assert "expected a mesh in metres" in refusal(shipped, tmp_path / "out", settings(far))
    run(dataset="faceolat", source=shipped, subject="x", out=tmp_path / "out", settings=settings(one))
    table = pd.read_parquet(tmp_path / "out/meshes.parquet")
    assert table.frame.tolist() == [frame + 1 for frame in FRAMES] and set(table.path) == {"meshes/still.obj"}


def test_captures_are_chosen_and_a_chunk_without_a_transform_is_refused(shipped, meshes, tmp_path):
    message = refusal(shipped, tmp_path / "out", settings(meshes, segments=()))
    assert "expected one capture of ID20090, ID30090" in message
    root = shutil.copytree(shipped, tmp_path / "set")
    path = root / f"calibration/cameras/{CALIBRATION}.xml"
    content = path.read_text()
    start, end = content.rindex("<transform>"), content.rindex("</transform>") + len("</transform>")
    path.write_text(content[:start] + content[end:])
    assert "transform: expected that of the chunk" in refusal(root, tmp_path / "out", settings(meshes))
    path.write_text(content.replace('<scale locked="false">0.37', '<scale locked="false">9.9'))
    assert "radii in metres" in refusal(root, tmp_path / "out", settings(meshes))
    path.write_text(content.replace("<document", '<!DOCTYPE document [<!ENTITY a "b">]><document'))
    assert "without DOCTYPE and ENTITY" in refusal(root, tmp_path / "out", settings(meshes))
    path.unlink()
    message = refusal(root, tmp_path / "out", settings(meshes))
    assert f"{CALIBRATION}.xml: file: expected one, found none" in message and "prraoo/FaceOLAT" in message


def test_the_fake_is_as_the_sets_programs_read_it(truth, shipped):
    """Their own steps: Metashape's lens and pose in the chunk's frame, durations with fractions, a power of light."""
    chunk = ElementTree.parse(shipped / f"calibration/cameras/{CALIBRATION}.xml").getroot().find("chunk")
    camera = next(each for each in chunk.iter("camera") if each.get("label") == CAMERAS[2])
    sensor = next(each for each in chunk.iter("sensor") if each.get("id") == camera.get("sensor_id"))
    lens = {each.tag: float(each.text) for each in sensor.find("calibration") if each.tag != "resolution"}
    width, height = (float(sensor.find("resolution").get(side)) for side in ("width", "height"))
    turn, shift = (
        np.array(chunk.find(f"transform/{part}").text.split(), float) for part in ("rotation", "translation")
    )
    pose = np.array(camera.find("transform").text.split(), float).reshape(4, 4)
    in_chunk = (truth.vertices(5) - shift) @ turn.reshape(3, 3) / float(chunk.find("transform/scale").text)
    seen = (in_chunk - pose[:3, 3]) @ pose[:3, :3]
    # As its manual has it.
    x, y = (seen[:, :2] / seen[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + lens["k1"] * r2 + lens["k2"] * r2**2 + lens["k3"] * r2**3
    bent_x = x * radial + lens["p1"] * (r2 + 2 * x**2) + 2 * lens["p2"] * x * y
    bent_y = y * radial + lens["p2"] * (r2 + 2 * y**2) + 2 * lens["p1"] * x * y
    u = width / 2 + lens["cx"] + bent_x * (lens["f"] + lens["b1"])
    v = height / 2 + lens["cy"] + bent_y * lens["f"]
    expected = truth.cameras[CAMERAS[2]].project(truth.vertices(5)) + 0.5
    np.testing.assert_allclose(np.stack([u, v], 1), expected, atol=1e-9)
    patterns = json.loads((shipped / "relighting/lights/light_pattern_metadata.json").read_text())
    np.testing.assert_allclose(np.array(patterns["light_positions"]) / 1000, truth.lights_m, atol=1e-12)
    frame, number = json.loads((shipped / "relighting/lights/light_pattern_per_frame.json").read_text())[3]
    assert patterns["light_patterns"][number]["light_index_durations"] == [[2, 331]] and frame == 3
    image = Image.open(shipped / f"{CAMERAS[2]}/{CAPTURE}/{CAPTURE}.{frame + 1:06d}.avif")
    linear = DARKER * (np.asarray(image) / 255) ** 2.2
    np.testing.assert_allclose(linear, truth.image(CAMERAS[2], frame), atol=0.05)
