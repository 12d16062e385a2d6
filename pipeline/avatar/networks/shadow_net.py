"""The shadow network: from normalised irradiance to a factor in [0, 1] (RFGCA 15-16).

A small convolutional network on the atlas. The papers' reads the irradiance map and nothing else. By default it is also
given, from the same rays, the cosine visibility: the share of the light on a matte surface that is not shadowed. There
it starts, and learns the rest, blur and bounced light.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate, leaky_relu

from pipeline.config.trained_model import ShadowInput
from pipeline.geometry.texels import Atlas

SHARE_FLOOR, SHARE_CEILING = 0.02, 0.98
"""The start is kept off 0 and 1, where its logit is infinite: +-3.9, from which a sigmoid still learns."""

START_LOGIT = 2.0
"""Where a network that reads the irradiance alone starts, about: most texels are lit, by 0.88 of the light."""

SLOPE = 0.2
"""Of the leaky ReLU below zero."""


class ShadowNet(nn.Module):
    """Three 3x3 convolutions; between them, coarser maps that see further.

    Args:
        atlas: the texels.
        width: hidden channels.
        reads: "irradiance": that map alone; "cosine": the cosine visibility, too, and the network is a residual on its
            logit.
        levels: coarser maps, each of half the size of the one before.
    """

    def __init__(self, atlas: Atlas, width: int, reads: ShadowInput = "cosine", levels: int = 0) -> None:
        super().__init__()
        self.atlas, self.reads = atlas.to_torch(), reads
        inputs = 3 if reads == "cosine" else 1
        layers = [nn.Conv2d(inputs, width, 3, padding=1), nn.Conv2d(width, width, 3, padding=1)]
        self.hidden = nn.ModuleList(layers)
        self.last = nn.Conv2d(width, 1, 3, padding=1)
        self.coarser = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(levels))
        if reads == "cosine":
            nn.init.zeros_(self.last.weight)
            nn.init.zeros_(self.last.bias)
        else:
            nn.init.constant_(self.last.bias, START_LOGIT)

    def forward(
        self, irradiance: Float[Tensor, " texels"], cosine_visibility: Float[Tensor, " texels"]
    ) -> Float[Tensor, " texels"]:
        """Shadow factors in (0, 1), from the two maps of `pipeline.lighting.irradiance`."""
        if self.atlas.texel.device != irradiance.device:
            self.atlas = self.atlas.to_torch(irradiance.device)
        if self.reads == "irradiance":
            return torch.sigmoid(self.convolved(irradiance[None]))
        start = torch.logit(cosine_visibility.clamp(SHARE_FLOOR, SHARE_CEILING))
        return torch.sigmoid(start + self.convolved(torch.stack([start, irradiance, torch.ones_like(start)])))

    def convolved(self, values: Float[Tensor, "inputs texels"]) -> Float[Tensor, " texels"]:
        """One number per texel; 0 is read where the map has none."""
        # Channels last: convolutions of few channels take two thirds of the time.
        features = self.atlas.to_map(values)[None].contiguous(memory_format=torch.channels_last)
        features = self.with_coarser(leaky_relu(self.hidden[0](features), SLOPE))
        return self.atlas.from_map(self.last(leaky_relu(self.hidden[1](features), SLOPE))[0, 0])

    def with_coarser(self, features: Float[Tensor, "1 width h w"], level: int = 0) -> Float[Tensor, "1 width h w"]:
        """Features with what coarser maps add to them."""
        if level == len(self.coarser) or min(features.shape[-2:]) == 1:
            return features
        coarse = leaky_relu(self.coarser[level](avg_pool2d(features, 2, ceil_mode=True)), SLOPE)
        coarse = self.with_coarser(coarse, level + 1)
        return features + interpolate(coarse, features.shape[-2:], mode="bilinear", align_corners=False)
