"""Intrinsic layers: they make the picture up, and each shows what was planted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.intrinsic_layers import ROUGHNESS_AT_TOP, as_pictures, intrinsic_layers, traced_shadow
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.config.train_avatar import TrainAvatar
from pipeline.metrics.comparison import labelled_panels
from tests.support.avatars import eyeballs
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

PLANNED = {"shadow", "near_field", "specular", "deferred", "articulation"}
SHEET = make_sheet(12)
LIGHT = np.array([[0.2, 0.1, 1.2]])
FOLDED = replace(
    make_frame(SHEET, LIGHT, np.ones((1, 3)) * 5),
    vertices=SHEET.rest_vertices + np.array([[0, 0, 0], [0.0, 0, 0.2], [0, 0, 0], [0, 0, 0]], np.float32),
    irradiance=np.full(SHEET.texel_count, 0.5, np.float32), cosine_visibility=np.full(144, 0.7, np.float32),
)  # fmt: skip
CAMERA = camera_view(make_image(FOLDED, np.ones(3), 0.1, 20))
MODELS = {
    "lobe per pixel, learned shadow": {"shading": "transfer", "deferred": "on"},
    "lobe per Gaussian": {"shading": "transfer", "deferred": "off", "shadow": "off"},
    "GGX, traced shadow, bounce": {"shading": "microfacet"},
    "no gloss, ambient light": {"shading": "microfacet", "specular": "off", "shadow": "off", "indirect": "ambient"},
}
ROUNDING = 2e-6


def built(**settings):
    torch.manual_seed(0)
    avatar = Avatar(SHEET, texel_spacing(SHEET), resolve_spec(TrainAvatar(**settings), PLANNED))
    with torch.no_grad():
        avatar.albedo[:] = torch.rand(144, 3)
        if avatar.spec.lobe:
            avatar.log_roughness[:], avatar.visibility[:] = np.log(0.25), 2.0
    return avatar


def prepared(avatar):
    with torch.no_grad():
        return avatar.prepare(FrameInputs(avatar.atlas, FOLDED))


@pytest.mark.parametrize("model", MODELS)
def test_layers_make_the_picture_up(model):
    avatar = built(**MODELS[model])
    frame = prepared(avatar)
    layers, picture = intrinsic_layers(avatar, frame, CAMERA), avatar.view(frame, CAMERA)
    shadow = layers.shadow if frame.shading.shadow is not None else 1
    made = (layers.diffuse + layers.specular) * shadow + (0 if layers.indirect is None else layers.indirect)
    assert (made - picture.rgb).abs().max() < ROUNDING * picture.rgb.abs().max()
    assert layers.diffuse.max() > 0.05
    assert (layers.specular.abs().max() > 1e-3) == ("gloss" not in model)


def test_each_layer_shows_what_was_planted():
    avatar = built(shading="transfer", deferred="on")
    with torch.no_grad():
        avatar.albedo[:] = torch.tensor([0.7, 0.4, 0.2])
        avatar.log_roughness[:] = np.log(0.12)
        avatar.visibility[:] = torch.logit(torch.tensor(0.3))
    frame = prepared(avatar)
    layers = intrinsic_layers(avatar, frame, CAMERA)
    covered = avatar.view(frame, CAMERA).alpha > 0.5
    assert (layers.albedo[covered] - torch.tensor([0.7, 0.4, 0.2])).abs().max() < 1e-5
    assert (layers.roughness[covered] - 0.12).abs().max() < 1e-5
    assert (layers.visibility[covered] - 0.3).abs().max() < 1e-5
    assert (layers.shadow[covered] - 0.7).abs().max() < 1e-5  # where the network starts
    assert (layers.normal[covered].norm(dim=-1) - 1).abs().max() < 1e-5
    lower = layers.normal[15, 5]  # of the half that was not lifted
    assert lower[2] > 0.9
    assert not layers.albedo[~covered & (avatar.view(frame, CAMERA).alpha == 0)].any()


def test_roughness_of_a_pixel_does_not_depend_on_how_much_is_covered():
    """Blending weighs it with the opacity: a surface of 0.12 that covers half of the pixel adds up to 0.06."""
    alpha = torch.tensor([0.02, 0.5, 1.0])
    found = built(shading="transfer", deferred="on").built.specular.of_pixels(0.12 * alpha, alpha)
    assert found.tolist() == pytest.approx([0.12] * 3, rel=1e-6)


def test_traced_shadow_is_the_share_that_nothing_hides():
    """Of one lamp: all of it, or nothing where the lifted corner is in the way."""
    avatar = built(shading="microfacet", specular="off", indirect="none")
    frame = prepared(avatar)
    shown = intrinsic_layers(avatar, frame, CAMERA).shadow
    bits = FrameInputs(SHEET, FOLDED).visibility_bits
    seen = torch.as_tensor(np.unpackbits(bits, axis=1, bitorder="little")[0, :144].astype(bool))
    facing = (frame.surface.bent_normals * (torch.tensor(LIGHT[0]) - frame.gaussians.means)).sum(-1) > 0
    assert torch.equal(traced_shadow(avatar, frame)[facing], seen[facing].float())
    assert shown.min() >= 0 and shown.max() <= 1 + 1e-6


def test_eyes_show_their_own_roughness_and_the_skin_keeps_its():
    atlas = eyeballs.eye_atlas()
    avatar = eyeballs.make_avatar(atlas, eyeballs.EYES)
    record = eyeballs.make_frame(atlas, eyeballs.gaze(0, 0), eyeballs.LIGHTS)
    camera = camera_view(eyeballs.make_image(eyeballs.CAMERA, eyeballs.MIDDLE, 2.0, 60))
    with torch.no_grad():
        frame = avatar.prepare(FrameInputs(atlas, record))
        layers, picture = intrinsic_layers(avatar, frame, camera), avatar.view(frame, camera)
    covered = picture.alpha > 0.5
    assert (layers.roughness[covered] - 0.05).abs().max() < 1e-5
    assert ((layers.diffuse + layers.specular) - picture.rgb).abs().max() < ROUNDING * picture.rgb.max()


def test_pictures_of_layers():
    layers = intrinsic_layers(built(shading="transfer", deferred="on"), prepared(built(shading="transfer")), CAMERA)
    pictures = as_pictures(layers, CAMERA)
    assert list(pictures) == [
        "albedo", "normal, as the camera sees it", "diffuse", "specular", f"roughness, 0 to {ROUGHNESS_AT_TOP:g}",
        "visibility, 0.001 to 1, logarithmic", "shadow",
    ]  # fmt: skip
    for picture in pictures.values():
        assert picture.shape == (20, 20, 3) and picture.min() >= 0 and picture.max() <= 1
    # Three decades from black to white.
    found, expected = pictures["visibility, 0.001 to 1, logarithmic"], 1 + layers.visibility.clamp(1e-3, 1).log10() / 3
    np.testing.assert_allclose(found, expected.numpy().repeat(3, -1), atol=1e-6)
    drawn = labelled_panels(pictures, "someone")
    assert drawn.dtype == np.uint8 and drawn.shape == (22 + 2 * (22 + 60), 4 * (60 + 6) - 6, 3)
    toward = pictures["normal, as the camera sees it"][15, 5]
    assert toward[2] > 0.9  # blue: it faces the camera
    panel = drawn[44 + 3 * 15 + 1, 66 + 3 * 5 + 1] / 255
    assert np.abs(panel - toward).max() < 1 / 255
