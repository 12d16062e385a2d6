"""What is built: settings that say auto follow the plan, all others are obeyed."""

from __future__ import annotations

import pytest

from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec, unread_settings
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_sheet

EVERYTHING = set(EFFECTS)


def make_avatar(spec):
    atlas = make_sheet(4)
    return Avatar(atlas, texel_spacing(atlas), spec)


def test_light_spreads_below_the_surface_where_transport_is_called_for():
    spec = resolve_spec(TrainAvatar(), EVERYTHING)
    assert (spec.shading, spec.visibility, spec.indirect) == ("subsurface", "traced", "bounce")
    assert spec.specular_model == "ggx" and not spec.shadow_net
    words = "body with coated Lambert with subsurface spread, GGX, traced shadows, one bounce, explicit eyes"
    assert describe(spec) == words
    assert resolve_spec(TrainAvatar(), EVERYTHING, "head").shading == "subsurface"


def test_papers_models():
    spec = resolve_spec(TrainAvatar(shading="transfer"), EVERYTHING)
    assert (spec.shading, spec.visibility, spec.indirect) == ("transfer", "learned", "none")
    assert spec.specular and spec.shadow and spec.deferred and spec.near_field
    head = resolve_spec(TrainAvatar(shading="harmonics"), EVERYTHING, "head")
    assert (head.shading, head.highlight, head.shadow) == ("harmonics", "half", False)


def test_gloss_starts_as_wide_as_the_images_show_it():
    assert resolve_spec(TrainAvatar(), EVERYTHING, gloss_width=0.2).start_ggx_width == 0.2
    assert resolve_spec(TrainAvatar(), EVERYTHING).start_ggx_width == 0.4
    avatar = make_avatar(resolve_spec(TrainAvatar(), {"specular"}, gloss_width=0.2))
    assert avatar.log_ggx_width.exp().tolist() == pytest.approx([0.2] * 16)


def test_nothing_is_built_that_the_plan_left_out():
    for settings, shading in ((TrainAvatar(), "microfacet"), (TrainAvatar(shading="transfer"), "harmonics")):
        spec = resolve_spec(settings, set())
        assert not (spec.specular or spec.shadow or spec.deferred or spec.near_field)
        assert (spec.shading, spec.indirect) == (shading, "none")


@pytest.mark.parametrize("planned", [set(), EVERYTHING])
def test_what_is_said_is_obeyed(planned):
    spec = resolve_spec(
        TrainAvatar(
            shading="transfer", specular=False, shadow=True, near_field=True, articulation=True, deferred=False
        ),
        planned,
    )
    assert spec.shadow
    assert spec.near_field
    assert not spec.specular
    assert not spec.deferred
    assert spec.shading == "transfer"


@pytest.mark.parametrize("kind", ["body", "head"])
def test_analytic_shading_takes_the_place_of_learned_transport(kind):
    spec = resolve_spec(TrainAvatar(), EVERYTHING - {"learned_transport"}, kind)
    assert (spec.avatar, spec.shading, spec.visibility, spec.indirect) == (kind, "microfacet", "traced", "bounce")
    assert spec.shadow and spec.eyes and spec.specular_model == "ggx"
    convex = resolve_spec(TrainAvatar(), {"specular"}, kind)
    assert (convex.shading, convex.traced, convex.indirect) == ("microfacet", False, "none")


def test_specs_in_words():
    words = describe(resolve_spec(TrainAvatar(), EVERYTHING - {"learned_transport"}, "head"))
    assert words == "head with coated Lambert, GGX, traced shadows, one bounce, explicit eyes"
    words = describe(resolve_spec(TrainAvatar(shading="transfer", near_field="off", eyes="off"), EVERYTHING))
    assert words == "body with zonal transfer, angular lobe per pixel, learned shadows, distant lights"
    plain = resolve_spec(TrainAvatar(shading="transfer"), {"articulation", "near_field"})
    assert describe(plain) == "body with zonal transfer"


def test_traced_shadows_need_transfer_that_turns():
    settings = TrainAvatar(shading="transfer", visibility="traced")
    assert resolve_spec(settings, {"shadow"}).shading == "transfer"


def test_irradiance_is_read_by_shadow_networks_alone():
    learned = {"shadow", "learned_transport"}
    papers = TrainAvatar(shading="transfer")
    assert papers.reads_irradiance(learned) and not papers.reads_irradiance({"learned_transport"})
    assert not TrainAvatar().reads_irradiance(learned)
    assert TrainAvatar(shading="transfer", shadow="on").reads_irradiance(set())
    assert not TrainAvatar(shading="transfer", visibility="traced").reads_irradiance(learned)
    assert not TrainAvatar().reads_irradiance({"shadow"})


@pytest.mark.parametrize(
    ("settings", "planned", "unread"),
    [
        (TrainAvatar(depth="median", transfer_degree=3, weight_gloss=1.0), {"specular"}, ["depth", "transfer_degree"]),
        (TrainAvatar(shading="transfer", depth="median", transfer_degree=3), EVERYTHING, []),
        (TrainAvatar(shading="transfer", weight_gloss=1.0), EVERYTHING, ["weight_gloss"]),
        (TrainAvatar(shading="combined", weight_transfer=1.0, weight_leftover=1.0), EVERYTHING, ["weight_transfer"]),
        (TrainAvatar(eyes="off", weight_eye_scale=1.0, weight_kl=1.0), EVERYTHING, ["weight_eye_scale", "weight_kl"]),
    ],
)
def test_settings_that_nothing_reads_are_named(settings, planned, unread):
    assert unread_settings(settings, resolve_spec(settings, planned)) == unread


def test_default_settings_are_never_named_unread():
    for kind in ("body", "head"):
        assert unread_settings(TrainAvatar(), resolve_spec(TrainAvatar(), set(), kind)) == []
