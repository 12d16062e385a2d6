"""Path-traced scenes that call for different effects: what is planned, and what of the avatar and the jobs is left."""

from __future__ import annotations

import pytest
import trimesh

from benchmarks.bench_effects import ALL_ON, AVATARS, DRAWS
from benchmarks.effect_jobs import count_jobs
from benchmarks.effect_scenes import make_scene
from benchmarks.effect_shapes import cup, links, ring
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import read_gloss_width, read_plan, read_regions_on, resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.base.files import read_json
from pipeline.config.effects import EFFECTS
from pipeline.config.plan_effects import PlanEffects
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texel_regions import REST
from pipeline.geometry.texels import read_atlas
from pipeline.stages.plan_effects import run

SMALLEST = {
    "cameras": 4, "frames": 6, "frames_b": 1, "test_cameras": 1, "test_frames": 1, "width": 56, "height": 56, "spp": 16,
    "spp_fully_lit": 16, "supersampling": 1,
}  # fmt: skip

CALLED_FOR = {
    "diffuse": set(),
    "glossy": {"specular", "deferred"},
    "bust": {"shadow"},
    # Opaque plastic: nothing that GGX, traced visibility and a bounce would not explain.
    "body": set(EFFECTS) - {"learned_transport", "eyes"},
    "near": {"near_field"},
    "halves": {"specular", "deferred"},
    "capped": {"shadow", "near_field", "specular", "deferred"},
}
"""Of those scenes that are small enough for a test."""

BY_REGION = {
    "halves": {"shadow": set(), "specular": {REST}, "learned_transport": set()},
    "capped": {"shadow": {REST}, "specular": {REST}, "learned_transport": set()},
}
"""Scenes of several materials -> effects -> the regions where they are on."""

SETTINGS = PlanEffects(rays=2048, texels=600)

FULL, AUTO = TrainAvatar(shading="transfer", deferred="on"), TrainAvatar()


@pytest.fixture(scope="module", params=CALLED_FOR)
def scene(request, tmp_path_factory):
    """Name, folder and plan of a scene; made once for all tests."""
    folder = tmp_path_factory.mktemp(request.param)
    files = make_scene(folder, request.param, 40, **SMALLEST)
    given = {key: path for key, path in files.items() if key not in ("tracking", "frames")}
    run(**given, tracking=(files["tracking"],), booked=files["frames"], out=folder / "effects.json", settings=SETTINGS)
    return request.param, folder, read_json(folder / "effects.json")


@pytest.mark.parametrize("shape", [ring, links, cup], ids=lambda shape: shape.__name__)
def test_shapes_are_closed_and_their_outside_is_out(shape):
    made = shape()
    solid = trimesh.Trimesh(made.at(0.0, "a")[0], made.faces, process=False)
    assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0


def test_what_is_called_for_is_on(scene):
    name, folder, effects = scene
    assert read_plan(folder / "effects.json") == CALLED_FOR[name]
    for effect in effects.values():
        assert effect["on"] == (effect["evidence"] > effect["threshold"])
        assert set(effect["cost"]) == {"jobs", "channels", "parameters", "seconds"}
    assert ("ggx_width" in effects["specular"]) == effects["specular"]["on"]
    assert read_gloss_width(folder / "effects.json") == effects["specular"].get("ggx_width")


def test_effects_are_planned_where_they_are(scene):
    name, folder, effects = scene
    if name not in BY_REGION:
        assert not any("regions" in effect for effect in effects.values())  # no other template names any
        return
    found = {effect: effects[effect]["regions"] for effect in BY_REGION[name]}
    on = {effect: {region for region, part in regions.items() if part["on"]} for effect, regions in found.items()}
    assert on == BY_REGION[name]
    some = {effect: tuple(sorted(regions)) for effect, regions in on.items() if len(regions) == 1}
    assert {
        effect: tuple(sorted(regions)) for effect, regions in read_regions_on(folder / "effects.json").items()
    } == some


def parameters(folder, settings):
    """What the plan leaves of an avatar: name -> how many numbers."""
    atlas = read_atlas(folder / "atlas.safetensors")
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, read_plan(folder / "effects.json")))
    sizes = {}
    for name, parameter in avatar.named_parameters():
        sizes[name.split(".")[0]] = sizes.get(name.split(".")[0], 0) + parameter.numel()
    return sizes, avatar


def test_what_is_off_has_no_parameters(scene):
    name, folder, _ = scene
    called_for = CALLED_FOR[name]
    full, avatar = parameters(folder, FULL)
    assert ("shadow_net" in full) == ("shadow" in called_for)
    assert ({"log_roughness", "visibility", "normal_offset"} <= full.keys()) == ("specular" in called_for)
    assert avatar.spec.near_field == ("near_field" in called_for)
    assert avatar.spec.shading == ("transfer" if "articulation" in called_for else "harmonics")
    auto, avatar = parameters(folder, AUTO)
    assert not {"transfer_color", "transfer_mono", "shadow_net"} & auto.keys()
    assert avatar.spec.shading == "microfacet"
    assert avatar.spec.traced == ("shadow" in called_for)
    assert avatar.spec.indirect == ("bounce" if "shadow" in called_for else "none")
    assert ("log_gloss" in auto) == ("specular" in called_for)
    assert sum(auto.values()) < 0.5 * sum(full.values())


def test_what_is_off_is_no_job_and_what_it_costs_is_what_it_adds(scene):
    name, folder, effects = scene
    planned = read_plan(folder / "effects.json")
    assert FULL.reads_irradiance(planned) == ("shadow" in CALLED_FOR[name])
    assert not AUTO.reads_irradiance(planned)
    # An effect's parameters are those of an avatar with everything less those of one without it.
    atlas = read_atlas(folder / "atlas.safetensors")

    def count(on):
        avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(AUTO, on))
        return sum(parameter.numel() for parameter in avatar.parameters())

    everything = set(EFFECTS) - {"eyes"}  # the scenes have none
    for effect in everything:
        added = count(everything) - count(everything - {effect})
        assert effects[effect]["cost"]["parameters"] == added, effect


def test_jobs_of_each_scene_are_those_that_its_effects_need(tmp_path):
    """Snakemake's own count, scene by scene: three chunks of five frames each, after the plan. The plans are those that
    `test_what_is_called_for_is_on` finds."""
    everything = {name for name in EFFECTS if getattr(ALL_ON, name) == "on"}
    plans, variants = {}, {}
    for scene, called_for in CALLED_FOR.items():
        for avatar, choices in AVATARS.items():
            on = everything if avatar == "everything" else called_for
            plans[f"{scene}-{avatar}"] = {name: {"on": name in on} for name in EFFECTS}
            variants[f"{scene}-{avatar}"] = choices
    jobs = count_jobs(tmp_path, plans, variants, 15)
    always = {"pack_shards": 3, "train_avatar": 1, "evaluate_avatar": 1}
    for scene, called_for in CALLED_FOR.items():
        assert jobs[f"{scene}-everything"] == {**always, "trace_irradiance": 3}
        assert jobs[f"{scene}-full"] == always | ({"trace_irradiance": 3} if "shadow" in called_for else {})
        assert jobs[f"{scene}-auto"] == always


def test_another_draw_is_another_capture_of_the_same_shape(tmp_path):
    """What settings are chosen by, and what the table reports, share no image."""
    small = {**SMALLEST, "cameras": 2, "frames": 3, "spp": 1, "spp_fully_lit": 1}
    drawn = {name: make_scene(tmp_path / name, "diffuse", 16, draw, **small) for name, draw in DRAWS.items()}
    again = make_scene(tmp_path / "again", "diffuse", 16, DRAWS["report"], **small)
    for kind in ("lights", "cameras", "patterns"):
        assert drawn["report"][kind].read_bytes() != drawn["validation"][kind].read_bytes()
        assert drawn["report"][kind].read_bytes() == again[kind].read_bytes()
    for kind in ("atlas", "tracking"):
        assert drawn["report"][kind].read_bytes() == drawn["validation"][kind].read_bytes()
