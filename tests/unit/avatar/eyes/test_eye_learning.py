"""What training learns of explicit eyes: losses, gradients, and centre and cornea from glints."""

import math

import numpy as np
import pytest
import torch

from pipeline.avatar.eyes.explicit_eyes import Eyes
from pipeline.avatar.eyes.eye_spheres import MOST_GROWTH, MOST_SHIFT_M
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.losses import regularization
from pipeline.avatar.training.training import Training
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.eyeballs import (
    AHEAD,
    CAMERA,
    EYES,
    LIGHTS,
    MIDDLE,
    eye_atlas,
    gaze,
    make_avatar,
    make_frame,
    make_image,
    mirrors,
    moved_head,
)


def test_gradients_are_those_of_differences_in_float64():
    generator = torch.Generator().manual_seed(0)
    eyes = Eyes(eye_atlas(), EYES, torch.ones(eye_atlas().texel_count, 3)).double()
    head = torch.as_tensor(np.column_stack([moved_head()[:, :3].T, [0.01, 0.02, 0.0]]))
    looks = torch.as_tensor(np.stack([gaze(10, 5), gaze(-8, 2)]))
    with torch.no_grad():
        for parameter in (eyes.shift, eyes.growth, eyes.turn):
            parameter.copy_(0.5 * torch.randn(parameter.shape, generator=generator))

    def posed(*values):
        for name, value in zip(("shift", "growth", "turn"), values, strict=True):
            del eyes._parameters[name]
            setattr(eyes, name, value)
            eyes._parameters[name] = eyes.__dict__.pop(name)
        points, frames = eyes.pose(head, looks)
        return points[::37], frames[::37, :, 2]

    inputs = [getattr(eyes, name).detach().clone().requires_grad_() for name in ("shift", "growth", "turn")]
    assert torch.autograd.gradcheck(posed, inputs, eps=1e-6, atol=1e-8, rtol=1e-6)


def test_losses_are_those_of_the_paper():
    avatar = make_avatar(eye_atlas(), EYES)
    with torch.no_grad():
        avatar.opacity.fill_(0.0)
        avatar.visibility.fill_(math.log(0.25 / 0.75))
        avatar.log_scale.add_(math.log(1.5))
    frame = avatar.prepare(FrameInputs(eye_atlas(), make_frame(eye_atlas(), AHEAD, LIGHTS[:1])))
    terms = regularization(avatar, frame, TrainAvatar())
    assert terms["eye_opacity"].item() == pytest.approx(1e-4 * 0.25, rel=1e-5)
    assert terms["eye_visibility"].item() == pytest.approx(1e-4 * 0.75**2, rel=1e-5)
    scales = 1e3 * frame.gaussians.scales.detach()
    excess = (scales - (scales / 1.5).clamp_min(0.1)).clamp_min(0)
    assert terms["eye_scale"].item() == pytest.approx(0.01 * excess.square().mean().item(), rel=1e-4)


def test_training_finds_the_centre_and_the_cornea_from_glints():
    """Pictures of eyes that lie a millimetre elsewhere and have a cornea 6 % larger."""
    true = mirrors()
    with torch.no_grad():
        true.eyes.shift[:, 0], true.eyes.growth[:, 1] = math.atanh(0.5), math.atanh(0.6)
    frames = [make_frame(eye_atlas(), gaze(*angles), LIGHTS) for angles in ((0, 0), (14, 4), (-14, -4))]
    frames = [FrameInputs(eye_atlas(), frame) for frame in frames]
    views = [make_image(np.array([x, 0.1, 1.2]), MIDDLE, 1.0, 100) for x in (-0.3, 0.3)]
    avatar = mirrors()
    for name, parameter in avatar.named_parameters():
        parameter.requires_grad_(name in ("eyes.shift", "eyes.growth"))
    parameters = [avatar.eyes.shift, avatar.eyes.growth]
    optimizer = torch.optim.Adam(parameters, lr=0.05)
    for step in range(60):
        inputs = frames[step % 3]
        image = views[step % 2]
        camera = camera_view(image)
        with torch.no_grad():
            wanted = true.view(true.prepare(inputs), camera).rgb
        found = avatar.view(avatar.prepare(inputs), camera).rgb
        optimizer.zero_grad()
        blurred(found - wanted).square().sum().backward()
        optimizer.step()
    shift = MOST_SHIFT_M * torch.tanh(avatar.eyes.shift.detach())
    growth = MOST_GROWTH * torch.tanh(avatar.eyes.growth.detach())
    assert torch.allclose(shift[:, 0], torch.full((2,), 1e-3), atol=2.5e-4)
    assert torch.allclose(growth[:, 1], torch.full((2,), 0.06), atol=0.03)


def blurred(picture):
    """By a box of 9 pixels: narrow glints that do not touch have no slope towards each other."""
    return torch.nn.functional.avg_pool2d(picture.permute(2, 0, 1)[None], 9, 1, 4)


def test_a_step_of_training_moves_the_eyes():
    avatar = make_avatar(eye_atlas(), EYES)
    record = make_frame(eye_atlas(), gaze(3, 3), LIGHTS)
    image = make_image(CAMERA, MIDDLE, 1.0, 100)
    before = {name: value.detach().clone() for name, value in avatar.eyes.named_parameters()}
    Training(avatar, TrainAvatar(steps=2)).take_step(0, FrameInputs(eye_atlas(), record), [image])
    moved = {name for name, value in avatar.eyes.named_parameters() if not torch.equal(before[name], value)}
    assert {"shift", "growth", "turn"} <= moved
