"""The coat of matte light: what of it arrives, what leaves, and that training finds its share."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec, unread_settings
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_sheet

SHEET = make_sheet(6)
PLANNED = {"near_field", "specular"}
LIGHT, CAMERA, INTENSITY = np.array([1.0, 0.3, 0.4]), np.array([-0.9, 0.2, 0.25]), 2.0
START_ALBEDO, SHARE = 0.4, 0.35


def avatar_of(planned=PLANNED, **settings) -> Avatar:
    return Avatar(SHEET, texel_spacing(SHEET), resolve_spec(TrainAvatar(**settings), planned))


def sent_to_camera(avatar: Avatar) -> torch.Tensor:
    """Diffuse light that leaves the texels for the camera."""
    frame = avatar.prepare(FrameInputs(SHEET, make_frame(SHEET, LIGHT[None], np.full((1, 3), INTENSITY))))
    return avatar.leaving(frame, torch.as_tensor(CAMERA, dtype=torch.float32))[0]


def printed(share: float) -> np.ndarray:
    """Of a sheet that faces +z, lit and seen at a slant: the formula, in doubles."""
    points = SHEET.barycentric.astype(np.float64)[:, :, None] * SHEET.rest_vertices[SHEET.faces[SHEET.face]]
    points = points.sum(1)
    to_light, to_camera = LIGHT - points, CAMERA - points
    distance = np.linalg.norm(to_light, axis=1)
    cosine_in, cosine_out = to_light[:, 2] / distance, to_camera[:, 2] / np.linalg.norm(to_camera, axis=1)
    passed = (1 - share * (1 - cosine_in) ** 2.5) * (1 - share * (1 - cosine_out) ** 2.5)
    return START_ALBEDO / np.pi * INTENSITY / distance**2 * cosine_in * passed


@pytest.mark.parametrize("share", [0.0, SHARE, -0.5])
def test_a_coat_takes_its_share_of_what_comes_and_goes(share):
    avatar = avatar_of()
    with torch.no_grad():
        avatar.coat.share.fill_(share)
        found = sent_to_camera(avatar).numpy()
    np.testing.assert_allclose(found, np.tile(printed(share)[:, None], 3), rtol=2e-5)
    assert abs(printed(SHARE) / printed(0) - 1).min() > 0.2


def test_a_share_beyond_all_counts_as_all():
    avatar = avatar_of()
    with torch.no_grad():
        avatar.coat.share.fill_(3.0)
        found = sent_to_camera(avatar).numpy()
    assert found.min() > 0
    np.testing.assert_allclose(found[:, 0], printed(1.0), rtol=1e-4)
    sent_to_camera(avatar).sum().backward()
    assert avatar.coat.share.grad < 0  # more light asks for less of a coat: it does not get stuck


def test_what_has_no_gloss_or_is_asked_for_as_lambert_has_no_coat():
    for avatar in (avatar_of(matte="lambert"), avatar_of(planned={"near_field"})):
        assert not any(name.startswith("coat") for name, _ in avatar.named_parameters())
        with torch.no_grad():
            np.testing.assert_allclose(sent_to_camera(avatar)[:, 0].numpy(), printed(0.0), rtol=2e-5)
    settings = TrainAvatar(shading="transfer", matte="lambert")
    assert "matte" in unread_settings(settings, resolve_spec(settings, PLANNED))


def test_gradients_find_the_share():
    avatar = avatar_of()
    target = torch.as_tensor(printed(SHARE), dtype=torch.float32)[:, None]
    step = torch.optim.LBFGS([avatar.coat.share], line_search_fn="strong_wolfe")

    def loss():
        step.zero_grad()
        value = (sent_to_camera(avatar) / target - 1).square().mean()
        value.backward()
        return value

    step.step(loss)
    assert avatar.coat.share.item() == pytest.approx(SHARE, abs=1e-3)
