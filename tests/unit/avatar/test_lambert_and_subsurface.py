"""Lambert with light that spreads below the surface."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import EVERYWHERE, resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texel_regions import in_regions
from tests.support.avatars.sheet import labelled, make_frame, make_sheet

SHEET = make_sheet(6)
LABELLED = labelled(SHEET)
PLANNED = {"shadow", "near_field", "specular", "articulation", "learned_transport"}
LIGHT = np.array([0.1, 0.05, 1.5])
PROFILE = torch.tensor([[0.5, 0.2, 0.1], [0.4, 0.1, 0.0], [0.3, 0.0, 0.0], [0.2, 0.0, 0.1], [0.1, 0.0, 0.0]])
"""Red spreads furthest, as in skin."""


def avatar_of(regions=EVERYWHERE, profile=PROFILE, **choices):
    spec = resolve_spec(TrainAvatar(**choices), PLANNED, regions=regions)
    avatar = Avatar(LABELLED, texel_spacing(SHEET), spec)
    with torch.no_grad():
        if profile is not None and spec.shading == "subsurface":
            avatar.subsurface.weight.copy_(profile)
    return avatar


def diffuse(avatar, lamps, intensities):
    return avatar.prepare(FrameInputs(LABELLED, make_frame(LABELLED, lamps, intensities))).shading.diffuse


def test_a_new_avatar_shades_as_lambert_does():
    found, plain = (
        diffuse(avatar_of(profile=None, shading=shading), LIGHT[None], np.full((1, 3), 2.0))
        for shading in ("subsurface", "microfacet")
    )
    assert plain.min() > 0.05
    assert torch.equal(found, plain)


def test_light_of_two_lamps_is_the_sum_of_each():
    avatar, lamps = avatar_of(), np.stack([LIGHT, LIGHT * [-2, 1, 1]])
    powers = np.array([[2.0, 1.0, 0.5], [0.5, 1.0, 3.0]])
    with torch.no_grad():
        both = diffuse(avatar, lamps, powers)
        one, other = (diffuse(avatar, lamps[[i]], powers[[i]]) for i in range(2))
    torch.testing.assert_close(both, one + other)


def test_light_spreads_within_the_regions_that_have_it():
    planned = {"learned_transport": ("cloth",)}
    some, plain = avatar_of(planned), avatar_of(shading="microfacet")
    assert some.spec.shading == "subsurface" and some.spec.transport_regions == ("cloth",)
    cloth = in_regions(LABELLED, ("cloth",))
    assert 0 < cloth.sum() < len(cloth)
    with torch.no_grad():
        found, bare = (diffuse(avatar, LIGHT[None], np.full((1, 3), 2.0)) for avatar in (some, plain))
    assert torch.equal(found[~cloth], bare[~cloth])
    assert (found[cloth] > 1.05 * bare[cloth])[:, 0].all()


def test_all_texels_share_the_profile_and_teach_it():
    avatar = avatar_of(profile=None)
    diffuse(avatar, LIGHT[None], np.full((1, 3), 2.0)).sum().backward()
    assert avatar.subsurface.weight.shape == (5, 3) and (avatar.subsurface.weight.grad > 0).all()


def test_profile_is_stored_and_its_kernels_are_made_anew():
    avatar, other = avatar_of(), avatar_of(profile=None)
    assert {name for name in avatar.state_dict() if name.startswith("subsurface")} == {"subsurface.weight"}
    other.load_state_dict(avatar.state_dict())
    with torch.no_grad():
        light = LIGHT[None], np.full((1, 3), 2.0)
        assert torch.equal(diffuse(other, *light), diffuse(avatar, *light))
