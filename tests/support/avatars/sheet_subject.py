"""Inputs of train_avatar for a sheet under two lights: small enough to train in a second."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from pipeline.capture.shards import write_frame_shard, write_image_shard
from pipeline.config.effects import EFFECTS
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.sheet import make_frame, make_image, make_sheet


def sheet_frames():
    """Two frames, each under a light of its own."""
    lights = [[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2]]
    return [make_frame(make_sheet(8), np.array([light]), np.full((1, 3), 3.0), i) for i, light in enumerate(lights)]


def sheet_images(frames, shifts=(-0.2, 0.2)):
    """Two cameras of each frame."""
    return [make_image(frame, np.array([0.7, 0.4, 0.2]), shift) for frame in frames for shift in shifts]


def write_subject(folder, images=None, shadow=False):
    """Write all that the stage reads."""
    frames = sheet_frames()
    write_atlas(folder / "atlas.safetensors", make_sheet(8))
    share = 0.5 if shadow else 1.0
    dimmed = [dataclasses.replace(frame, irradiance=share * frame.irradiance) for frame in frames]
    write_frame_shard(folder / "shards/frames/0000.arrow", dimmed)
    write_image_shard(folder / "shards/train/0000.arrow", images or sheet_images(frames))
    on = set(EFFECTS) - {"eyes"} - ({"shadow"} if not shadow else set())
    (folder / "effects.json").write_text(json.dumps({name: {"on": name in on} for name in EFFECTS}))


def stage_arguments(folder):
    """The stage's arguments for what `write_subject` wrote, but for `out` and the settings."""
    files = {"atlas": "atlas.safetensors", "shards": "shards", "effects": "effects.json"}
    return {"subject": "sheet", **{name: folder / file for name, file in files.items()}}
