"""A folded sheet as a head: its frames, avatars of it, and a few steps of training them."""

import dataclasses

import numpy as np
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.training import Training
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image

SMALL = {"code_size": 4, "decoder_channels": (8, 4), "pose_points": 4}
SETTINGS = TrainAvatar(avatar="head", shading="harmonics", steps=4, deferred="off", weight_ssim=0.02, **SMALL)
PLANNED = {"shadow", "articulation", "near_field", "specular"}
ALBEDO = np.array([0.7, 0.4, 0.2])


def folded(atlas, fold, number=0, lights=2):
    """The sheet with one corner lifted by `fold` metres, under lamps.

    As a head it stands where its template does.
    """
    places = np.array([[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2]])[:lights]
    frame = make_frame(atlas, places, np.full((lights, 3), 3.0), number)
    vertices = frame.vertices.copy()
    vertices[1, 2] += fold
    texture = np.full((atlas.texel_count, 3), 0.2 + fold, np.float32)
    return dataclasses.replace(
        frame, vertices=vertices, head_from_world=np.eye(3, 4, dtype=np.float32), texture=texture
    )


def make_head(atlas, frames=(), settings=SETTINGS, **row):
    torch.manual_seed(0)
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings.model_copy(update=row), PLANNED))
    inputs = [FrameInputs(atlas, frame) for frame in frames]
    if inputs and avatar.spec.head:
        known = [avatar.networks.tracked(one) for one in inputs]
        avatar.networks.expression.learn_statistics(known, [frame.texture for frame in frames])
    return avatar


def trained(atlas, frames, steps=6, **row):
    avatar = make_head(atlas, frames, **row)
    inputs = [FrameInputs(atlas, frame) for frame in frames]
    training = Training(avatar, SETTINGS, subject="sheet", images=len(frames))
    images = [make_image(frame, ALBEDO, 0.1) for frame in frames]
    for step in range(steps):
        training.take_step(step, inputs[step % len(frames)], [images[step % len(frames)]])
    return avatar


def folds(atlas):
    return [folded(atlas, fold, number) for number, fold in enumerate((0.0, 0.05, 0.1))]
