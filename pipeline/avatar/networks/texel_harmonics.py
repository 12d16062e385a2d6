"""Specular harmonics by direction, of tables that texels share (row "EyeNeRF" of RGCA).

Direction and harmonics are in the texel's tangent frame, in which equal surfaces shine alike wherever they face: what
shines is learned from all texels together, as a radiance field learns from all points. What a convolutional decoder
gives in the head's frame has to be learned anew for each way that the skin faces.

    S(k, w_o) = sum over tables t of m_t(k, z) A_t Y(w_o),    m = 1 + W (f_k + E z)
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.lighting.environment_sh import COEFFICIENTS, spherical_harmonics
from pipeline.lighting.lobes import unit

TABLES = 3
"""How much a texel shines, how wide, and where its normal leans take that many at least."""

DIRECTION_DEGREES = 8
"""Degrees of harmonics that a direction is told by."""

MIXING = 0.5
"""Deviation of the weights W, which tells equal tables apart."""

OUTPUT_SCALE = 0.02
"""Of the tables. At five times as much, the first steps are flashes from which an avatar of 200 steps does not recover;
much smaller, they learn nothing in so many."""


class TexelHarmonics(nn.Module):
    """Tables that start at no light, and the weights of each texel.

    Args:
        texels: number of texels.
        code: numbers of the code.
    """

    def __init__(self, texels: int, code: int) -> None:
        super().__init__()
        self.features = nn.Parameter(torch.zeros(texels, TABLES))
        self.expressed = nn.Parameter(torch.zeros(TABLES, code))
        self.mixing = nn.Parameter(MIXING * torch.randn(TABLES, TABLES))
        self.tables = nn.Parameter(torch.zeros(DIRECTION_DEGREES**2, TABLES * COEFFICIENTS))

    def forward(
        self, code: Float[Tensor, " code"], posed: PosedTexels, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels 81"]:
        """Harmonics for a camera at `center`, in the texels' tangent frames."""
        toward = unit(center - posed.points)
        directions = (posed.tangent_frames.mT @ toward[..., None])[..., 0]
        shares = 1 + (self.features + self.expressed @ code) @ self.mixing
        seen = spherical_harmonics(directions, DIRECTION_DEGREES) @ self.tables
        return OUTPUT_SCALE * (seen.reshape(-1, TABLES, COEFFICIENTS) * shares[..., None]).sum(1)
