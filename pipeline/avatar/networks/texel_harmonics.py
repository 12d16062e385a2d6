"""Specular harmonics of texels by direction: a network (row "EyeNeRF" of RGCA).

Direction and harmonics are in the texel's tangent frame, in which equal surfaces shine alike wherever they face: one
small network learns from all texels together, as a radiance field does from all points. What a convolutional decoder
gives in the head's frame has to be learned anew for each way that the skin faces.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from pipeline.avatar.networks.pose_encoder import SLOPE, linear
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.lighting.environment_sh import COEFFICIENTS, spherical_harmonics
from pipeline.lighting.lobes import unit

FEATURES = 8
"""Numbers that a texel has of its own: how much it shines, how wide, and where its normal leans."""

DIRECTION_DEGREES = 6
"""Degrees of harmonics that a direction is told by."""

HIDDEN = 64

OUTPUT_SCALE = 0.01
"""Of the last layer, so that a step of Adam is no flash: 1e-3 on each of 64 weights, at features of about 0.5, times
18, what a direction's harmonics sum to, times five lamps of 3 on a square metre, is 9 without, where pictures have
0.3."""


class TexelHarmonics(nn.Module):
    """Two layers on a texel's features, a code and a direction; they start at no light.

    Args:
        texels: number of texels.
        code: numbers of the code.
    """

    def __init__(self, texels: int, code: int) -> None:
        super().__init__()
        self.features = nn.Parameter(torch.zeros(texels, FEATURES))
        self.expressed, self.seen = linear(code, HIDDEN), linear(FEATURES + DIRECTION_DEGREES**2, HIDDEN)
        self.last = nn.Linear(HIDDEN, COEFFICIENTS)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(
        self, code: Float[Tensor, " code"], posed: PosedTexels, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels 81"]:
        """Harmonics for a camera at `center`, in the texels' tangent frames."""
        toward = unit(center - posed.points)
        directions = (posed.tangent_frames.mT @ toward[..., None])[..., 0]
        told = torch.cat([self.features, spherical_harmonics(directions, DIRECTION_DEGREES)], -1)
        return OUTPUT_SCALE * self.last(leaky_relu(self.seen(told) + self.expressed(code), SLOPE))
