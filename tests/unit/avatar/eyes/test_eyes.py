"""Explicit eyes as parts of an avatar: on their spheres, with colours by direction, saved, and refused."""

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar, save_avatar
from pipeline.base.errors import InputError
from pipeline.eyes.eye_shape import usual_shape
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.eyeballs import (
    AHEAD,
    CAMERA,
    CENTERS,
    EYES,
    LIGHTS,
    MIDDLE,
    eye_atlas,
    gaze,
    make_avatar,
    make_eyes,
    make_frame,
    make_image,
    mirrors,
    moved_head,
)


def test_gaussians_stand_on_the_spheres_with_their_normals():
    avatar, head, looks = make_avatar(eye_atlas(), EYES), moved_head(), gaze(20, -10)
    frame = avatar.prepare(FrameInputs(eye_atlas(), make_frame(eye_atlas(), looks, LIGHTS[:1], head)))
    means, normals = frame.gaussians.means.detach().numpy(), frame.surface.bent_normals.detach().numpy()
    shape, axis = usual_shape(0.012), head[:, :3] @ looks
    centers = np.stack([head[:, :3] @ center + head[:, 3] for center in CENTERS.values()])[avatar.eyes.eye]
    from_ball, from_cornea = means - centers, means - centers - shape.cornea_offset_m * axis
    on_ball = np.abs(np.linalg.norm(from_ball, axis=1) / shape.radius_m - 1) < 1e-5
    on_cornea = np.abs(np.linalg.norm(from_cornea, axis=1) / shape.cornea_radius_m - 1) < 1e-5
    assert len(means) == eye_atlas().texel_count and (on_ball | on_cornea).all() and on_cornea.sum() > 50
    outward = np.where(on_cornea[:, None], from_cornea, from_ball)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, outward, atol=1e-5)
    axes = frame.surface.axes.detach().numpy()
    np.testing.assert_allclose(axes[..., 2], outward, atol=1e-5)
    np.testing.assert_allclose(np.einsum("nij,nik->njk", axes, axes), np.tile(np.eye(3), (len(axes), 1, 1)), atol=1e-5)


def test_offsets_turns_and_bent_normals_of_eyes_do_nothing():
    record = make_frame(eye_atlas(), gaze(5, 5), LIGHTS[:1])
    avatar = make_avatar(eye_atlas(), EYES)
    before = avatar.prepare(FrameInputs(eye_atlas(), record))
    with torch.no_grad():
        for name in ("offset", "rotation", "normal_offset"):
            avatar.get_parameter(name).add_(0.1 * torch.randn(avatar.get_parameter(name).shape))
    after = avatar.prepare(FrameInputs(eye_atlas(), record))
    for name in ("means", "quaternions"):
        assert torch.equal(getattr(before.gaussians, name), getattr(after.gaussians, name))
    assert torch.equal(before.surface.bent_normals, after.surface.bent_normals)


def test_colour_depends_on_the_side_only_once_it_has_learned_to():
    avatar, inputs = (
        make_avatar(eye_atlas(), EYES),
        FrameInputs(eye_atlas(), make_frame(eye_atlas(), AHEAD, LIGHTS[:1])),
    )
    frame = avatar.prepare(inputs)
    color, sides = frame.shading.diffuse, [torch.tensor([x, 0.0, 1.0]) for x in (-0.5, 0.5)]
    for side in sides:
        assert torch.equal(avatar.eyes.seen_from(frame, side, color), color)
    seen = [avatar.eyes.seen_from(frame, side, color.detach()).sum() for side in sides]
    (seen[0] - seen[1]).backward()
    gain = avatar.eyes.albedo.last.parametrizations.weight.original0.grad
    assert gain.abs().max() > 0
    with torch.no_grad():
        avatar.eyes.albedo.last.parametrizations.weight.original0.add_(gain.sign())
    left, right = (avatar.eyes.seen_from(frame, side, color).sum() for side in sides)
    assert left > right


def test_saved_avatars_come_back_with_their_eyes(tmp_path):
    avatar = mirrors()
    with torch.no_grad():
        avatar.eyes.shift.fill_(0.3)
    write_atlas(tmp_path / "atlas.safetensors", eye_atlas())
    save_avatar(tmp_path / "avatar", avatar, {})
    loaded = load_avatar(tmp_path / "avatar", tmp_path / "atlas.safetensors")
    record, image = make_frame(eye_atlas(), gaze(5, 5), LIGHTS[:1]), make_image(CAMERA, MIDDLE, 1.0, 100)
    pictures = [one.render(record, image)[0] for one in (loaded, LoadedAvatar(avatar, eye_atlas()))]
    assert pictures[0].max() > 0.1 and torch.equal(*pictures)


def test_eyes_that_the_template_has_not_are_named():
    lost = make_eyes()
    lost["eye_l"] = lost["eye_l"].__class__(**{**lost["eye_l"].__dict__, "vertices": (10**6,)})
    with pytest.raises(InputError, match="eye_l: expected vertices 0 to 1283"):
        make_avatar(eye_atlas(), lost)
    lost["eye_l"] = lost["eye_l"].__class__(**{**lost["eye_l"].__dict__, "vertices": (0, 1)})
    with pytest.raises(InputError, match=r"\['eye_l'\]: expected texels"):
        make_avatar(eye_atlas(), lost)
