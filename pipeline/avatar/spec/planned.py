"""Settings and planned effects, made into a spec."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType

from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.trained_model import Kind

REGIONAL = {
    "gloss_regions": ("specular", "specular"), "transport_regions": ("learned_transport", "shading"),
    "shadow_regions": ("shadow", "shadow"),
}  # fmt: skip
"""Field of a spec -> the effect that is on in these regions, and the setting that leaves it to the plan: auto."""


def read_plan(path: Path) -> set[str]:
    """The effects that are on in effects.json.

    Raises:
        InputError: if it says nothing about some effect.
    """
    effects = read_json(path)
    missing = sorted(set(EFFECTS) - effects.keys())
    if missing:
        raise InputError(f"{path}: expected the effects of this version, found no {missing}; run plan_effects again")
    return {name for name in EFFECTS if effects[name]["on"]}


Regions = Mapping[str, tuple[str, ...]]
"""Effect -> the regions of the template where it is on, for effects that are not on everywhere."""

EVERYWHERE: Regions = MappingProxyType({})


def read_regions_on(path: Path) -> Regions:
    """The regions where the effects of effects.json are on that are off in others."""
    regions = {name: effect.get("regions", {}) for name, effect in read_json(path).items() if effect["on"]}
    on = {name: tuple(region for region, part in parts.items() if part["on"]) for name, parts in regions.items()}
    return {name: some for name, some in on.items() if 0 < len(some) < len(regions[name])}


def read_gloss_width(path: Path) -> float | None:
    """Width of GGX that fits the images' gloss, of effects.json; None if they show none."""
    return read_json(path)["specular"].get("ggx_width")


def resolve_spec(
    settings: TrainAvatar, planned: Collection[str], kind: Kind = "body", regions: Regions = EVERYWHERE,
    gloss_width: float | None = None,
) -> AvatarSpec:  # fmt: skip
    """Spec of what the settings ask for; where they say `auto`, of what plan_effects turned on.

    Args:
        planned: the effects that are on in effects.json.
        kind: what the capture is of.
        regions: where they are on, if not everywhere.
        gloss_width: width of GGX to start from, if the plan found any gloss.

    Raises:
        InputError: if they ask a body for what only heads have.
    """
    decided = settings.decided(planned, kind)
    require_parts(decided)
    names = {field.name for field in fields(AvatarSpec)} - {"given_geometry", "start_ggx_width", *REGIONAL}
    chosen = {name: getattr(decided, name) for name in names}
    modes = ("specular", "shadow", "near_field", "articulation", "deferred", "eyes")
    spec = AvatarSpec(**chosen | {name: chosen[name] == "on" for name in modes})
    if spec.analytic:
        spec = spec if gloss_width is None else replace(spec, start_ggx_width=gloss_width)
        left = {name: effect for name, (effect, asked) in REGIONAL.items() if getattr(settings, asked) == "auto"}
        spec = replace(spec, **{name: regions.get(effect, ()) for name, effect in left.items()})
        spec = spec if spec.traced else replace(spec, shadow_regions=())
    # Light in the root's frame has no place for one texel's shadows.
    turns = spec.articulation or spec.traced
    return spec if turns or spec.shading != "transfer" else replace(spec, shading="harmonics")


def reason_of(settings: TrainAvatar, effects: Path) -> str:
    """Reason for the shading: the setting, or what the plan found about learned transport."""
    if settings.shading != "auto":
        return f"shading: {settings.shading} is asked for"
    return str(read_json(effects)["learned_transport"].get("why", ""))


def unread_settings(settings: TrainAvatar, spec: AvatarSpec) -> list[str]:
    """Settings that say something of their own, but that no part of what is built reads."""
    transfer = spec.shading not in ("microfacet", "subsurface")
    readers = {
        "transfer_start": spec.shading in ("harmonics", "linear"),
        "transfer_degree": transfer,
        "learning_rate_transfer": transfer,
        "weight_transfer": transfer and spec.shading != "combined",
        "weight_leftover": spec.shading == "combined",
        "weight_gloss": spec.specular_model == "ggx",
        "matte": spec.analytic and spec.specular,
        "highlight": spec.lobe or spec.viewed_harmonics or spec.specular_model == "tangent_harmonics",
        "harmonics_frame": spec.specular_model == "tangent_harmonics",
        "deferred": spec.lobe,
        "fresnel": spec.lobe,
        "screen_maps": spec.pixel_depth is not None or spec.shadow_net,
        "depth": spec.pixel_depth is not None,
        "normals": spec.lobe or (spec.analytic and spec.normals != "viewed"),
        "visibility": spec.shadow,
        "shadow_width": spec.shadow_net,
        "articulation": transfer or spec.pose_decoder,
        "parameters": spec.pose_decoder or spec.view_decoder,
        "face": spec.pose_decoder,
        "face_code": spec.pose_decoder and not spec.face,
        "weight_normal_orient": spec.pixel_depth is not None,
    }
    readers |= dict.fromkeys(("pose_points", "code_size", "decoder_channels", "last_layers"), spec.decoded)
    readers |= dict.fromkeys(("box_voxels", "ray_step_m", "weight_volume"), spec.volumes)
    readers |= dict.fromkeys(("dilation_px2", "compensate_opacity", "cull_backs"), not spec.volumes)
    readers |= dict.fromkeys(("shadow_input", "shadow_levels"), spec.shadow_net)
    readers |= dict.fromkeys(("anchors", "code_start", "weight_geometry", "weight_kl"), spec.head)
    of_geometry = ("weight_offset", "weight_size", "learning_rate_offset")
    readers |= dict.fromkeys(of_geometry, not spec.given_geometry)
    readers["weight_size"] &= not spec.volumes
    readers["eye_parameters"] = spec.eyes
    readers |= dict.fromkeys(("lids", "eye_channels"), spec.eyes and spec.eye_parameters == "decoded")
    readers["texel_frame"] = spec.head
    readers["gaze_features"] = spec.gaze_features
    readers["weight_roughness"] = spec.specular_model in ("angular", "cosine", "half", "ggx")
    readers |= dict.fromkeys(("weight_normal", "normal_steps"), spec.normal_model != "mesh")
    readers |= dict.fromkeys(("weight_eye_scale", "weight_eye_opacity", "weight_eye_visibility"), spec.eyes)
    own = {name for name, value in TrainAvatar() if getattr(settings, name) != value}
    return sorted(name for name in own if not readers.get(name, True))


def require_parts(decided: TrainAvatar) -> None:
    """Refuse what a body does not have, by the InputError of `resolve_spec`."""
    asked = {
        "shading: linear": decided.shading == "linear",
        "highlight: harmonics": decided.highlight == "harmonics",
        "normals: viewed": decided.normals == "viewed",
        "texel_frame: head": decided.texel_frame == "head",
        "geometry: volumes": decided.geometry == "volumes",
    }
    if decided.avatar == "body" and any(asked.values()):
        found = ", ".join(name for name, is_asked in asked.items() if is_asked)
        raise InputError(f"train_avatar: avatar: expected head, found body, with {found}, which only heads have")
