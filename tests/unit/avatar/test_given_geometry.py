"""Avatars on another's geometry: it is the other's and stays, in every pose, while all else is learned."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec, unread_settings
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import load_avatar, save_avatar
from pipeline.avatar.training.given_geometry import take_geometry, with_given_geometry
from pipeline.avatar.training.training import Training
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

SMALL = {"code_size": 8, "decoder_channels": (8, 4), "pose_points": 4}
FULL = TrainAvatar(shading="transfer", deferred="on", steps=9, parameters="decoded", shadow_width=4, **SMALL)
PLANNED = {"shadow", "articulation", "near_field", "specular", "deferred"}
ALBEDO = np.array([0.7, 0.4, 0.2])
STEPS = 3

ROWS = {
    "pbr": {"shading": "microfacet", "visibility": "traced", "indirect": "bounce"},
    "pbr without networks": {"shading": "microfacet", "visibility": "traced", "parameters": "texels"},
    "sh": {"shading": "harmonics"},
    "no_shadow": {"shadow": "off"},
}


def folded(atlas, fold, number=0):
    """The sheet with one corner lifted by `fold` metres, under two lamps."""
    frame = make_frame(atlas, np.array([[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2]]), np.full((2, 3), 3.0), number)
    vertices = frame.vertices.copy()
    vertices[1, 2] += fold
    return dataclasses.replace(frame, vertices=vertices)


def train(avatar, settings, frames, first=0, steps=STEPS):
    training = Training(avatar, settings, images=len(frames))
    inputs, images = ([FrameInputs(avatar.atlas, f) for f in frames], [make_image(f, ALBEDO, 0.1) for f in frames])
    for step in range(first, first + steps):
        training.take_step(step, inputs[step % len(frames)], [images[step % len(frames)]])
    return training


ROUNDINGS = 32 * 2.0**-24
"""A last layer with fewer channels may add up its 16 products, of 4 texels and 4 channels, in another order: two
roundings each, of half a unit in the last place of numbers no larger than the largest."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An atlas, two poses, and the folders of two trained avatars, with and without networks."""
    root, atlas = tmp_path_factory.mktemp("given"), make_sheet(8)
    write_atlas(root / "atlas.safetensors", atlas)
    frames = [folded(atlas, 0.0, 0), folded(atlas, 0.1, 1)]
    for name, changes in (("full", {}), ("texels", {"parameters": "texels"})):
        torch.manual_seed(0)
        settings = FULL.model_copy(update=changes)
        avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, PLANNED))
        train(avatar, settings, frames)
        save_avatar(root / name, avatar, {})
    return root, atlas, frames


def taken(made, source, **changes):
    root, atlas, _ = made
    torch.manual_seed(1)
    settings = FULL.model_copy(update=changes | {"geometry_from": source})
    avatar = Avatar(atlas, texel_spacing(atlas), with_given_geometry(resolve_spec(settings, PLANNED), root / source))
    take_geometry(avatar, root / source, root / "atlas.safetensors")
    return avatar, settings


@torch.no_grad()
def gaussians(avatar, frames):
    """Numbers of all Gaussians in every pose, opacities among them."""
    found = [avatar.prepare(FrameInputs(avatar.atlas, frame)).gaussians for frame in frames]
    return [torch.cat([getattr(g, f.name).reshape(len(g.means), -1) for f in dataclasses.fields(g)
                       if isinstance(getattr(g, f.name), torch.Tensor)], 1) for g in found]  # fmt: skip


@pytest.mark.parametrize("source", ["full", "texels"])
@pytest.mark.parametrize("row", ROWS)
def test_geometry_is_the_sources_before_and_after_training(made, row, source):
    root, _, frames = made
    avatar, settings = taken(made, source, **ROWS[row])
    wanted = gaussians(load_avatar(root / source, root / "atlas.safetensors").avatar, frames)
    # Poses move the geometry of networks against the mesh, or the test would say nothing about them.
    moved = avatar.decode(FrameInputs(avatar.atlas, frames[0])).parameters, avatar.shared()
    assert torch.equal(*(parameters.offset for parameters in moved)) == (source == "texels")
    given = gaussians(avatar, frames)
    for found, expected in zip(given, wanted, strict=True):
        torch.testing.assert_close(found, expected, rtol=ROUNDINGS, atol=ROUNDINGS * float(expected.abs().max()))
    albedo = avatar.albedo.detach().clone()
    train(avatar, settings, frames)
    for found, expected in zip(gaussians(avatar, frames), given, strict=True):
        assert torch.equal(found, expected)
    assert not torch.equal(avatar.albedo, albedo)
    save_avatar(root / "again", avatar, {})
    again = load_avatar(root / "again", root / "atlas.safetensors").avatar
    assert all(torch.equal(a, b) for a, b in zip(gaussians(again, frames), given, strict=True))


def test_what_is_given_has_no_gradient_and_no_moments(made, tmp_path):
    _, _, frames = made
    avatar, settings = taken(made, "full")
    training = train(avatar, settings, frames)
    learned = {name for name, parameter in avatar.named_parameters() if parameter.requires_grad}
    assert not {name for name in learned if name.startswith("networks.given") or name in ("offset", "opacity")}
    assert {"albedo", "normal_offset", "transfer_color"} <= learned
    assert {n for n, p in avatar.named_parameters() if p in training.optimizer.state} == learned
    assert unread_settings(settings.model_copy(update={"weight_offset": 1.0}), avatar.spec) == ["weight_offset"]


def test_training_that_was_stopped_goes_on_from_its_checkpoint(made, tmp_path):
    _, _, frames = made
    whole, settings = taken(made, "full")
    train(whole, settings, frames, steps=2 * STEPS)
    first, _ = taken(made, "full")
    training = train(first, settings, frames)
    position = training.restore(tmp_path / "none", "print")
    position.step = STEPS
    training.save(tmp_path / "state", position, "print")
    second, _ = taken(made, "full", parameters="decoded")
    resumed = Training(second, settings, images=len(frames))
    assert resumed.restore(tmp_path / "state", "print").step == STEPS
    inputs, images = ([FrameInputs(second.atlas, f) for f in frames], [make_image(f, ALBEDO, 0.1) for f in frames])
    for step in range(STEPS, 2 * STEPS):
        resumed.take_step(step, inputs[step % 2], [images[step % 2]])
    for name, parameter in whole.named_parameters():
        assert torch.equal(parameter, second.get_parameter(name)), name


def test_geometry_is_handed_on_by_who_was_given_it(made):
    root, _, frames = made
    avatar, _ = taken(made, "full", **ROWS["pbr without networks"])
    save_avatar(root / "handed", avatar, {})
    last, _ = taken(made, "handed", shading="harmonics")
    assert all(torch.equal(a, b) for a, b in zip(gaussians(last, frames), gaussians(avatar, frames), strict=True))


def test_what_does_not_fit_is_named(made):
    root, _, _ = made
    other = resolve_spec(FULL.model_copy(update={"code_size": 4}), PLANNED)
    with pytest.raises(InputError, match=r"networks of the same size as in .*full, found code_size 4 and 8"):
        with_given_geometry(other, root / "full")
    assert with_given_geometry(other, root / "texels").given_geometry == "texels"
    head = resolve_spec(TrainAvatar(avatar="head"), PLANNED, "head")
    with pytest.raises(InputError, match=r"expected a body with Gaussians, found head with .*: this avatar"):
        with_given_geometry(head, root / "texels")
