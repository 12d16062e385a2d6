"""Texels of eyes, and the albedo of eyes.

It depends on the side they are seen from.

The iris lies behind a cornea that refracts (RGCA 10).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from pipeline.avatar.eyes.eye_decoders import MOST_GAIN
from pipeline.avatar.networks.pose_encoder import SLOPE, linear
from pipeline.base.errors import InputError
from pipeline.geometry.texels import Atlas

FEATURES, HIDDEN = 8, 16
"""Numbers that a texel tells the network, and the network's width."""


def eye_texels(
    atlas: Atlas, parts: Mapping[str, tuple[int, ...]]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Texels of all eyes, and the number of each one's eye.

    An eye's are those whose face has all corners in it.

    Args:
        parts: vertices of each eye by name; eyes are numbered in its order.

    Raises:
        InputError: if there are no such vertices, or an eye has no texel.
    """
    owner = np.full(len(atlas.rest_vertices), -1)
    for number, (name, vertices) in enumerate(parts.items()):
        if not vertices or not 0 <= min(vertices) <= max(vertices) < len(owner):
            raise InputError(f"{name}: expected vertices 0 to {len(owner) - 1}, found others; run fit_eyes again")
        owner[list(vertices)] = number
    corners = owner[atlas.corners]
    chosen = np.flatnonzero((corners[:, 0] >= 0) & (corners == corners[:, :1]).all(1))
    eye = corners[chosen, 0]
    empty = [name for number, name in enumerate(parts) if not (eye == number).any()]
    if empty:
        raise InputError(
            f"{empty}: expected texels of the atlas on each eye, found none; make unwrap_atlas.size larger"
        )
    return chosen, eye


class EyeAlbedo(nn.Module):
    """A factor on the albedo of each of so many texels, per colour and direction.

    1 until it has learned.

    Refraction depends on the direction in the eye's own frame alone: neither gaze nor head are asked for.
    """

    def __init__(self, texels: int) -> None:
        super().__init__()
        self.features = nn.Parameter(torch.randn(texels, FEATURES))
        self.hidden, self.last = linear(FEATURES + 3, HIDDEN), linear(HIDDEN, 3)
        nn.init.zeros_(self.last.parametrizations.weight.original0)

    def forward(self, toward: Float[Tensor, "texels 3"]) -> Float[Tensor, "texels 3"]:
        """Positive factors for unit directions to the camera in the eye's frame."""
        known = leaky_relu(self.hidden(torch.cat([self.features, toward], -1)), SLOPE)
        return torch.exp(MOST_GAIN * torch.tanh(self.last(known)))
