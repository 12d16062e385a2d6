"""Parts of an avatar: a new one is a class and a line in a registry, and nothing else has to know of it."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.avatar import build
from pipeline.avatar.appearance.models import DiffuseModel
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.geometry.gaussians_on_texels import GaussiansOnTexels
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.losses import regularization
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

PLAIN = {"specular": False, "shadow": False, "shadow_width": 4, "supersample": 1, "dilation_px2": 0.1}
SHEET = make_sheet(12)
FRAME = make_frame(SHEET, np.array([[0.0, 0.0, 1.0]]), np.ones((1, 3)))


class Glow(DiffuseModel):
    """Texels that shine by themselves, with a strength of their own."""

    def __init__(self, store, spec):
        super().__init__(store, spec)
        store.add("glow", store.fill(0.5))

    def shade(self, parameters, surface, incident):
        return self.store.albedo * self.store.glow[:, None]

    def penalties(self, parameters):
        return {"gloss": self.store.glow.square().mean()}


def test_new_diffuse_model_is_built_shown_and_penalised(monkeypatch):
    """Under a name that settings know already."""
    monkeypatch.setitem(build.DIFFUSE, "microfacet", Glow)
    avatar = Avatar(SHEET, texel_spacing(SHEET), AvatarSpec(**PLAIN, shading="microfacet", normals="mesh"))
    assert {name for name, _ in avatar.named_parameters()} == {
        "offset", "rotation", "log_scale", "opacity", "albedo", "glow"
    }  # fmt: skip
    frame = avatar.prepare(FrameInputs(SHEET, FRAME))
    picture = avatar.view(frame, camera_view(make_image(FRAME, np.ones(3))))
    torch.testing.assert_close(picture.rgb[12, 12], 0.5 * 0.4 * picture.alpha[12, 12].expand(3))
    assert regularization(avatar, frame, TrainAvatar(weight_gloss=2.0))["gloss"].item() == 0.5
    picture.rgb.sum().backward()
    assert avatar.glow.grad.abs().sum() > 0


class HalfOpaque(GaussiansOnTexels):
    """Gaussians that never are more than half opaque."""

    def place(self, parameters, posed):
        gaussians, axes = super().place(parameters, posed)
        return type(gaussians)(gaussians.means, gaussians.quaternions, gaussians.scales, gaussians.opacities / 2), axes


def test_new_primitives_are_placed_and_drawn(monkeypatch):
    monkeypatch.setitem(build.PRIMITIVES, "half", HalfOpaque)
    camera, alphas = camera_view(make_image(FRAME, np.ones(3))), []
    for name in ("gaussians", "half"):
        monkeypatch.setattr(AvatarSpec, "primitives", name)
        avatar = Avatar(SHEET, texel_spacing(SHEET), AvatarSpec(**PLAIN))
        alphas.append(avatar.view(avatar.prepare(FrameInputs(SHEET, FRAME)), camera).alpha[12, 12].item())
    assert alphas[1] < alphas[0]
