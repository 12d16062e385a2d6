"""Lambert with learned transfer of what it leaves over."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.losses import regularization
from pipeline.config.train_avatar import TrainAvatar
from pipeline.lighting.zonal import clamped_cosine_coefficients
from tests.support.avatars.sheet import make_frame, make_sheet

SHEET = make_sheet(6)
PLANNED = {"shadow", "near_field", "specular", "articulation"}
LIGHT, INTENSITY = np.array([0.1, 0.05, 1.5]), 2.0
TRUNCATED = 0.034
"""How far zonal harmonics of up to degree 8 are off the clamped cosine, of its peak."""


def lit(shading, lights, change=lambda avatar: None):
    avatar = Avatar(SHEET, texel_spacing(SHEET), resolve_spec(TrainAvatar(shading=shading), PLANNED))
    with torch.no_grad():
        change(avatar)
        frame = avatar.prepare(FrameInputs(SHEET, make_frame(SHEET, lights, np.full((len(lights), 3), INTENSITY))))
    return avatar, frame


def backwards(avatar):
    """Transfer of a sheet that is lit from behind as Lambert is from the front."""
    lobe = torch.as_tensor(clamped_cosine_coefficients()) * (-1.0) ** torch.arange(9)
    avatar.transfer_color[:, 2] = lobe[:4, None]
    avatar.transfer_mono[:, 2] = lobe[4:]


def test_a_new_avatar_shades_as_lambert_does():
    (_, combined), (_, plain) = (lit(shading, LIGHT[None]) for shading in ("combined", "microfacet"))
    assert combined.shading.diffuse.min() > 0.05
    torch.testing.assert_close(combined.shading.diffuse, plain.shading.diffuse)


@pytest.mark.parametrize("side", [1, -1])
def test_learned_light_passes_what_hides_a_lamp(side):
    """A lamp behind the sheet is in its own shadow, and shines through it as the transfer says."""
    lamp = LIGHT * [1, 1, side]
    _, frame = lit("combined", lamp[None], backwards)
    points = frame.surface.posed.points.numpy().astype(np.float64)
    offset = lamp - points
    distance = np.linalg.norm(offset, axis=1)
    expected = 0.4 / np.pi * INTENSITY * np.abs(offset[:, 2]) / distance**3
    found, peak = frame.shading.diffuse.numpy(), 0.4 / np.pi * INTENSITY / distance.min() ** 2
    np.testing.assert_allclose(found, np.tile(expected[:, None], 3), atol=TRUNCATED * peak)


def test_transfer_is_paid_for_from_nothing_on():
    weights = TrainAvatar(weight_leftover=2.0)
    avatar, frame = lit("combined", LIGHT[None])
    assert regularization(avatar, frame, weights)["leftover"] == 0
    avatar, frame = lit("combined", LIGHT[None], lambda avatar: avatar.transfer_mono.fill_(0.1))
    torch.testing.assert_close(regularization(avatar, frame, weights)["leftover"], torch.tensor(2 * 0.1**2))
