"""Albedo that a training starts from: of a sheet whose pictures are known in closed form, and what nothing tells."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.isra_albedo import isra_factors, isra_round, starts_from_images
from pipeline.avatar.training.step_loss import Portion
from pipeline.avatar.training.training import Training
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

ALBEDO = np.array([0.7, 0.4, 0.2])
PLACES = [[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2], [0.1, -0.5, 1.4], [-0.3, 0.5, 1.3]]


def rounds(changed=lambda image: image):
    """A round of two frames, of two images each, and one more."""
    atlas = make_sheet(16)
    frames = [make_frame(atlas, np.array([at]), np.full((1, 3), 3.0), number) for number, at in enumerate(PLACES)]
    images = [[changed(make_image(frame, ALBEDO, shift)) for shift in (-0.2, 0.2)] for frame in frames]
    portions = [Portion(FrameInputs(atlas, frame), own, 2) for frame, own in zip(frames, images, strict=True)]
    return atlas, [portions[:2], portions[2:]]


def started(scene, settings=TrainAvatar(), planned=frozenset()):
    atlas, portions = scene
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, planned))
    isra_round(Training(avatar, settings), portions)
    return avatar


@pytest.mark.parametrize("settings", [{}, {"shading": "transfer"}, {"steps_together": 1, "frames_per_step": 2}])
def test_pictures_tell_the_albedo_of_a_sheet(settings) -> None:
    """Within what Gaussians let through between them, and the truncation of the transfer, 2 % each."""
    avatar = started(rounds(), TrainAvatar(**settings))
    found = avatar.albedo.detach().reshape(16, 16, 3)[4:12, 4:12].reshape(-1, 3)
    assert (found.median(0).values.numpy() / ALBEDO) == pytest.approx(1, abs=0.04)
    assert all(each.requires_grad for each in avatar.parameters())
    assert avatar.albedo.grad is None or not avatar.albedo.grad.any()


def test_albedo_starts_from_images_where_they_tell_it() -> None:
    """Where light also spreads below the surface, or a transfer is learned, grey, unless the settings say so."""
    for settings, planned, expected in (
        ({}, {"specular"}, True), ({}, {"learned_transport"}, False), ({"shading": "transfer"}, set(), False),
        ({"albedo_start": "grey"}, set(), False), ({"albedo_start": "images"}, {"learned_transport"}, True),
    ):  # fmt: skip
        asked = TrainAvatar(**settings)
        assert starts_from_images(asked, resolve_spec(asked, planned)) == expected


def test_gloss_that_is_drawn_counts_as_seen() -> None:
    """A matte sheet looks darker than one with gloss, so its albedo is taken for no more than it is."""
    matte, glossy = (started(rounds(), planned=planned).albedo.mean() for planned in (frozenset(), {"specular"}))
    assert 0.5 * matte < glossy < matte


def test_pictures_that_show_nothing_tell_nothing() -> None:
    atlas = make_sheet(16)
    grey = Avatar(atlas, texel_spacing(atlas), resolve_spec(TrainAvatar(), ())).albedo
    assert torch.equal(started(rounds(lambda image: replace(image, mask=0 * image.mask))).albedo, grey)


def test_black_pictures_are_of_a_black_subject() -> None:
    avatar = started(rounds(lambda image: replace(image, image=0 * image.image)))
    assert not avatar.albedo.any()


def test_what_is_not_seen_is_as_the_rest() -> None:
    drawn = torch.tensor([[1.0, 1, 1], [1, 1, 1], [0, 0, 0]])
    factors = isra_factors(drawn * torch.tensor([0.5, 1.0, 2.0]), drawn)
    assert factors == pytest.approx(torch.tensor([0.5, 1.0, 2.0]).expand(3, 3))
    uneven = isra_factors(
        torch.tensor([[1.0, 2, 0], [3, 2, 0], [0, 0, 0]]), torch.tensor([[2.0, 1, 0]] * 2 + [[0] * 3])
    )
    # Two texels that are seen weigh 1 / (1 + 0.02 x 2 / 3) by themselves.
    assert uneven[:, 0].tolist() == pytest.approx([0.5 + 0.5 * 0.04 / 3.04, 1.5 - 0.5 * 0.04 / 3.04, 1.0])
    assert uneven[:, 2].tolist() == [1.0, 1.0, 1.0]
