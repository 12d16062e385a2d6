"""Hair does not count in the alpha sparsity (RFGCA Appendix B)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.lobes import SMALLEST_ALPHA
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.losses import alpha_sparsity, shown_hair
from pipeline.avatar.training.step_loss import Portion, compute_loss
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

SETTINGS = TrainAvatar(shading="microfacet", shadow="off", indirect="none", weight_alpha_sparsity=1.0)

BLUR = 0.05
"""Gaussians of a sheet of 16 texels are as wide as 1 / 16 of it: they smear a slope of 1 per sheet over itself, which
changes only the ends."""


def shown(**regions):
    """A sheet with regions, its frame, image and camera."""
    atlas = dataclasses.replace(make_sheet(16), regions={name: np.array(v) for name, v in regions.items()})
    torch.manual_seed(0)
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(SETTINGS, {"near_field", "specular"}))
    record = make_frame(atlas, np.array([[0.5, 0.3, 1.5]]), np.full((1, 3), 3.0))
    return avatar, FrameInputs(atlas, record), make_image(record, np.array([0.7, 0.4, 0.2]))


def test_share_of_hair_follows_the_labels_and_not_the_coverage():
    avatar, inputs, image = shown(hair=[0, 1])  # the upper edge of the sheet
    hair = shown_hair(avatar, avatar.prepare(inputs), camera_view(image))
    assert not hair.requires_grad
    rows = np.flatnonzero(image.mask.any(1))
    inside = rows[3:-3]
    along = 1 - (inside - rows[0] + 0.5) / len(rows)
    np.testing.assert_allclose(hair[inside][:, image.mask.shape[1] // 2], along, atol=BLUR)


def test_pixels_of_hair_do_not_count():
    alpha, mask = torch.full((8, 8), 0.4, requires_grad=True), torch.ones(8, 8)
    hair = torch.zeros(8, 8)
    hair[:, :4] = 1.0
    term = alpha_sparsity(alpha, mask, hair=hair)
    assert float(term.detach()) == pytest.approx(0.2)  # 0.4 in half of the pixels
    (slope,) = torch.autograd.grad(term, alpha)
    assert not slope[:, :4].any() and slope[:, 4:].all()


def test_training_leaves_hair_out_and_changes_nothing_without_labels():
    terms = {}
    for name, regions in {"none": {}, "other": {"cloth": [0, 1]}, "hair": {"hair": [0, 1, 2, 3]}}.items():
        avatar, inputs, image = shown(**regions)
        terms[name] = float(compute_loss(avatar, Portion(inputs, [image], 1), SETTINGS)["alpha_sparsity"].detach())
    assert terms["none"] == terms["other"] > 0
    # All of it is hair. Where alpha is below SMALLEST_ALPHA the share is not, by at most alpha (1 - alpha / SMALLEST).
    assert terms["hair"] < min(SMALLEST_ALPHA / 4, terms["none"] / 100)
