"""The stage from tracked eye parts to eyes.json: a head with two turning eyes, moved about."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import pipeline.stages.fit_eyes as stage
from pipeline.base.errors import InputError
from pipeline.base.files import write_arrays, write_table
from pipeline.config.fit_eyes import FitEyes
from pipeline.eyes.eye_fit import read_eyes
from pipeline.eyes.eye_shape import usual_shape
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.eyeballs import AHEAD, CENTERS, make_atlas, make_eyes

FRAMES = {0: (4, 5, 6), 1: (7, 8)}
"""Frames of the chunks."""


@pytest.fixture
def inputs(tmp_path):
    atlas, eyes = make_atlas(32), make_eyes()
    write_atlas(tmp_path / "atlas.safetensors", atlas)
    rows = [(name, vertex) for name, eye in eyes.items() for vertex in eye.vertices]
    write_table(tmp_path / "index/eyes.parquet", pd.DataFrame(rows, columns=["eye", "vertex"]))
    looks, rng = [], np.random.default_rng(0)
    for chunk, frames in FRAMES.items():
        arrays = {"frames": np.array(frames), "vertices": [], "root_rotation": [], "root_translation": []}
        for frame in frames:
            gaze = Rotation.from_euler("YX", rng.uniform(-20, 20, 2), degrees=True)
            head, shift = Rotation.from_euler("YXZ", rng.uniform(-25, 25, 3), degrees=True), rng.normal(size=3)
            vertices = atlas.rest_vertices.astype(np.float64).copy()
            for name, eye in eyes.items():
                part = list(eye.vertices)
                vertices[part] = gaze.apply(vertices[part] - CENTERS[name]) + CENTERS[name]
                looks.append((frame, name, *gaze.apply(AHEAD), False))
            arrays["vertices"].append(head.apply(vertices) + shift)
            arrays["root_rotation"].append(head.as_quat(scalar_first=True))
            arrays["root_translation"].append(shift)
        stacked = {name: np.array(values, np.float32 if name != "frames" else None) for name, values in arrays.items()}
        write_arrays(tmp_path / f"tracking/{chunk:04d}.safetensors", stacked)
    columns = ["frame", "eye", "x", "y", "z", "interpolated"]
    write_table(tmp_path / "index/gaze.parquet", pd.DataFrame(looks, columns=columns))
    return {
        "index": tmp_path / "index", "atlas": tmp_path / "atlas.safetensors", "out": tmp_path / "eyes.json",
        "tracking": tuple(sorted((tmp_path / "tracking").glob("*.safetensors"))),
    }  # fmt: skip


def test_finds_the_eyes_of_a_moving_head(inputs):
    stage.run(**inputs)
    found = read_eyes(inputs["out"])
    assert list(found) == ["eye_l", "eye_r"]
    for name, eye in found.items():
        assert eye.status == "usual"  # the parts are spheres
        np.testing.assert_allclose(eye.center, CENTERS[name], atol=2e-6)
        np.testing.assert_allclose(eye.axis, AHEAD, atol=1e-3)
        assert eye.shape.radius_m == pytest.approx(0.012, rel=1e-3)
        assert eye.shape.cornea_radius_m == pytest.approx(usual_shape(0.012).cornea_radius_m, rel=1e-3)
        assert eye.vertices == make_eyes()[name].vertices


def test_interpolated_gaze_and_more_frames_than_asked_for_are_left_out(inputs, caplog):
    gaze = pd.read_parquet(inputs["index"] / "gaze.parquet")
    gaze.loc[gaze.frame == 6, ["x", "y", "z", "interpolated"]] = [0.0, 0.0, -1.0, True]
    write_table(inputs["index"] / "gaze.parquet", gaze)
    with caplog.at_level("INFO"):
        stage.run(**inputs, settings=FitEyes(frames=3, cornea="none"))
    assert "3 of 4 frames" in caplog.text
    assert {eye.status for eye in read_eyes(inputs["out"]).values()} == {"sphere"}


def test_what_is_missing_is_named(inputs):
    eyes, gaze = (inputs["index"] / name for name in ("eyes.parquet", "gaze.parquet"))
    table = pd.read_parquet(gaze)
    write_table(gaze, table[:0])
    with pytest.raises(InputError, match=r"found no gaze; set train_avatar.eyes: off"):
        stage.run(**inputs)
    write_table(gaze, table[table.eye == "eye_l"])
    with pytest.raises(
        InputError, match="eye_r: expected 12 places of vertices and a frame with gaze, found 642 and 0"
    ):
        stage.run(**inputs)
    write_table(gaze, table)
    vertices = pd.read_parquet(eyes)
    write_table(eyes, vertices.replace({"vertex": {0: 10**6}}))
    with pytest.raises(InputError, match=r"eye_l: expected vertices of .*, found 1000000"):
        stage.run(**inputs)
