"""The shadow network: a small convolutional network on the atlas, from normalised irradiance to a factor in [0, 1].

RFGCA 15-16. The traced map tells how much of the light arrives, with attached shadow (light behind the surface) and
cast shadow mixed. The share of light above each texel's horizon costs no ray, so the network is given both, and
starts from their ratio: what arrives of what could. It learns the rest: blur, bounced light, cosine.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.geometry.texels import Atlas

RATIO_FLOOR, RATIO_CEILING = 0.02, 0.98
"""The start ratio is kept off 0 and 1, where its logit is infinite: +-3.9, from which a sigmoid still learns."""

SMALLEST_HORIZON_SHARE = 0.05
"""Below a twentieth of the light above the horizon the ratio of two small numbers is noise: taken as this much."""


def horizon_share(
    points: Float[Tensor, "texels 3"],
    normals: Float[Tensor, "texels 3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
) -> Float[Tensor, "texels"]:
    """Share of the light (I / d^2, no cosine) that comes from above each texel's horizon; 1 where no light is on."""
    to_light = light_positions - points[:, None]
    weight = intensities.mean(-1) / to_light.square().sum(-1)
    above = (torch.einsum("tlc,tc->tl", to_light, normals) > 0) * weight
    total = weight.sum(-1)
    return torch.where(total > 0, above.sum(-1) / total.clamp_min(torch.finfo(total.dtype).tiny), 1.0)


class ShadowNet(nn.Module):
    """Residual on the logit of (irradiance / horizon share), from three 3x3 convolutions on the atlas."""

    def __init__(self, atlas: Atlas, width: int) -> None:
        super().__init__()
        self.atlas = atlas.to_torch()
        layers = [nn.Conv2d(3, width, 3, padding=1), nn.Conv2d(width, width, 3, padding=1)]
        self.hidden = nn.ModuleList(layers)
        self.last = nn.Conv2d(width, 1, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, irradiance: Float[Tensor, "texels"], horizon: Float[Tensor, "texels"]) -> Float[Tensor, "texels"]:
        ratio = irradiance / horizon.clamp_min(SMALLEST_HORIZON_SHARE)
        start = torch.logit(ratio.clamp(RATIO_FLOOR, RATIO_CEILING))
        features = self.atlas.to_map(torch.stack([start, horizon, torch.ones_like(horizon)]))[None]
        for layer in self.hidden:
            features = torch.nn.functional.leaky_relu(layer(features), 0.2)
        return torch.sigmoid(start + self.atlas.from_map(self.last(features)[0, 0]))
