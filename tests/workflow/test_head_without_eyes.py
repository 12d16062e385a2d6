"""A capture of an unrigged head that declares neither eyes nor gaze, through the whole workflow.

What it lacks is off by the plan, not an error.
"""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.capture.shards import read_frame_shards
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.stages.synthesize_capture import run

pytest.importorskip("mitsuba")

TARGET = "results/someone/metrics.csv"
SETTINGS = SynthesizeCapture(
    figure="head", framed_height_m=0.36, camera_distance_m=1.2, light_distance_m=1.3, total_intensity=22.0,
    survey_error_m=0.0, cameras=6, lights=5, frames=5, frames_b=2, fully_lit_every=3, partial_lights_min=1,
    partial_lights_max=2, width=48, height=56, downsample_from_sensor=1, test_cameras=1, test_frames=1,
    vertex_spacing_m=0.012, texture_size=128, spp=4, spp_fully_lit=5, spp_eyes=4, light_choice="all", supersampling=1,
    board_squares_x=4, board_squares_y=3, board_square_m=0.04, board_marker_m=0.03, board_poses=3, ball_positions=1,
    ball_cameras=1, ball_radius_m=0.04, color_spread=0.0,
)  # fmt: skip
SUBJECT = "unwrap_atlas: {size: 32}\ntrain_avatar: {steps: 8}\ntrack_mesh: {deformation_modes: 8}\n"


def declare_less(folder):
    """Calibrated elsewhere, and no word of eyes: files that nothing names stay where they are."""
    described = yaml.safe_load((folder / "capture.yaml").read_text())
    del described["gaze"], described["template"]["eyes"]
    described["calibration"] = {
        "cameras": {"method": "known", "path": "truth/cameras.json"}, "lights": {"method": "known"},
        "color": {"method": "none"},
    }  # fmt: skip
    (folder / "capture.yaml").write_text(yaml.safe_dump(described))


@pytest.fixture(scope="module")
def made(copy_of_project, stage_server, tmp_path_factory):
    workflow = copy_of_project(tmp_path_factory.mktemp("head") / "project").with_stages_of(stage_server)
    run(subject="someone", out=workflow.folder / "captures/someone", workers=1, settings=SETTINGS)
    declare_less(workflow.folder / "captures/someone")
    (workflow.folder / "config/subjects/someone.yaml").write_text(SUBJECT)
    return workflow, workflow.ran(TARGET)


def test_every_split_is_scored(made):
    workflow, ran = made
    assert ran[-1] == "evaluate_avatar" and "bake_textures" in ran
    table = pd.read_csv(workflow.folder / TARGET)
    scored = table[table.images > 0]
    assert {"test_cameras", "test_frames", "test_segments"} <= set(scored.split)
    assert np.isfinite(scored.psnr_db).all()
    assert workflow.planned(TARGET) == {}


def test_what_it_lacks_is_off(made):
    workflow, _ = made
    results = workflow.folder / "results/someone"
    effects = json.loads((results / "effects.json").read_text())
    assert (effects["eyes"]["on"], effects["eyes"]["evidence"]) == (False, 0)
    frames = read_frame_shards([results / "shards/frames"])
    assert sorted(frames) == list(range(5))
    for frame in frames.values():
        assert frame.gaze is None
        # As a head it has a motion and a mean texture.
        np.testing.assert_allclose(np.linalg.det(frame.head_from_world[:, :3]), 1, atol=1e-5)
        assert frame.texture.shape == (len(frame.irradiance), 3) and frame.texture.max() > 0.02
