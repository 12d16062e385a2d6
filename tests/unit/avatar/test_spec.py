"""What is built: settings that say auto follow the plan, all others are obeyed."""

from __future__ import annotations

import pytest

from pipeline.avatar.spec.planned import resolve_spec
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar

EVERYTHING = set(EFFECTS)


def test_default_is_the_papers_model_where_a_scene_calls_for_it():
    """Learned transport and deferred shading are what `full` is, not what a scene calls for."""
    spec = resolve_spec(TrainAvatar(), EVERYTHING - {"learned_transport", "deferred"})
    assert (spec.shading, spec.visibility, spec.indirect) == ("transfer", "learned", "none")
    assert spec.specular
    assert spec.shadow
    assert spec.deferred
    assert spec.near_field


def test_nothing_is_built_that_the_plan_left_out():
    spec = resolve_spec(TrainAvatar(deferred="auto"), set())
    assert not (spec.specular or spec.shadow or spec.deferred or spec.near_field)
    assert spec.shading == "harmonics"


@pytest.mark.parametrize("planned", [set(), EVERYTHING])
def test_what_is_said_is_obeyed(planned):
    spec = resolve_spec(
        TrainAvatar(specular=False, shadow=True, near_field=True, articulation=True, deferred=False), planned
    )
    assert spec.shadow
    assert spec.near_field
    assert not spec.specular
    assert not spec.deferred
    assert spec.shading == "transfer"


def test_analytic_shading_takes_the_place_of_learned_transport():
    auto = TrainAvatar(shading="auto")
    assert resolve_spec(auto, EVERYTHING).shading == "transfer"
    spec = resolve_spec(auto, EVERYTHING - {"learned_transport"})
    assert (spec.shading, spec.visibility, spec.indirect) == ("microfacet", "traced", "bounce")
    convex = resolve_spec(auto, {"specular"})
    assert (convex.shading, convex.traced, convex.indirect) == ("microfacet", False, "none")


def test_traced_shadows_need_transfer_that_turns():
    assert resolve_spec(TrainAvatar(visibility="traced"), {"shadow"}).shading == "transfer"


def test_irradiance_is_read_by_shadow_networks_alone():
    assert TrainAvatar().reads_irradiance({"shadow"})
    assert not TrainAvatar().reads_irradiance(set())
    assert TrainAvatar(shadow="on").reads_irradiance(set())
    assert not TrainAvatar(visibility="traced").reads_irradiance({"shadow"})
    assert not TrainAvatar(shading="auto").reads_irradiance({"shadow"})
