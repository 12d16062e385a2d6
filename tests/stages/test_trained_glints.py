"""Gaze in, gaze out, of an avatar trained on photographs of turning eyes: glints at gazes that no photograph has."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
import yaml

from benchmarks.driven_glints import Scene, direction, measure_glints
from benchmarks.glint_summary import WITHIN_PX, slope_of
from benchmarks.true_eyes import MEASURED, read_true_eyes
from pipeline.avatar.eyes import explicit_eyes as eyes
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.files import write_json
from pipeline.capture.shards import read_frame_shards
from pipeline.config.effects import EFFECTS
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.geometry.cameras import read_cameras
from pipeline.stages import bake_textures as bake_textures
from pipeline.stages import (
    book_patterns,
    calibrate_cameras,
    calibrate_color,
    calibrate_lights,
    fit_eyes,
    index_capture,
    pack_shards,
    synthesize_capture,
    train_avatar,
    unwrap_atlas,
)

pytest.importorskip("mitsuba")

CAPTURE = SynthesizeCapture(
    figure="head", framed_height_m=0.36, camera_distance_m=1.2, light_distance_m=1.3, total_intensity=22.0,
    survey_error_m=0.0, cameras=5, lights=8, frames=6, frames_b=2, fps=4.0, fully_lit_every=3, partial_lights_min=1,
    partial_lights_max=2, width=64, height=76, downsample_from_sensor=4, test_cameras=0, test_frames=0,
    vertex_spacing_m=0.009, texture_size=128, spp=4, spp_fully_lit=8, spp_eyes=32, light_choice="all", supersampling=1,
    board_squares_x=4, board_squares_y=3, board_square_m=0.04, board_marker_m=0.03, board_poses=3, ball_positions=1,
    ball_cameras=2, ball_radius_m=0.04, color_spread=0.0,
)  # fmt: skip

TRAINING = TrainAvatar(
    steps=60, anchors="tracked", transfer_start="traced", code_size=4, decoder_channels=(8, 4), pose_points=4,
    weight_ssim=0.0,
)  # fmt: skip
PLAN = {name: {"on": name not in ("shadow", "color_correction")} for name in EFFECTS}


def make(root):
    """A trained avatar's results beside its capture; how heads move is taken from the truth, as if tracked."""
    capture, index, truth = root / "capture", root / "index", root / "capture/truth"
    synthesize_capture.run(subject="turning", out=capture, workers=1, settings=CAPTURE)
    described = yaml.safe_load((capture / "capture.yaml").read_text())
    described["calibration"] = {
        "cameras": {"method": "known", "path": "truth/cameras.json"}, "lights": {"method": "known"},
        "color": {"method": "none"},
    }  # fmt: skip
    (capture / "capture.yaml").write_text(yaml.safe_dump(described))
    write_json(root / "effects.json", PLAN)
    photographed = {"capture": capture, "index": index}
    index_capture.run(capture=capture, out=index)
    calibrate_cameras.run(**photographed, out=root)
    calibrate_lights.run(**photographed, rig=root / "rig.json", out=root)
    calibrate_color.run(**photographed, out=root)
    unwrap_atlas.run(**photographed, out=root, settings=UnwrapAtlas(size=64))
    cameras, lights = root / "cameras.json", root / "lights.parquet"
    book_patterns.run(**photographed, lights=lights, cameras=cameras, out=root)
    posed = {"atlas": root / "atlas.safetensors", "tracking": truth / "tracking.safetensors"}
    seen = {
        "cameras": cameras,
        "color": root / "color.json",
        "effects": root / "effects.json",
        "frames": root / "frames.parquet",
    }
    bake_textures.run(**photographed, **posed, **seen, out=root / "textures/0000")
    fit_eyes.run(index=index, atlas=posed["atlas"], tracking=(posed["tracking"],), out=root / "eyes.json")
    pack_shards.run(
        **photographed, **posed, **seen, patterns=root / "patterns.parquet", lights=lights, out=root / "shards",
        textures=root / "textures/0000.safetensors",
    )  # fmt: skip
    train_avatar.run(
        subject="turning", atlas=posed["atlas"], shards=root / "shards", effects=root / "effects.json",
        out=root / "avatars/full", fitted_eyes=root / "eyes.json", settings=TRAINING,
    )  # fmt: skip


GAZES = ((-20, -15), (-20, 15), (0, 15), (10, 10), (15, -18), (20, 15))
"""Degrees; of all, the nearest that was photographed is `UNSEEN_DEG` away."""

UNSEEN_DEG = 6.0
FRAMES = (1, 5)
"""Of the segment that trained, and of the other: whose heads the gazes are given to."""

CAMERAS = ("cam00", "cam04")
"""Those that see the face."""

LIGHTS = {
    "above": np.array([0.5, 0.6, 1.0]), "aside": np.array([-0.7, 0.2, 1.0]), "below": np.array([0.1, -0.6, 1.1]),
}  # fmt: skip
"""None of the stage's."""

SHORTER_M = 0.002
"""Of a cornea's offset of 5.7 mm; a pixel of the sensor is 1.4 mm wide."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Where it all is, and the scene to compare: its pixels are the sensor's, four times finer than the photographs."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    root = tmp_path_factory.mktemp("turning")
    make(root)
    truth = read_true_eyes(root / "capture")
    relighter = Relighter(load_avatar(root / "avatars/full", root / "atlas.safetensors"), TraceIrradiance())
    truth = dataclasses.replace(truth, lights=LIGHTS)
    yield root, Scene(relighter, truth, read_cameras(root / "cameras.json"), LIGHTS, sensor_per_pixel=1.0)
    torch.set_num_threads(threads)


def glints_of(made):
    root, scene = made
    records = read_frame_shards([root / "shards/frames"])
    table = measure_glints(scene, [records[frame] for frame in FRAMES], CAMERAS, list(LIGHTS), GAZES)
    glints = table[table.status == MEASURED]
    return glints[glints.sphere == "cornea"], glints[glints.sphere == "eyeball"]


def test_no_photograph_has_these_gazes(made):
    root, scene = made
    photographed = np.stack([scene.truth.looks(frame) for frame in read_frame_shards([root / "shards/frames"])])
    nearest = [np.degrees(np.arccos((photographed @ direction(*gaze)).max())) for gaze in GAZES]
    assert min(nearest) > UNSEEN_DEG


def test_glints_of_a_trained_avatar_are_where_the_mirror_law_has_them(made):
    cornea, eyeball = glints_of(made)
    assert len(cornea) >= 10 and set(cornea.segment) == {"a", "b"} and len(eyeball) >= 12
    assert cornea.error_px.max() < WITHIN_PX and eyeball.error_px.max() < WITHIN_PX
    # The gaze moved them by more than that.
    assert cornea.still_px.median() > WITHIN_PX
    assert slope_of(cornea) == pytest.approx(1.0, abs=0.1)


def test_eyes_that_do_not_turn_are_found_out(made, monkeypatch):
    """Glints that a turn moves by more than a pixel are off by more, at least half of them, and do not follow it."""
    _, scene = made
    monkeypatch.setattr(
        eyes, "frame_gaze",
        lambda inputs, parts, axes: torch.as_tensor(tracked_gaze(scene, inputs), dtype=torch.float32),
    )  # fmt: skip
    cornea, eyeball = glints_of(made)
    moved = cornea[cornea.still_px > WITHIN_PX]
    assert len(moved) >= 5 and moved.error_px.median() > WITHIN_PX
    assert slope_of(cornea) == pytest.approx(0.0, abs=0.1)
    assert eyeball.error_px.max() < WITHIN_PX


def tracked_gaze(scene, inputs):
    """The gaze of the frame whose head this is."""
    posed = inputs.record.vertices
    frame = min(FRAMES, key=lambda number: np.abs(scene.truth.vertices[number] - posed).max())
    return np.tile(scene.truth.looks(frame), (len(scene.truth.centers), 1))


def test_corneas_in_a_wrong_place_are_found_out(made, monkeypatch):
    trained = made[1].relighter.avatar.eyes
    monkeypatch.setitem(trained._buffers, "sizes", trained.sizes - torch.tensor([0.0, 0.0, SHORTER_M]))
    cornea, _ = glints_of(made)
    assert (cornea.error_px > WITHIN_PX).mean() > 1 / 3
