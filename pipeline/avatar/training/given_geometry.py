"""Geometry of a trained avatar, taken over by another (rows of RFGCA's Table 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch

from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.texels.texel_parameters import GEOMETRY
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.errors import InputError
from pipeline.base.files import read_json

SIZES = ("code_size", "decoder_channels", "pose_points", "face", "face_code", "articulation", "last_layers")
"""What has to be alike for networks of one avatar to be another's."""


def with_given_geometry(spec: AvatarSpec, folder: Path) -> AvatarSpec:
    """The spec of an avatar that takes over the geometry of the one in a folder.

    Raises:
        InputError: if either is no body with Gaussians, or the networks of one do not fit the other.
    """
    other = AvatarSpec.from_json(_spec_in(folder))
    for which, each in (("this avatar", spec), (str(folder), other)):
        if each.head or each.volumes:
            raise InputError(f"geometry_from: expected a body with Gaussians, found {describe(each)}: {which}")
    decoded = other.pose_decoder or other.given_geometry == "decoded"
    differing = [name for name in SIZES if decoded and getattr(spec, name) != getattr(other, name)]
    if differing:
        found = ", ".join(f"{name} {getattr(spec, name)} and {getattr(other, name)}" for name in differing)
        raise InputError(f"geometry_from: expected networks of the same size as in {folder}, found {found}")
    return replace(spec, given_geometry="decoded" if decoded else "texels")


@torch.no_grad()
def take_geometry(avatar: Avatar, folder: Path, atlas: Path) -> None:
    """Give an avatar the geometry of the one in a folder, trained on the same atlas."""
    other = load_avatar(folder, atlas).avatar
    for name in GEOMETRY:
        avatar.get_parameter(name).copy_(other.get_parameter(name))
    if avatar.spec.given_geometry == "decoded":
        given = other.networks if other.networks.given is None else other.networks.given
        avatar.networks.given.take(given)


def _spec_in(folder: Path) -> Mapping:
    stored = read_json(folder / "config.json").get("spec", {})
    if stored.keys() != AvatarSpec.__dataclass_fields__.keys():
        raise InputError(f"{folder}/config.json: spec: expected the keys of this version, found others; train again")
    return stored
