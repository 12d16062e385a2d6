"""Limits of a GPU: what an avatar may not ask of it, said before it is trained."""

from __future__ import annotations

from importlib.util import find_spec

import torch

from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.base.errors import InputError


def require_drawable(spec: AvatarSpec, device: torch.device) -> None:
    """Refuse to train on a GPU what it would not draw.

    Raises:
        InputError: if the avatar asks for a median depth, which gsplat does not know, or there is no gsplat.
    """
    if device.type != "cuda" or spec.geometry == "volumes":
        return
    if spec.pixel_depth == "median":
        raise InputError(
            "train_avatar.depth: expected traced, normalised or expected on a GPU, found median, which gsplat does not "
            "know; choose one of them, or set device: cpu"
        )
    if find_spec("gsplat") is None:
        raise InputError(
            "expected gsplat, which draws Gaussians on a GPU, found none; run pip install '.[gpu]', or set device: cpu"
        )
