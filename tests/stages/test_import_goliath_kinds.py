"""Goliath captures of a hand and of a body, imported and compared with what they were made from."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays
from pipeline.config.import_capture import ImportCapture
from pipeline.stages.import_capture import run
from tests.support.datasets.goliath_kinds_layout import (
    BODY_SEGMENTS,
    CAMERAS,
    HAND_SEGMENTS,
    true_body,
    true_hand,
    write_body,
    write_hands,
)
from tests.support.datasets.goliath_layout import DURATION, light_pattern, obj, pattern_of, ply, write_zip
from tests.support.datasets.imported import assert_true_cameras, assert_true_lights, import_set

IMAGE = (32, 48)
CHOSEN = ImportCapture(cameras=tuple(CAMERAS[:3]))
KEPT = [*range(7), 9, 10, 11, 12]
"""Frames of the hand with a mesh, or between two of their segment."""


@pytest.fixture(scope="module")
def hand():
    return true_hand(IMAGE)


@pytest.fixture(scope="module")
def shipped(hand, tmp_path_factory):
    return write_hands(tmp_path_factory.mktemp("set"), hand)


@pytest.fixture(scope="module")
def imported(shipped, tmp_path_factory):
    """Folders of the native capture of the hand, and of the results of the stages that follow."""
    return import_set("goliath", shipped, tmp_path_factory.mktemp("imported"), CHOSEN)


def test_lights_of_a_hand_are_the_true_ones_and_its_frames_keep_their_patterns(hand, imported):
    assert_true_cameras(imported[1], hand, CAMERAS[:3], 3)
    assert_true_lights(imported[1], hand)
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    assert sorted(patterns.frame.unique()) == KEPT
    for frame, rows in patterns.groupby("frame"):
        expected = {f"L{light:03d}": duration / DURATION for light, duration in light_pattern(pattern_of(frame))}
        assert dict(zip(rows.light, rows.intensity_g, strict=True)) == pytest.approx(expected, abs=1e-12)


def test_meshes_of_a_hand_are_the_true_ones_in_the_world(hand, imported):
    assert_true_meshes(hand, imported[1], KEPT)
    table = pd.read_parquet(imported[1] / "tracking/0000.parquet")
    assert table.status.tolist() == ["given" if pattern_of(frame) == 0 else "between" for frame in KEPT]
    assert (table.silhouette_iou[table.masks > 0] > 0.8).all(), "masks of ones"


def assert_true_meshes(truth, results, frames):
    arrays = read_arrays(results / "tracking/0000.safetensors")
    assert arrays["frames"].tolist() == frames
    for frame, vertices in zip(frames, arrays["vertices"], strict=True):
        np.testing.assert_allclose(vertices, truth.vertices(frame), atol=1e-6)


def test_description_of_a_hand_says_what_it_is_and_what_is_not_read(imported):
    described = yaml.safe_load((imported[0] / "capture.yaml").read_text())
    assert described["kind"] == "body" and described["fps"] == 5 and described["images"]["black_level"] == [2, 1, 2]
    assert described["masks"] == {"labels": [1], "enlarged": True}
    assert described["splits"]["test_cameras"] == ["401645"]
    assert described["splits"]["test_segments"] == [list(HAND_SEGMENTS)[1]]
    assert "a pickle" in described["imported"]["left_out"]["pose, skeleton_scales"]


def test_hand_without_registrations_asks_for_meshes_and_takes_them(hand, tmp_path):
    root, meshes = write_hands(tmp_path / "set", hand, registered=False), tmp_path / "posed"
    with pytest.raises(InputError, match=r"import_capture.mesh: expected .* by the skeleton of its shared assets"):
        run(dataset="goliath", source=root, subject="x", out=tmp_path / "out")
    meshes.mkdir()
    for frame in hand.keyed:
        (meshes / f"{frame:06d}.obj").write_text(obj(hand.vertices(frame), hand.faces))
    settings = ImportCapture(mesh=str(meshes), cameras=CHOSEN.cameras)
    run(dataset="goliath", source=root, subject="x", out=tmp_path / "out", settings=settings)
    described = yaml.safe_load((tmp_path / "out/capture.yaml").read_text())
    assert described["imported"]["given"]["meshes"].startswith("import_capture.mesh, in the world; 0.9")
    assert pd.read_csv(tmp_path / "out/frames.csv").frame.tolist() == KEPT


def test_body_is_imported_under_constant_light_with_its_true_cameras_and_meshes(tmp_path):
    body = true_body(IMAGE)
    capture, results = import_set("goliath", write_body(tmp_path / "set", body), tmp_path / "imported", CHOSEN)
    assert_true_cameras(results, body, CAMERAS[:3], 6)
    assert_true_meshes(body, results, [frame for span in BODY_SEGMENTS.values() for frame in span])
    described = yaml.safe_load((capture / "capture.yaml").read_text())
    assert described["kind"] == "body" and described["constant_light"] is True
    assert described["fps"] == 30, "every third of the recorded frames, ten a second"
    assert described["images"]["black_level"] == 0 and described["calibration"]["color"] == {"method": "none"}
    assert described["splits"]["test_segments"] == [list(BODY_SEGMENTS)[1]]


def test_vertices_in_the_frame_of_a_hand_do_not_pass_the_masks(hand, shipped, tmp_path):
    """Some say where the hand is, not where it is in the world: the masks tell."""
    root = shutil.copytree(shipped, tmp_path / shipped.name)
    meshes = {f"registration_vertices/{n:06d}.ply": ply(1000 * hand.in_head(n)) for n in hand.keyed}
    write_zip(root / "kinematic_tracking/registration_vertices.zip", meshes)
    with pytest.raises(InputError, match=r"expected at least 0.5 of the projected meshes in the masks, found 0\."):
        run(dataset="goliath", source=root, subject="x", out=tmp_path / "out")


def test_name_that_says_no_kind_is_refused(shipped, tmp_path):
    with pytest.raises(InputError, match="expected a folder whose name has Head, Hand or Body"):
        run(dataset="goliath", source=shipped.parent, subject="x", out=tmp_path / "out")
