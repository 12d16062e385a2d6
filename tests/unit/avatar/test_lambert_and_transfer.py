"""Lambert with learned transfer of what it leaves over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.matter import read_matter
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import EVERYWHERE, resolve_spec
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.losses import regularization
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texel_regions import in_regions
from pipeline.lighting.zonal import clamped_cosine_coefficients
from tests.support.avatars.sheet import labelled, make_frame, make_sheet

SHEET = make_sheet(6)
PLANNED = {"shadow", "near_field", "specular", "articulation"}
LIGHT, INTENSITY = np.array([0.1, 0.05, 1.5]), 2.0
TRUNCATED = 0.034
"""How far zonal harmonics of up to degree 8 are off the clamped cosine, of its peak."""

LABELLED = labelled(SHEET)


def lit(shading, lights, change=lambda avatar: None, regions=EVERYWHERE):
    spec = resolve_spec(TrainAvatar(shading=shading), PLANNED | {"learned_transport"}, regions=regions)
    avatar = Avatar(LABELLED, texel_spacing(SHEET), spec)
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


def test_regions_without_gloss_reflect_nothing():
    camera = torch.tensor([0.0, 0.0, 1.0])
    shiny, frame = lit("auto", LIGHT[None])
    some, part = lit("auto", LIGHT[None], regions={"specular": ("cloth",)})
    reflected, cut = (
        avatar.built.specular.texel_light(prepared, avatar.viewed(prepared, camera), camera)
        for avatar, prepared in ((shiny, frame), (some, part))
    )
    cloth = in_regions(LABELLED, ("cloth",))
    assert reflected.min() > 0
    torch.testing.assert_close(cut[cloth], reflected[cloth])
    assert not cut[~cloth].any()
    assert np.array_equal(read_matter(some).gloss > 0, cloth)


def folded():
    """The sheet with one corner folded up, under a low lamp behind it, which most of the rest is hidden from."""
    up = np.array([[0, 0, 0], [0.0, 0, 0.06], [0, 0, 0], [0, 0, 0]], np.float32)
    frame = make_frame(LABELLED, np.array([[1.5, 1.2, 0.3]]), np.full((1, 3), INTENSITY))
    return replace(frame, vertices=LABELLED.rest_vertices + up)


def test_regions_without_shadows_see_all_lights_and_trace_nothing():
    avatars = {
        name: Avatar(LABELLED, texel_spacing(SHEET), resolve_spec(TrainAvatar(), planned, regions=regions))
        for name, planned, regions in (
            ("whole", PLANNED, EVERYWHERE), ("part", PLANNED, {"shadow": ("cloth",)}),
            ("none", PLANNED - {"shadow"}, {"shadow": ("cloth",)}),
        )
    }  # fmt: skip
    inputs = {name: FrameInputs(LABELLED, folded(), shadowed=avatar.shadowed) for name, avatar in avatars.items()}
    light = {name: avatar.prepare(inputs[name]).shading.diffuse for name, avatar in avatars.items()}
    cloth = in_regions(LABELLED, ("cloth",))
    assert avatars["whole"].shadowed is None and avatars["none"].spec.shadow_regions == ()
    assert np.array_equal(avatars["part"].shadowed, cloth)
    assert "traced shadows (cloth)" in describe(avatars["part"].spec)
    hidden = (light["whole"] != light["none"]).any(1).numpy()
    assert (hidden & cloth).any() and (hidden & ~cloth).any()
    assert torch.equal(light["part"][cloth], light["whole"][cloth])
    assert torch.equal(light["part"][~cloth], light["none"][~cloth])
    # Light comes to the region from all texels; to the others from none.
    assert torch.equal(inputs["part"].bounces[cloth], inputs["whole"].bounces[cloth])
    assert (inputs["part"].bounces[~cloth] == LABELLED.texel_count).all()


def test_what_is_asked_for_is_asked_for_everywhere():
    regions = {"learned_transport": ("cloth",), "specular": ("cloth",), "shadow": ("cloth",)}
    spec = resolve_spec(TrainAvatar(shading="combined", specular="on", shadow="on"), PLANNED, regions=regions)
    assert spec.transport_regions == spec.gloss_regions == spec.shadow_regions == ()


def test_transfer_is_paid_for_from_nothing_on():
    weights = TrainAvatar(weight_leftover=2.0)
    avatar, frame = lit("combined", LIGHT[None])
    assert regularization(avatar, frame, weights)["leftover"] == 0
    avatar, frame = lit("combined", LIGHT[None], lambda avatar: avatar.transfer_mono.fill_(0.1))
    torch.testing.assert_close(regularization(avatar, frame, weights)["leftover"], torch.tensor(2 * 0.1**2))
