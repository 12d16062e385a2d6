"""The avatar of a head that is two eyeballs, with a latent code and gaze, and all that export_viewer reads of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.capture.records import FrameRecord
from tests.support.avatars.eyeballs import EYES, LIGHTS, eye_atlas, gaze, make_avatar, make_frame, make_image
from tests.support.viewer.ball_avatar import write_subject

SPEC = {
    "avatar": "head", "shading": "microfacet", "visibility": "traced", "code_size": 4, "decoder_channels": (8, 4),
    "pose_points": 4,
}  # fmt: skip


def head_frames() -> list[FrameRecord]:
    """Four frames, each a little larger, every other one a little higher; all look ahead."""
    atlas = eye_atlas()
    frames = []
    for number in range(4):
        frame = make_frame(atlas, gaze(0, 0), LIGHTS[:2])
        texture = np.full((atlas.texel_count, 3), 0.2 + 0.1 * number, np.float32)
        vertices = np.float32(1 + 0.1 * number) * frame.vertices + np.float32([0, 0.002 * (number % 2), 0])
        frames.append(replace(frame, frame=number, vertices=vertices, texture=texture))
    return frames


def eyes_head(frames: list[FrameRecord]) -> Avatar:
    """A head that knows these frames, and nothing else."""
    torch.manual_seed(3)
    avatar = make_avatar(eye_atlas(), EYES, **SPEC)
    known = [avatar.networks.tracked(FrameInputs(eye_atlas(), frame)) for frame in frames]
    avatar.networks.expression.learn_statistics(known, [frame.texture for frame in frames])
    with torch.no_grad():
        avatar.albedo[: len(avatar.albedo) // 3] = torch.tensor([0.7, 0.1, 0.1])  # a turn can be seen
    return avatar


def write_head(folder: Path) -> dict[str, Path]:
    """Write the head; returns the stage's arguments but `out`."""
    frames = head_frames()
    image = make_image(np.array([0.0, 0.0, 0.6]), np.array([0.0, 0.01, 0.06]), 4.0, 24)
    return write_subject(folder, eyes_head(frames), frames, [image], "two eyeballs")
