"""The shadow network: from normalised irradiance to a factor in [0, 1] (RFGCA 15-16).

A small convolutional network on the atlas. It is given the papers' map and, from the same rays, the cosine visibility:
the share of the light on a matte surface that is not shadowed. The latter is where it starts: it learns the rest, blur
and bounced light.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.geometry.texels import Atlas

SHARE_FLOOR, SHARE_CEILING = 0.02, 0.98
"""The start is kept off 0 and 1, where its logit is infinite: +-3.9, from which a sigmoid still learns."""


class ShadowNet(nn.Module):
    """A residual on the logit of the cosine visibility, from three 3x3 convolutions."""

    def __init__(self, atlas: Atlas, width: int) -> None:
        super().__init__()
        self.atlas = atlas.to_torch()
        layers = [nn.Conv2d(3, width, 3, padding=1), nn.Conv2d(width, width, 3, padding=1)]
        self.hidden = nn.ModuleList(layers)
        self.last = nn.Conv2d(width, 1, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(
        self, irradiance: Float[Tensor, " texels"], cosine_visibility: Float[Tensor, " texels"]
    ) -> Float[Tensor, " texels"]:
        """Shadow factors in (0, 1), from the two maps of `pipeline.lighting.irradiance`."""
        if self.atlas.texel.device != cosine_visibility.device:
            self.atlas = self.atlas.to_torch(cosine_visibility.device)
        start = torch.logit(cosine_visibility.clamp(SHARE_FLOOR, SHARE_CEILING))
        maps = self.atlas.to_map(torch.stack([start, irradiance, torch.ones_like(start)]))[None]
        # Channels last: convolutions of few channels take two thirds of the time.
        features = maps.contiguous(memory_format=torch.channels_last)
        for layer in self.hidden:
            features = torch.nn.functional.leaky_relu(layer(features), 0.2)
        return torch.sigmoid(start + self.atlas.from_map(self.last(features)[0, 0]))
