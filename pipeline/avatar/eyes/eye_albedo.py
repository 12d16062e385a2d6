"""The albedo of eyes, which depends on the side they are seen from: the iris lies behind a cornea that refracts
(RGCA 10)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from pipeline.avatar.pose_encoder import SLOPE, linear

FEATURES, HIDDEN = 8, 16
"""Numbers that a texel tells the network, and the network's width."""

MOST_GAIN = 3.0
"""Log of how much brighter or darker a texel may become from another side: between pupil (0.01) and iris (0.2)."""


class EyeAlbedo(nn.Module):
    """A factor on the albedo of each of so many texels, per colour and direction; 1 until it has learned.

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
